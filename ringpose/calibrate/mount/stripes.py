"""Stripes on the board, for an adjustment of camera, light planes and mount together (method(7), section 13)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.boards.corner_errors import ViewEquations, view_equations
from ringpose.calibrate.planes.joint_adjustment import robust_weights
from ringpose.calibrate.planes.stripes.errors import stripe_rays, stripe_residuals
from ringpose.geometry.rotations import tilted
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.rig import PLANE_PARAMETERS, Camera


class Planes(NamedTuple):
    """Light planes `normal @ point = distance_m` in the camera frame; none where only the corners are used."""

    normal: Float64[Array, "laser xyz=3"]
    distance_m: Float64[Array, "laser"]

    @property
    def parameters(self) -> int:
        """Number of their parameters: two tilts and a distance each."""
        return len(PLANE_PARAMETERS) * len(self.distance_m)

    def moved(self, step: Float64[Array, "parameter"]) -> "Planes":
        """After a step of the parameters."""
        steps = step.reshape(-1, len(PLANE_PARAMETERS))
        normal = [tilted(own, tilt) for own, tilt in zip(self.normal, steps[:, :2], strict=True)]
        return Planes(np.array(normal).reshape(-1, 3), self.distance_m + steps[:, 2])


NO_PLANES = Planes(np.zeros((0, 3)), np.zeros(0))


class Stripes(NamedTuple):
    """Stripe centres in one view, by laser, and the standard deviation of one (NaN without a stripe)."""

    points_px: tuple[Float64[Array, "_ xy=2"], ...]
    center_px: Float64[Array, "laser"]


def equations_with_stripes(
    view: BoardView, stripes: Stripes | None, pose: BoardPose, camera: Camera, planes: Planes, corner_px: float
) -> ViewEquations:
    """The equations of a view's corners and stripes; `wrt_camera` has the planes' parameters before the camera's."""
    corners = view_equations(view, pose, camera, corner_px)
    blocks: list[Sequence[Float64[Array, "..."]]] = [
        (corners.wrt_pose, np.zeros((len(corners.residual), planes.parameters)), corners.wrt_camera, corners.residual)
    ]
    for laser, (points_px, center_px) in enumerate(zip(*stripes, strict=True)) if stripes is not None else ():
        if not len(points_px):
            continue
        own = stripe_residuals(
            stripe_rays(points_px, camera), pose, planes.normal[laser], float(planes.distance_m[laser])
        )
        whole = np.zeros((len(points_px), len(planes.distance_m), len(PLANE_PARAMETERS)))
        whole[:, laser] = own.wrt_plane
        residual = own.residual_px / center_px
        # residuals here are what is measured less what is expected
        weight = np.sqrt(robust_weights(residual))[:, None]
        scale = -weight / center_px
        blocks.append(
            (
                scale * own.wrt_pose,
                scale * whole.reshape(len(whole), -1),
                scale * own.wrt_camera,
                weight[:, 0] * residual,
            )
        )
    wrt_pose, wrt_planes, wrt_camera, residuals = (np.concatenate(each) for each in zip(*blocks, strict=True))
    return ViewEquations(wrt_pose=wrt_pose, wrt_camera=np.hstack([wrt_planes, wrt_camera]), residual=residuals)
