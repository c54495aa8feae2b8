"""Stripes on the face of a ring by rig and ring alone, against rendered shots and closed forms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from turned_cameras import TURN, turned_rig

from ringpose.bench.design.crossings import crossings, ends_in_view, limit_lines
from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig
from ringpose.files.scenes.scene import read_scene

SHOTS = Path(__file__).parents[2] / "data" / "rig_b"
EXAMPLE = Path(__file__).parents[3] / "examples" / "scene.yaml"
FACING = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def rig():
    return read_rig(SHOTS / "rig.yaml")


@pytest.fixture(scope="module")
def scene(rig):
    return replace(read_scene(EXAMPLE), rig=rig)


def test_they_are_those_that_rendered_shots_show(rig):
    """But for one stripe behind a cable."""
    for truth in read_truths(SHOTS / "truth.jsonl"):
        pieces = ends_in_view(rig, truth.center_m, truth.normal, np.array([truth.radius_inner_m, truth.radius_outer_m]))
        hidden = [truth.shot == "V03_occl_B500_dim", False, False]

        found = [any(each) and not covered for each, covered in zip(pieces, hidden, strict=True)]

        assert found == np.isfinite(truth.break_points_px).all(axis=(1, 2)).tolist(), truth.shot


@pytest.mark.parametrize(("radii_m", "pieces"), [((0.09, 0.11), [2, 2, 1]), ((0.04, 0.09), [2, 1, 0])])
def test_a_stripe_beside_the_hole_is_one_piece_and_one_beyond_the_ring_none(rig, radii_m, pieces):
    center, lasers = np.array([0.0, 0.0, 0.3]), rig.lasers
    aside_m = np.abs(lasers.distance_m - lasers.normal @ center) / np.hypot(*lasers.normal[:, :2].T)

    found = [len(each) for each in ends_in_view(rig, center, FACING, np.array(radii_m))]

    assert found == [2 if u < radii_m[0] else 1 if u < radii_m[1] else 0 for u in aside_m]
    assert found == pieces


def test_a_turned_camera_shows_the_same(rig):
    center, radius_m = np.array([0.05, -0.02, 0.4]), np.array([0.13, 0.17])

    assert ends_in_view(turned_rig(rig), TURN @ center, TURN @ FACING, radius_m) == ends_in_view(
        rig, center, FACING, radius_m
    )


def test_the_step_is_the_shift_of_a_stripe_in_the_image(scene):
    """Where the same ray of the light plane would meet the face, and the body, in one column of the image."""
    at = crossings(scene, 0.5)
    lasers, focal = scene.rig.lasers, scene.rig.camera.camera_matrix[1, 1]
    rows = [
        (lasers.distance_m / depth_m - lasers.normal[:, 2]) / lasers.normal[:, 1]
        for depth_m in (0.5, 0.5 + scene.ring.height_m)
    ]

    assert at.step_px == pytest.approx(focal * np.abs(rows[1] - rows[0]).min())


def test_limits_are_stated_from_where_to_where(scene):
    lines = limit_lines(scene)

    assert "three stripes from" in lines[1]
    assert lines[3].startswith("  the step behind the face is wider than the stripe: to ")


def test_a_ring_smaller_than_the_stripes_are_apart_never_shows_three(scene):
    tiny = replace(scene, ring=replace(scene.ring, profile_m=scene.ring.profile_m * [0.05, 1.0]))

    assert "three stripes never" in limit_lines(tiny)[1]
