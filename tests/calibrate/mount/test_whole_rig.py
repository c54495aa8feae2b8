"""Camera, light planes and mount from one simulated session, whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import chi_squared
from known_views import DISTANCES_M, NORMALS, TRUE_CAMERA, plane_errors, stripe_views, true_poses
from scipy.spatial.transform import Rotation

from ringpose.calibrate.boards.corner_errors import without_distortion_bias
from ringpose.calibrate.camera.parameters import CameraModel, parameters_of
from ringpose.calibrate.camera.pipeline import assessed_camera
from ringpose.calibrate.mount.closed_form import Transform
from ringpose.calibrate.mount.pipeline import calibrate_mount
from ringpose.calibrate.mount.quality import whole_rig_lines, whole_rig_quality
from ringpose.calibrate.mount.stations import Station
from ringpose.calibrate.mount.whole_rig import whole_rig
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes, evidence_of
from ringpose.calibrate.planes.quality import PlanesAssessment, planes_verdict
from ringpose.types.board import BoardViews

NAMES = ("left", "middle", "right")
MOUNT = Transform(Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix(), np.array([0.03, -0.02, 0.08]))
BOARD = Transform(Rotation.from_rotvec([2.9, 0.3, 0.1]).as_matrix(), np.array([0.6, 0.1, 0.05]))


def session(rng, views=10, robot=(2e-4, 1e-4), corner_px=0.1, center_px=0.03):
    """Stripe views of the four-marker board, and the robot's poses with independent errors."""
    seen = true_poses(rng, views)
    shots = stripe_views(seen, rng, corner_px, center_px)
    stations = []
    for shot, pose in zip(shots, seen, strict=True):
        true = BOARD.after(MOUNT.after(Transform(*pose)).inverse())
        error = Transform(Rotation.from_rotvec(rng.normal(0, robot[0], 3)).as_matrix(), rng.normal(0, robot[1], 3))
        stations.append(Station(view=shot.board, base_from_tool=true.after(error.inverse())))
    return shots, stations


def solved(shots, stations):
    boards = BoardViews()
    boards.views = [shot.board for shot in shots]
    boards.image_width, boards.image_height = TRUE_CAMERA.image_width, TRUE_CAMERA.image_height
    camera = assessed_camera(boards, CameraModel(fix_k3=True))
    own, model = camera.calibration.camera, PlanesModel(names=NAMES)
    planes = calibrate_planes(shots, own, model)
    assessment = PlanesAssessment(
        calibration=planes, verdict=planes_verdict(planes, (), (), None), paper=None, without_board=()
    )
    unbiased = [replace(shot, board=without_distortion_bias(shot.board, own)) for shot in shots]
    mount = calibrate_mount(stations, own)
    return whole_rig(camera, assessment, evidence_of(unbiased, own, model)[0], mount), mount


def mount_error(found) -> np.ndarray:
    estimated = found.solution.state.mount
    turn = Rotation.from_matrix(MOUNT.rotation @ estimated.rotation.T).as_rotvec()
    return np.append(turn, MOUNT.translation_m - estimated.translation_m)


def rig_error(found) -> np.ndarray:
    """Of the camera's parameters, then of the planes."""
    camera = parameters_of(TRUE_CAMERA) - parameters_of(found.planes.calibration.camera)
    return np.append(camera, plane_errors(found.planes.calibration))


@pytest.mark.slow
def test_exact_views_give_the_true_rig(rng):
    shots, stations = session(rng, views=5, robot=(0.0, 0.0), corner_px=1e-4, center_px=1e-4)

    found, _ = solved(shots, stations)

    assert max(found.separate.rms_m, found.joint.rms_m) < 2e-6
    np.testing.assert_allclose(mount_error(found.mount), 0.0, atol=1e-5)
    np.testing.assert_allclose(found.planes.calibration.planes.normal, NORMALS, atol=1e-5)
    np.testing.assert_allclose(found.planes.calibration.planes.distance_m, DISTANCES_M, atol=1e-5)


def test_views_left_out_decide_and_both_errors_are_reported(rng):
    found, _ = solved(*session(rng, views=5))

    assert found.is_joint == (found.joint.rms_m < found.separate.rms_m)
    assert np.isfinite(found.joint.stripes_m).all()
    lines = " ".join(whole_rig_lines(found))
    assert f"{1e3 * found.joint.rms_m:.2f} mm" in lines
    assert f"{1e3 * found.separate.rms_m:.2f} mm" in lines
    held_out = whole_rig_quality(found)["held_out"]
    assert held_out["separate"]["stripes_rms_m"] == found.separate.rms_m
    # the error of the robot's pose, half a metre away; one pixel across a stripe is 2.5 mm
    assert 5e-5 < found.joint.rms_m < 5e-4
    sigmas = np.sqrt(np.diag(found.mount.covariance)[:6])
    assert np.abs(mount_error(found.mount) / sigmas).max() < 4.5
    assert np.abs(plane_errors(found.planes.calibration)).max() < 3e-3


@pytest.mark.slow
def test_the_joint_solution_is_nearer_to_the_truth_and_as_accurate_as_reported(rng):
    """With inexact corners the robot's motions determine the camera better than the corners alone."""
    nees, errors = joint_figures(rng, 6)

    # at most as large as stated; less, as ten views do not exclude a systematic error of the robot, which has none here
    highest = chi_squared([0.9995], 6 * 6)[0] / (6 * 6)
    assert nees.min() > 0.35
    assert nees.max() < highest
    assert errors[1] < errors[0]


def joint_figures(rng, sessions: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean NEES of the mount, and of camera and planes; rms error (m) of the separate and the kept mount."""
    nees, errors = [], []
    for _ in range(sessions):
        found, separate = solved(*session(rng, corner_px=0.4))
        error, rig = mount_error(found.mount), rig_error(found)
        covariance = found.planes.calibration.covariance.data
        free = np.diag(covariance) > 0
        nees.append([
            error @ np.linalg.solve(found.mount.covariance[:6, :6], error) / 6,
            rig[free] @ np.linalg.solve(covariance[np.ix_(free, free)], rig[free]) / free.sum(),
        ])  # fmt: skip
        errors.append([np.sum(mount_error(separate)[3:] ** 2), np.sum(error[3:] ** 2)])
    return np.mean(nees, axis=0), np.sqrt(np.mean(errors, axis=0))
