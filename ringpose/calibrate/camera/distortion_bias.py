"""Bias of marker corners and circle centres caused by lens distortion (ringpose-method(7), section 7).

Corners of markers are intersections of parabolas fitted to the sides. The second term of the radial distortion bends a
side of 120 px near the image's corner by 0.004 px more than a parabola can follow, which at its ends is half of the
noise. The centroid of a circle of radius 10 px is displaced by as much from the projection of its centre, in addition
to the displacement by perspective. Both are systematic, and can be computed from an approximate camera.
"""

from dataclasses import replace

import numpy as np

from ringpose.calibrate.boards.corner_errors import endpoint_for_correlation, side_normals
from ringpose.calibrate.boards.patterns.circles import seen_offsets
from ringpose.calibrate.boards.pose import board_pose
from ringpose.geometry.rays import project
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardView
from ringpose.types.rig import Camera

_SAMPLES = 33


def without_distortion_bias(view: BoardView, camera: Camera) -> BoardView:
    """The view with marker corners or circle centres corrected for the bias; chessboard corners have none."""
    if not view.circle_radius_m and not view.end_correlation:
        return view
    pose = board_pose(view, camera)
    points_m = view.points_board_m @ pose.rotation.T + pose.translation_m
    if view.circle_radius_m:
        # Undo the correction for perspective alone, and apply the one for perspective and distortion.
        centroids_px = view.points_px + seen_offsets(view.points_board_m, view.points_px, view.circle_radius_m)
        corrected = centroids_px - _circle_offsets(points_m, view.circle_radius_m * pose.rotation[:, :2], camera)
    else:
        corrected = _corrected_corners(points_m, view, camera)
    return replace(view, points_px=corrected)


def _circle_offsets(
    points_m: Float64[Array, "corner xyz=3"], axes_m: Float64[Array, "xyz=3 axis=2"], camera: Camera
) -> Float64[Array, "corner xy=2"]:
    """Centroid of each projected circle minus the projection of its centre."""
    angle = 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    rims_m = points_m[:, None] + np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ axes_m.T
    return _centroids(project(rims_m, camera)) - project(points_m, camera)


def _centroids(outlines: Float64[Array, "corner point xy=2"]) -> Float64[Array, "corner xy=2"]:
    """Centroids of polygons (shoelace formula)."""
    middle = outlines.mean(axis=1, keepdims=True)
    here = outlines - middle
    after = np.roll(here, -1, axis=1)
    twice = here[..., 0] * after[..., 1] - here[..., 1] * after[..., 0]
    return middle[:, 0] + np.einsum("cp,cpk->ck", twice, here + after) / (3 * twice.sum(axis=1, keepdims=True))


def _corrected_corners(
    points_m: Float64[Array, "corner xyz=3"], view: BoardView, camera: Camera
) -> Float64[Array, "corner xy=2"]:
    """Corners of markers, corrected for the distances between the fitted parabolas and the true sides at their ends."""
    at_start, at_end = _parabola_errors(
        points_m.reshape(-1, 4, 3), camera, endpoint_for_correlation(view.end_correlation)
    )
    corners = view.points_px.reshape(-1, 4, 2)
    normals = side_normals(corners)
    sides = np.stack([normals, np.roll(normals, 1, axis=1)], axis=-2)
    errors = np.stack([at_start, np.roll(at_end, 1, axis=1)], axis=-1)
    corrected: Float64[Array, "corner xy=2"] = corners - np.linalg.solve(sides, errors[..., None])[..., 0]
    return corrected.reshape(-1, 2)


def _parabola_errors(
    points_m: Float64[Array, "marker corner=4 xyz=3"], camera: Camera, end: float
) -> tuple[Float64[Array, "marker side=4"], Float64[Array, "marker side=4"]]:
    """Distance of a side's parabola outside the true side at its start and at its end, in pixels.

    The parabola is fitted on -1 to 1; the side ends at -`end` and `end`.
    """
    fitted = np.linspace(-1.0, 1.0, _SAMPLES)
    share = 0.5 * (1.0 + np.array([-1.0, *(fitted / end), 1.0]))
    start, stop = points_m[..., None, :], np.roll(points_m, -1, axis=1)[..., None, :]
    pixels = project(((1.0 - share[:, None]) * start + share[:, None] * stop).reshape(-1, 3), camera)
    curve = pixels.reshape(*points_m.shape[:2], -1, 2)
    across = np.einsum("msnk,msk->msn", curve - curve[:, :, :1], side_normals(curve[:, :, 0]))
    parabola = np.linalg.lstsq(np.vander(fitted, 3), across[..., 1:-1].reshape(-1, _SAMPLES).T)[0]
    at_ends = (np.vander(np.array([-end, end]), 3) @ parabola).T.reshape(*points_m.shape[:2], 2)
    errors = at_ends - across[..., [0, -1]]
    return errors[..., 0], errors[..., 1]
