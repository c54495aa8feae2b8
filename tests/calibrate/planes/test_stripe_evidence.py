"""Selection of views for the light planes, and remarks on the others."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from known_views import TRUE_CAMERA, board_view, stripe_views, true_poses

from ringpose.calibrate.boards.pose import board_pose
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.types.board import BoardPose

MODEL = PlanesModel(names=("left", "middle", "right"))
NOTHING = np.empty((0, 2))


def test_a_board_that_does_not_fit_is_left_out_by_name(rng):
    views = stripe_views(true_poses(rng, 6), rng, 0.02, 0.05)
    bent = replace(views[1].board, points_px=views[1].board.points_px + rng.normal(0, 3, (16, 2)))
    views[1] = replace(views[1], board=bent)

    found = calibrate_planes(views, TRUE_CAMERA, MODEL)

    assert [name for name, _ in found.remarks] == ["v1"]
    assert len(found.poses) == 5


def test_stripes_turn_a_board_back_that_its_corners_see_mirrored(rng):
    """The corners of a small board lie between those of its pose and of the mirrored pose, nearer to the latter."""
    small = 0.02 * np.stack(np.meshgrid([0, 1, 2], [0, 1, 2], [0.0]), axis=-1).reshape(-1, 3) + [0.13, 0.1, 0]
    views = stripe_views(true_poses(rng, 6), rng, 0.01, 0.05)
    turn = cv2.Rodrigues(np.array([0.25, 0.3, 0.0]))[0]
    place = np.array([0.0, 0.0, 0.7]) - turn @ [0.15, 0.12, 0.0]
    doubtful = stripe_views([(turn, place)], rng, 0.0, 0.05)[0]
    seen = board_view(small, (turn, place), "doubtful")
    mirrored = next(pose for pose in both_minima(seen, TRUE_CAMERA) if np.abs(pose.rotation - turn).max() > 0.1)
    other = board_view(small, (mirrored.rotation, mirrored.translation_m), "doubtful")
    seen = replace(seen, points_px=0.47 * seen.points_px + 0.53 * other.points_px)
    views.append(replace(doubtful, board=seen))

    found = calibrate_planes(views, TRUE_CAMERA, MODEL)

    assert np.abs(board_pose(seen, TRUE_CAMERA).rotation - turn).max() > 0.1
    assert found.poses[-1].name == "doubtful"
    assert np.abs(found.poses[-1].rotation - turn).max() < 0.1


def both_minima(view, camera) -> list[BoardPose]:
    _, vectors, places, _ = cv2.solvePnPGeneric(
        view.points_board_m,
        view.points_px,
        camera.camera_matrix,
        camera.distortion_coefficients,
        flags=cv2.SOLVEPNP_IPPE,
    )
    return [
        BoardPose(name="", rotation=cv2.Rodrigues(v)[0], translation_m=t.ravel(), residual_rms_px=0.0)
        for v, t in zip(vectors, places, strict=True)
    ]


@pytest.mark.parametrize(("rise_m", "reported"), [(0.0, ["seen"]), (0.2, [])], ids=["across the board", "beside it"])
def test_a_stripe_that_is_not_seen_is_reported_only_if_its_light_crosses_the_board(rise_m, reported, rng):
    """Raised by 0.2 m, the board is outside the plane of the left laser, at the bottom of the image."""
    views = stripe_views(true_poses(rng, 4), rng)
    turn, place = true_poses(rng, 1)[0]
    (seen,) = stripe_views([(turn, place - [0.0, rise_m, 0.0])], rng)
    crossing = seen.stripes_px[1:] if not rise_m else (NOTHING, NOTHING)
    without = replace(seen, board=replace(seen.board, name="seen"), stripes_px=(NOTHING, *crossing))

    calibration = calibrate_planes([*views, without], TRUE_CAMERA, MODEL)

    assert [name for name, remark in calibration.remarks if "left" in remark] == reported
