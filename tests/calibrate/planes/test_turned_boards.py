"""Stripes along the columns are extracted on boards as those along the rows."""

from pathlib import Path

import numpy as np
import pytest
from drawn_boards import FOUR
from ring_scenes import make_scene
from turned_cameras import TURN, turned_px, turned_rig, turned_shot

from ringpose.calibrate.boards.views import find_board
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.stripes.extraction import stripe_view
from ringpose.files.images.shots import read_shot
from ringpose.geometry.rotations import angle_between
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


@pytest.mark.slow
def test_planes_of_stripes_along_the_columns_are_those_along_the_rows_turned():
    """Stripes from left to right instead of from the top down, all lasers on together."""
    rig = make_scene("B").rig
    shots = [read_shot(path) for path in sorted(SHOT.parent.glob("*.npz"))]
    normals = []
    for turned in (False, True):
        camera = turned_rig(rig).camera if turned else rig.camera
        views = []
        for shot in (turned_shot(each) if turned else each for each in shots):
            board = find_board(board_image(shot), FOUR, shot.name)
            views.append(stripe_view(shot, board, FOUR, camera, ["left", "middle", "right"]))
        order = (0, 1, 2) if turned else (2, 1, 0)
        model = PlanesModel(names=("left", "middle", "right"), order=order)
        normals.append(calibrate_planes(views, camera, model).planes.normal)

    expected = normals[0] @ TURN.T
    angles = angle_between(normals[1], expected)
    assert np.degrees(np.minimum(angles, np.pi - angles)).max() < 0.01
