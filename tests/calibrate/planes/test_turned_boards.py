"""Stripes along the columns are extracted on boards as those along the rows."""

from pathlib import Path

import numpy as np
from drawn_boards import FOUR
from ring_scenes import make_scene
from turned_cameras import turned_px, turned_rig, turned_shot

from ringpose.calibrate.boards.views import find_board
from ringpose.calibrate.planes.stripes.extraction import stripe_view
from ringpose.files.images.shots import read_shot
from ringpose.types.image import board_image

SHOT = Path(__file__).parents[2] / "data" / "calib_b" / "planes" / "pln_B_01.npz"


def test_a_turned_camera_sees_the_same_stripes_on_a_board():
    """Three independent orders of the pixels: rows of one image are columns of the other."""
    rig, shot = make_scene("B").rig, read_shot(SHOT)
    views = []
    for of_rig, of_shot in ((rig, shot), (turned_rig(rig), turned_shot(shot))):
        board = find_board(board_image(of_shot), FOUR, of_shot.name)
        views.append(stripe_view(of_shot, board, FOUR, of_rig.camera, "abc"))

    for usual, turned in zip(*map(_stripes, views), strict=True):
        lines = [
            np.polyfit(points[:, 0], points[:, 1], 3) for points in (turned_px(usual, rig)[:, ::-1], turned[:, ::-1])
        ]
        x = np.linspace(*np.percentile(turned[:, 1], [5, 95]), 20)
        np.testing.assert_allclose(np.polyval(lines[0], x), np.polyval(lines[1], x), atol=0.03)
        assert len(turned) > 0.9 * len(usual) > 100


def _stripes(view):
    """The three stripes, from the one that is nearest to the top of the usual image."""
    stripes = view.unlabelled_px or view.stripes_px
    assert len(stripes) == 3
    along = 0 if np.ptp(stripes[0][:, 0]) < np.ptp(stripes[0][:, 1]) else 1
    return sorted(stripes, key=lambda points: points[:, along].mean() * (-1 if along == 0 else 1))
