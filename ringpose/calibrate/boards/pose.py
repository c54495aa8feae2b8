"""Pose of a board in the camera frame (ringpose-method(7), section 6)."""

from dataclasses import replace

import cv2
import numpy as np

from ringpose.geometry.rotations import angle_between, rotation_vector
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.rig import Camera

MIRRORED_RAD = 0.01
"""Minima whose normals differ by less are the same."""

AMBIGUITY_FACTOR = 1.5
"""A mirrored solution is a candidate if its error is below this multiple of the better solution's."""

_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)


def board_pose(view: BoardView, camera: Camera) -> BoardPose:
    """The pose with the minimum reprojection error over all corners.

    The error of a distant plane has two local minima, mirrored in depth: both are refined, and the better one is used.
    """
    return board_poses(view, camera)[0]


def board_poses(view: BoardView, camera: Camera) -> list[BoardPose]:
    """The board's pose by the corners, followed by the pose mirrored in depth if the corners fit both."""
    refined = []
    for start in _planar_candidates(view, camera):
        vector, translation = cv2.solvePnPRefineLM(
            view.points_board_m,
            view.points_px,
            camera.camera_matrix,
            camera.distortion_coefficients,
            rotation_vector(start.rotation).reshape(3, 1),
            start.translation_m.reshape(3, 1).copy(),
            _CRITERIA,
        )
        rotation = np.asarray(cv2.Rodrigues(vector)[0], dtype=np.float64)
        refined.append(_pose(view, rotation, np.asarray(translation, dtype=np.float64).ravel(), camera))
    refined.sort(key=lambda pose: pose.residual_rms_px)
    limit = AMBIGUITY_FACTOR * refined[0].residual_rms_px
    normal = refined[0].rotation[:, 2]
    distinct = [pose for pose in refined[1:] if angle_between(pose.rotation[:, 2], normal) > MIRRORED_RAD]
    return [refined[0], *(pose for pose in distinct if pose.residual_rms_px <= limit)]


def _planar_candidates(view: BoardView, camera: Camera) -> list[BoardPose]:
    """The two poses by IPPE, a closed form for planes (Collins and Bartoli 2014), the better one first."""
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        view.points_board_m,
        view.points_px,
        camera.camera_matrix,
        camera.distortion_coefficients,
        flags=cv2.SOLVEPNP_IPPE,
    )
    poses = [
        _pose(view, np.asarray(cv2.Rodrigues(r)[0], dtype=np.float64), np.asarray(t, dtype=np.float64).ravel(), camera)
        for r, t in zip(rotations, translations, strict=True)
    ]
    return sorted(poses, key=lambda pose: pose.residual_rms_px)


def _pose(
    view: BoardView, rotation: Float64[Array, "3 3"], translation_m: Float64[Array, "xyz=3"], camera: Camera
) -> BoardPose:
    """The pose with its rms residual over the corners of the view."""
    pose = BoardPose(name=view.name, rotation=rotation, translation_m=translation_m, residual_rms_px=float("nan"))
    rms_px = float(np.sqrt(np.mean(np.sum(residuals(view, pose, camera) ** 2, axis=1))))
    return replace(pose, residual_rms_px=rms_px)


def residuals(view: BoardView, pose: BoardPose, camera: Camera) -> Float64[Array, "corner xy=2"]:
    """Measured minus projected corners, in pixels."""
    pixels, _ = cv2.projectPoints(
        view.points_board_m,
        rotation_vector(pose.rotation),
        pose.translation_m,
        camera.camera_matrix,
        camera.distortion_coefficients,
    )
    return view.points_px - np.asarray(pixels, dtype=np.float64).reshape(-1, 2)


def marker_average_pose(view: BoardView, camera: Camera) -> BoardPose:
    """The paper's pose: the mean over the poses of the single markers (section 4 of the paper).

    Each marker has two solutions (IPPE). The solution with the smaller reprojection error is used. Where the errors are
    similar, it is the solution whose normal agrees best with that of the marker with the smallest error. Rotations are
    averaged as matrices and projected to the nearest rotation.
    """
    markers = []
    for marker in np.unique(view.ids // 4):
        own = view.ids // 4 == marker
        part = replace(view, ids=view.ids[own], points_board_m=view.points_board_m[own], points_px=view.points_px[own])
        poses = _planar_candidates(part, camera)
        limit = AMBIGUITY_FACTOR * poses[0].residual_rms_px + 1e-6
        markers.append([pose for pose in poses if pose.residual_rms_px <= limit])
    best = min((marker[0] for marker in markers), key=lambda pose: pose.residual_rms_px)
    chosen = [max(marker, key=lambda pose: float(pose.rotation[:, 2] @ best.rotation[:, 2])) for marker in markers]
    mean = np.mean([pose.rotation for pose in chosen], axis=0)
    left, _, right = np.linalg.svd(mean)
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return _pose(view, rotation, np.mean([pose.translation_m for pose in chosen], axis=0), camera)


def moved_pose(pose: BoardPose, step: Float64[Array, "pose=6"]) -> BoardPose:
    """The pose with a step added to its rotation vector and translation."""
    rotation = cv2.Rodrigues(rotation_vector(pose.rotation) + step[:3])[0]
    return replace(pose, rotation=np.asarray(rotation, dtype=np.float64), translation_m=pose.translation_m + step[3:])


def projection(
    points: Float64[Array, "corner xyz=3"], pose: BoardPose, camera: Camera
) -> tuple[
    Float64[Array, "corner xy=2"], Float64[Array, "corner xy=2 pose=6"], Float64[Array, "corner xy=2 parameter"]
]:
    """Pixels, and their Jacobians with respect to pose (rotation vector, translation) and intrinsic parameters."""
    pixels, jacobian = cv2.projectPoints(
        points, rotation_vector(pose.rotation), pose.translation_m, camera.camera_matrix, camera.distortion_coefficients
    )
    both = np.asarray(jacobian, dtype=np.float64)
    parameters = 4 + len(camera.distortion_coefficients)
    both = both.reshape(len(points), 2, -1)
    return np.asarray(pixels, dtype=np.float64)[:, 0], both[..., :6], both[..., 6 : 6 + parameters]
