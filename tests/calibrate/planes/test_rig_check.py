"""Check of a rig by one view of the board."""

from dataclasses import replace

import numpy as np
import pytest
from known_views import DISTANCES_M, NORMALS, TRUE_CAMERA, stripe_views, true_poses

from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import calibrated_rig
from ringpose.calibrate.planes.recheck.board_check import FLATNESS_M, rig_check, rig_check_lines
from ringpose.geometry.rotations import tilted
from ringpose.types.rig import LaserPlanes, Rig

NAMES = ("left", "middle", "right")


@pytest.fixture
def true_rig() -> Rig:
    normal, distance_m = NORMALS, DISTANCES_M
    lasers = LaserPlanes(names=NAMES, normal=normal, distance_m=distance_m, projector_m=np.full((3, 3), np.nan))
    return Rig(camera=TRUE_CAMERA, lasers=lasers)


@pytest.fixture
def view(rng):
    return stripe_views(true_poses(rng, 1), rng, 0.02, 0.05)[0]


def with_normal(rig: Rig, laser: int, normal: np.ndarray) -> Rig:
    normals = rig.lasers.normal.copy()
    normals[laser] = normal
    return replace(rig, lasers=replace(rig.lasers, normal=normals))


def test_the_true_rig_holds(view, true_rig):
    check = rig_check(view, true_rig)

    assert check.holds
    assert max(abs(laser.offset_m) for laser in check.lasers) < 3e-5


def test_a_plane_that_moved_is_named_with_its_offset(view, true_rig):
    distance_m = true_rig.lasers.distance_m + np.array([0.0, 4e-4, 0.0])
    moved = replace(true_rig, lasers=replace(true_rig.lasers, distance_m=distance_m))

    check = rig_check(view, moved)

    assert [laser.holds for laser in check.lasers] == [True, False, True]
    assert check.lasers[1].offset_m == pytest.approx(-4e-4, abs=3e-5)


def test_a_plane_that_turned_about_the_middle_of_its_stripe_is_seen_at_the_ends(view, true_rig):
    """Turned by a milliradian about an axis across the stripe; the ends of a stripe 0.26 m long move by 0.13 mm."""
    normal = tilted(NORMALS[1], np.array([1e-3, 0.0]))
    turned = with_normal(true_rig, 1, normal)

    check = rig_check(view, turned)

    assert not check.lasers[1].holds
    assert 0.8e-4 < abs(check.lasers[1].offset_m) < 2.5e-4


def test_a_stripe_that_is_not_seen_does_not_confirm_the_rig(view, true_rig):
    unlit = replace(view, stripes_px=(*view.stripes_px[:2], np.empty((0, 2))))

    check = rig_check(unlit, true_rig)

    assert not check.holds
    assert rig_check_lines(check)[-1].endswith("right: no stripe on the board, not checked")


def test_another_lens_is_seen_by_the_corners(view, true_rig):
    matrix = true_rig.camera.camera_matrix * np.array([[1.0, 1, 1], [1.03, 1.03, 1], [1, 1, 1]])
    other = replace(true_rig, camera=replace(true_rig.camera, camera_matrix=matrix))

    assert not rig_check(view, other).holds


def test_a_principal_point_that_moved_is_seen_where_usual_corners_are_known(view, true_rig):
    matrix = true_rig.camera.camera_matrix + np.array([[0.0, 0, 10], [0, 0, 0], [0, 0, 0]])
    moved = replace(true_rig, camera=replace(true_rig.camera, camera_matrix=matrix))

    check = rig_check(view, moved, median_board_rms_px=0.02)

    assert 0.1 < check.board_rms_px < 0.5
    assert not check.holds
    assert rig_check(view, true_rig, median_board_rms_px=0.02).holds


def test_stripes_seen_together_are_assigned_to_the_nearest_planes(view, true_rig):
    nothing = (np.empty((0, 2)),) * 3
    together = replace(view, stripes_px=nothing, unlabelled_px=view.stripes_px[::-1])

    assert rig_check(together, true_rig).holds


def test_an_uncertain_rig_has_wider_limits(rng, view, true_rig):
    poses = true_poses(rng, 4)
    limits = []
    for noise in (0.02, 0.4):
        found = calibrate_planes(stripe_views(poses, rng, noise, 4 * noise), TRUE_CAMERA, PlanesModel(names=NAMES))
        limits.append(rig_check(view, calibrated_rig(found)).lasers[0].limit_m)

    assert limits[0] > FLATNESS_M
    assert limits[1] > 2 * limits[0]


def test_offsets_of_new_views_stay_within_their_limits(rng):
    """Three sigmas and the board's flatness; of thirty views of a noisy calibration none is beyond them."""
    noisy = stripe_views(true_poses(rng, 5), rng, 0.2, 0.5)
    rig = calibrated_rig(calibrate_planes(noisy, TRUE_CAMERA, PlanesModel(names=NAMES)))

    checks = [rig_check(view, rig) for view in stripe_views(true_poses(rng, 30), rng, 0.05, 0.2)]

    share = [abs(laser.offset_m) / laser.limit_m for check in checks for laser in check.lasers]
    assert max(share) < 1
    assert max(share) > 0.2
