"""Check of a rig by one view of the board."""

from dataclasses import replace

import numpy as np
import pytest
from known_views import DISTANCES_M, NORMALS, TRUE_CAMERA, stripe_views, true_poses

from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import calibrated_rig
from ringpose.calibrate.planes.recheck.board_check import FLATNESS_M, rig_check
from ringpose.calibrate.planes.recheck.update import BoardRecheck
from ringpose.geometry.rotations import tilted
from ringpose.types.rig import LaserPlanes, ParameterCovariance, Rig, laser_parameters

NAMES = ("left", "middle", "right")


@pytest.fixture
def true_rig() -> Rig:
    lasers = LaserPlanes(names=NAMES, normal=NORMALS, distance_m=DISTANCES_M, projector_m=np.full((3, 3), np.nan))
    return Rig(camera=TRUE_CAMERA, lasers=lasers)


@pytest.fixture
def view(rng):
    return stripe_views(true_poses(rng, 1), rng, 0.02, 0.05)[0]


def test_a_plane_that_turned_about_the_middle_of_its_stripe_is_seen_at_the_ends(view, true_rig):
    """Turned by a milliradian about an axis across the stripe; the ends of a stripe 0.26 m long move by 0.13 mm."""
    normals = np.array([NORMALS[0], tilted(NORMALS[1], np.array([1e-3, 0.0])), NORMALS[2]])

    check = rig_check(view, replace(true_rig, lasers=replace(true_rig.lasers, normal=normals)))

    assert not check.lasers[1].holds
    assert 0.8e-4 < abs(check.lasers[1].offset_m) < 2.5e-4


def test_the_plane_that_has_moved_is_named_among_those_that_hold(true_rig, rng):
    normals = np.array([NORMALS[0], tilted(NORMALS[1], np.array([5e-3, 0.0])), NORMALS[2]])
    covariance = ParameterCovariance(parameters=laser_parameters(NAMES), data=1e-8 * np.eye(9))
    lasers = replace(true_rig.lasers, normal=normals)
    recheck = BoardRecheck(replace(true_rig, lasers=lasers, covariance=covariance), None)
    for view in stripe_views(true_poses(rng, 4), rng, 0.02, 0.05):
        recheck.add(view)

    assert recheck.contradicted
    assert recheck.moved_lasers() == [1]
    lines = recheck.evidence_lines([1])
    assert [line.split(":")[0] for line in lines] == list(NAMES)
    assert ["does not hold: has moved by 0.29 degrees" in line for line in lines] == [False, True, False]


@pytest.mark.parametrize(
    ("scale", "shift_px", "usual_px"),
    [(1.03, 0.0, None), (1.0, 10.0, 0.02)],
    ids=["another lens", "principal point moved, corners of the calibration known"],
)
def test_another_camera_is_seen_by_the_corners(scale, shift_px, usual_px, view, true_rig):
    matrix = true_rig.camera.camera_matrix * np.array([[1.0, 1, 1], [scale, scale, 1], [1, 1, 1]])
    matrix[0, 2] += shift_px
    other = replace(true_rig, camera=replace(true_rig.camera, camera_matrix=matrix))

    assert not rig_check(view, other, usual_px).holds
    assert rig_check(view, true_rig, usual_px).holds


def test_stripes_seen_together_are_assigned_to_the_nearest_planes(view, true_rig):
    nothing = (np.empty((0, 2)),) * 3
    together = replace(view, stripes_px=nothing, unlabelled_px=view.stripes_px[::-1])

    check = rig_check(together, true_rig)

    assert check.holds
    assert max(abs(laser.offset_m) for laser in check.lasers) < 3e-5


def test_an_uncertain_rig_has_wider_limits(rng, view, true_rig):
    poses = true_poses(rng, 4)
    limits = []
    for noise in (0.02, 0.4):
        found = calibrate_planes(stripe_views(poses, rng, noise, 4 * noise), TRUE_CAMERA, PlanesModel(names=NAMES))
        limits.append(rig_check(view, calibrated_rig(found)).lasers[0].limit_m)

    assert limits[0] > FLATNESS_M
    assert limits[1] > 2 * limits[0]


@pytest.mark.slow
def test_offsets_of_new_views_stay_within_their_limits(rng):
    """Three sigmas and the board's flatness; of thirty views of a noisy calibration none is beyond them."""
    noisy = stripe_views(true_poses(rng, 5), rng, 0.2, 0.5)
    rig = calibrated_rig(calibrate_planes(noisy, TRUE_CAMERA, PlanesModel(names=NAMES)))

    checks = [rig_check(view, rig) for view in stripe_views(true_poses(rng, 30), rng, 0.05, 0.2)]

    share = [abs(laser.offset_m) / laser.limit_m for check in checks for laser in check.lasers]
    assert max(share) < 1
    assert max(share) > 0.2
