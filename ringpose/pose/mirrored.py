"""Evidence that an image is mirrored left to right, looked for in shots whose break points have several explanations.

Light planes along the rows draw nearly the same stripes in a mirrored image, so that the detector finds a ring in it,
too: only the estimate shows that no ring is where the break points are.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rays import project, undistorted_pixels, undistorted_rays
from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import Assumptions
from ringpose.types.detection import BreakPoints
from ringpose.types.pose import HARMLESS_FLAGS, KnownRadii, Ring, RingPose
from ringpose.types.rig import Camera, Rig


def fits_if_mirrored(
    break_points: BreakPoints,
    rig: Rig,
    known: KnownRadii | Sequence[Ring] | None,
    assumptions: Assumptions,
    camera: CameraMotion | None,
) -> bool:
    """Whether the mirror image of the break points is that of a ring, with all ends and without any contradiction.

    It holds for none of 107 drawn shots that have no pose because a stripe is on another surface.
    """
    if not break_points.seen.all():
        return False
    result = most_likely_pose(mirrored(break_points, rig.camera), rig, None, known, assumptions, camera=camera)
    return isinstance(result.pose, RingPose) and not result.rejected and not result.flags & ~HARMLESS_FLAGS


def mirrored(break_points: BreakPoints, camera: Camera) -> BreakPoints:
    """The break points on one arc as they would be in the mirror image; those of repeated frames are left out."""
    return replace(
        break_points,
        position_px=_mirrored_px(break_points.position_px, camera),
        covariance_px2=break_points.covariance_px2 * np.array([[1.0, -1.0], [-1.0, 1.0]]),
        face_start_undistorted_px=_mirrored_undistorted_px(break_points.face_end_undistorted_px, camera),
        face_end_undistorted_px=_mirrored_undistorted_px(break_points.face_start_undistorted_px, camera),
        face_sigma_px=break_points.face_sigma_px[:, ::-1],
        repeated=None,
        opposite=None,
    )


def _mirrored_px(position_px: Float64[Array, "*n xy=2"], camera: Camera) -> Float64[Array, "*n xy=2"]:
    x, y = position_px[..., 0], position_px[..., 1]
    return np.stack([camera.image_width - 1 - x, y], axis=-1)


def _mirrored_undistorted_px(points_px: Float64[Array, "n xy=2"], camera: Camera) -> Float64[Array, "n xy=2"]:
    """Undistorted pixels after the image itself, which is distorted, was mirrored."""
    in_image_px = project(undistorted_rays(points_px, camera), camera)
    return undistorted_pixels(_mirrored_px(in_image_px, camera), camera)
