"""How a lens bends sides and circles, and moves what is taken for corners and centres (ringpose-method(7), section 7).

Corners of markers are where parabolas meet that were drawn through the sides. The second term of the radial distortion
bends a side of 120 px near the image's corner by 0.004 px more than a parabola follows, which at its ends is half of
the noise. A circle of 10 px has its middle as far from where its centre is seen, beside what perspective does. Both are
the same in every view, and known once the camera roughly is.
"""

from dataclasses import replace

import numpy as np

from ringpose.calibrate.boards.circles import seen_offsets
from ringpose.calibrate.boards.corner_errors import endpoint_for_correlation, side_normals
from ringpose.calibrate.boards.pose import board_pose
from ringpose.geometry.rays import project
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardView
from ringpose.types.camera import Camera

_SAMPLES = 33


def without_distortion_bias(view: BoardView, camera: Camera) -> BoardView:
    """The view with its corners where they would be if the lens bent nothing near them; others stay as they are."""
    if not view.circle_radius_m and not view.likeness:
        return view
    pose = board_pose(view, camera)
    places_m = view.points_board_m @ pose.rotation.T + pose.translation_m
    if view.circle_radius_m:
        middles_px = view.points_px + seen_offsets(view.points_board_m, view.points_px, view.circle_radius_m)
        moved = middles_px - _circle_offsets(places_m, view.circle_radius_m * pose.rotation[:, :2], camera)
    else:
        moved = _unbent_corners(places_m, view, camera)
    return replace(view, points_px=moved)


def _circle_offsets(
    places_m: Float64[Array, "corner xyz=3"], axes_m: Float64[Array, "xyz=3 axis=2"], camera: Camera
) -> Float64[Array, "corner xy=2"]:
    """Middle of what is seen of a circle less where its centre is seen."""
    angle = 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    rims_m = places_m[:, None] + np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ axes_m.T
    offsets: Float64[Array, "corner xy=2"] = _centroids(project(rims_m, camera)) - project(places_m, camera)
    return offsets


def _centroids(outlines: Float64[Array, "corner point xy=2"]) -> Float64[Array, "corner xy=2"]:
    """Of the areas that the outlines enclose."""
    middle = outlines.mean(axis=1, keepdims=True)
    here = outlines - middle
    after = np.roll(here, -1, axis=1)
    twice = here[..., 0] * after[..., 1] - here[..., 1] * after[..., 0]
    centroids: Float64[Array, "corner xy=2"] = middle[:, 0] + np.einsum("cp,cpk->ck", twice, here + after) / (
        3 * twice.sum(axis=1, keepdims=True)
    )
    return centroids


def _unbent_corners(
    places_m: Float64[Array, "corner xyz=3"], view: BoardView, camera: Camera
) -> Float64[Array, "corner xy=2"]:
    """Where parabolas would meet if they followed the sides."""
    along, beyond = _missed_at_ends(places_m.reshape(-1, 4, 3), camera, endpoint_for_correlation(view.likeness))
    corners = view.points_px.reshape(-1, 4, 2)
    normals = side_normals(corners)
    sides = np.stack([normals, np.roll(normals, 1, axis=1)], axis=-2)
    missed = np.stack([along, np.roll(beyond, 1, axis=1)], axis=-1)
    moved: Float64[Array, "corner xy=2"] = (corners - np.linalg.solve(sides, missed[..., None])[..., 0]).reshape(-1, 2)
    return moved


def _missed_at_ends(
    places_m: Float64[Array, "marker corner=4 xyz=3"], camera: Camera, end: float
) -> tuple[Float64[Array, "marker side=4"], Float64[Array, "marker side=4"]]:
    """How far outside the true side its parabola is at the start and at the end, in pixels."""
    drawn = np.linspace(-1.0, 1.0, _SAMPLES)
    share = 0.5 * (1.0 + np.array([-1.0, *(drawn / end), 1.0]))
    start, stop = places_m[..., None, :], np.roll(places_m, -1, axis=1)[..., None, :]
    pixels = project(((1.0 - share[:, None]) * start + share[:, None] * stop).reshape(-1, 3), camera)
    curve = pixels.reshape(*places_m.shape[:2], -1, 2)
    across = np.einsum("msnk,msk->msn", curve - curve[:, :, :1], side_normals(curve[:, :, 0]))
    powers = np.vander(drawn, 3)
    parabola = np.linalg.lstsq(powers, across[..., 1:-1].reshape(-1, _SAMPLES).T)[0]
    at_ends = (np.vander(np.array([-end, end]), 3) @ parabola).T.reshape(*places_m.shape[:2], 2)
    missed = at_ends - across[..., [0, -1]]
    return missed[..., 0], missed[..., 1]
