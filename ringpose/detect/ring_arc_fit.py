"""The arcs that explain break points, the stripes' lines on the face, and edge points, by robust least squares."""

from dataclasses import dataclass

import numpy as np

from ringpose.geometry.planes import towards_camera
from ringpose.geometry.rays import intersect, rays, undistorted_rays
from ringpose.geometry.ring_arcs import RingArcs
from ringpose.kernels import edges as kernels
from ringpose.kernels.edges import FitParams, PlanePoints, Sights
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import BreakPoints
from ringpose.types.rig import Rig

TILT_SIGMA_RAD = 0.4
"""Prior of the ring's tilt out of facing the camera; the stripes' lines say much more about all but one direction."""

TURN_SIGMA_RAD = 0.6
"""Prior of the angle between the stripes on the face and the radius."""

CURVATURE_SIGMA = 2.5
"""Prior of one over the radius, in 1/m: adapter rings have radii of 0.4 to 1.5 m, and either side is possible."""

HALF_BAND_M = (0.018, 0.008)
"""Prior of half the band's width, mean and sigma: 20 to 60 mm wide."""

LINE_SIGMA_PX = 0.1
"""What the calibration may add to the sigma of a stripe's line across itself."""

END_SIGMA_PX = 0.4
"""What calibration and the material may add to the sigma of a break point."""

MAX_END_SIGMA_PX = 1.5
"""Ends that may as well lie elsewhere are first taken to lie where they seem to: the edges that are looked for there
tell if they do, and two ends predict an edge well enough for that."""

POSSIBLE = ((0.03, 5.0), (0.001, 0.1), (0.1, 1.1), (-1.0, 10.0))
"""Limits of depth and half band in metres, of the normal's cosine with the view, of the curvature in 1/m."""

MAX_STEP = (0.5, 0.5, 0.2, 0.2, 0.5, 3.0, 0.02)
"""Largest change of each number of the state in one round, beyond which derivatives mean nothing."""

OUTLIER_SIGMAS = 3.0
"""Where a sight begins to count less; its weight falls as the fourth power beyond."""


RULES = FitParams(
    rounds=2,
    outlier_sigmas=OUTLIER_SIGMAS,
    tilt_sigma_rad=TILT_SIGMA_RAD,
    turn_sigma_rad=TURN_SIGMA_RAD,
    curvature_sigma=CURVATURE_SIGMA,
    half_band_m=HALF_BAND_M[0],
    half_band_sigma_m=HALF_BAND_M[1],
    max_step=MAX_STEP,
)

NO_SIGHTS = Sights(np.zeros((0, 3)), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeEvidence:
    """What the stripes alone say: points of the ring's plane, and the break points."""

    plane: PlanePoints
    ends: Sights
    start: RingArcs
    """First guess, and the frame of the priors: facing the camera, straight."""


def stripe_evidence(break_points: BreakPoints, rig: Rig) -> StripeEvidence | None:
    """The evidence in the break points; None without a stripe's line on the face and two of its ends."""
    lasers = np.flatnonzero(np.isfinite(break_points.face_start_px[:, 0]))
    line_px = np.stack([break_points.face_start_px, break_points.face_end_px], axis=1)[lasers]
    plane_point = _on_light(undistorted_rays(line_px, rig.camera), lasers, rig)
    moved_point = _on_light(undistorted_rays(line_px + np.array([0.0, 1.0]), rig.camera), lasers, rig)
    in_space = np.isfinite(plane_point + moved_point).all(axis=(1, 2))
    lasers, plane_point, moved_point = lasers[in_space], plane_point[in_space], moved_point[in_space]
    position = _on_light(rays(break_points.position_px, rig.camera), np.arange(len(break_points.flags)), rig)
    seen = np.isfinite(position[..., 0])
    if not len(lasers) or not seen.any(axis=0).all():
        return None
    position, side = position[seen], np.broadcast_to([1.0, -1.0], seen.shape)[seen]
    start = _facing(plane_point, position, side)
    if not possible(start):
        return None
    line_sigma_px = np.hypot(break_points.face_sigma_px[lasers], LINE_SIGMA_PX)
    end_sigma_px = np.hypot(np.sqrt(break_points.covariance_px2[seen][:, 0, 0]), END_SIGMA_PX)
    end_sigma_px = np.minimum(end_sigma_px, MAX_END_SIGMA_PX)
    return StripeEvidence(
        plane=PlanePoints(
            point=plane_point.reshape(-1, 3),
            sigma_m=(np.abs((moved_point - plane_point) @ start.axes[2]) * line_sigma_px).ravel(),
        ),
        ends=Sights(ray=position, side=side, sigma_m=end_sigma_px * position[:, 2] / rig.camera.camera_matrix[0, 0]),
        start=start,
    )


def _on_light(ray: Float64[Array, "laser k xyz=3"], lasers: Array, rig: Rig) -> Float64[Array, "laser k xyz=3"]:
    return intersect(ray, rig.lasers.normal[lasers][:, None], rig.lasers.distance_m[lasers][:, None])


def _facing(
    lines: Float64[Array, "laser end=2 xyz=3"], ends: Float64[Array, "n xyz=3"], side: Float64[Array, "n"]
) -> RingArcs:
    """Straight edges across the stripes, on a plane that faces the camera as far as the stripes' direction allows."""
    along = (lines[:, 1] - lines[:, 0]).sum(axis=0)
    along /= np.linalg.norm(along)
    middle = lines.mean(axis=(0, 1))
    place = (ends - middle) @ along
    inner, outer = place[side > 0].mean(), place[side < 0].mean()
    across = along if inner > outer else -along
    origin = middle + (inner + outer) / 2 * along
    normal = towards_camera(origin - (origin @ across) * across, origin)
    normal /= np.linalg.norm(normal)
    return RingArcs(
        origin=origin,
        axes=np.stack([across, np.cross(normal, across), normal]),
        curvature=0.0,
        half_band_m=abs(inner - outer) / 2,
    )


def fitted_arcs(
    arcs: RingArcs, evidence: StripeEvidence, edges: Sights, rules: FitParams = RULES
) -> tuple[RingArcs, Float64[Array, "state=7 state=7"]]:
    """The arcs after some rounds of Gauss-Newton from `arcs`, and the covariance of their state."""
    sights = Sights(*(np.concatenate(both) for both in zip(evidence.ends, edges, strict=True)))
    return kernels.fitted_arcs(arcs, evidence.plane, sights, evidence.start.axes, rules)


def possible(arcs: RingArcs) -> bool:
    """Whether a ring in front of a camera can have these arcs; a fit of contradictions leads anywhere."""
    numbers = [arcs.origin[2], arcs.half_band_m, -arcs.axes[2, 2], abs(arcs.curvature)]
    return all(least < number < most for number, (least, most) in zip(numbers, POSSIBLE, strict=True))
