"""Whether the ends of the face's tracks make one ring, which of them is hidden, and where the ring's centre lies."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringpose.detect.tracks import Track, lens
from ringpose.geometry.planes import nearest_plane, towards_camera
from ringpose.geometry.rays import intersect, rays, undistorted_rays
from ringpose.kernels.ring import ArcFit, arc_fit
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.break_points import BreakPointFlag
from ringpose.types.rig import Rig
from ringpose.types.stripes import UNLABELLED

CIRCLE_SIGMA_PX = 0.5
"""How far a refined end may lie from its circle besides its own sigma: calibration, an edge's chamfer."""

OCCLUDED_COST = 12.0
"""Drop in squared sigmas over two that calls one end of six occluded: below 1e-5 by chance, six ends tried."""

FITTED_EXACTLY = 4
"""Two arcs about one centre go through so many ends whatever their errors: nothing is left over that would show those
of calibration or of a stripe that is two."""

SIDE_SIGMAS = 2.0
"""How clearly the curvature must say on which side the ring's centre lies."""

TIE = 3.0
"""Two ends whose removal explains the rest this equally well cannot be told apart by the circles: if one end of
a stripe is wrong, another curvature makes the other end look wrong."""

IN_FRONT_M = 0.005
"""What stands out of the ring's face by more than this is not the ring."""

BESIDE_PX = 40.0
"""How far from an end a stripe on what hides it begins."""


Seen = Bool[Array, "track end=2"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ends:
    """The two ends of each face track, left then right, in distorted pixels."""

    laser: Int64[Array, "track"]
    position_px: Float64[Array, "track end=2 xy=2"]
    covariance_px2: Float64[Array, "track end=2 xy=2 xy=2"]
    flags: Int64[Array, "track end=2"]
    straight_x: Float64[Array, "track end=2"]
    """The tracks' own ends, undistorted columns."""
    straight_sigma_px: Float64[Array, "track end=2"]
    """Of the tracks' ordinates there."""


def checked(ends: Ends, tracks: Sequence[Track], rig: Rig) -> tuple[Ends, bool, bool]:
    """The ends without a hidden one; whether the ring's centre lies to the right of the stripes; whether that is clear.

    The sign of the arcs' curvature tells the side: if the centre lies to the right, right ends are inner ones.
    """
    seen = np.isfinite(ends.position_px[..., 0])
    if len(ends.laser) < 2 or np.count_nonzero(seen) < 4 or not seen.any(axis=0).all():
        return ends, False, False
    fit = _fit(ends, seen, rig)
    if np.count_nonzero(seen) >= 6 and fit.cost - fit.cost_without.min() > OCCLUDED_COST:
        return checked(_without_hidden(ends, seen, fit, tracks, rig), tracks, rig)
    return ends, fit.curvature > 0, abs(fit.curvature) > SIDE_SIGMAS * fit.curvature_sigma


def _without_hidden(ends: Ends, seen: Seen, fit: ArcFit, tracks: Sequence[Track], rig: Rig) -> Ends:
    """The ends without the one that lies off the circles of the others.

    If both ends of its stripe would do, the one beside a stripe on something nearer than the face is hidden;
    if that decides nothing, both are left out.
    """
    suspects = np.argwhere(seen)[fit.cost_without < fit.cost_without.min() + TIE]
    if len(suspects) > 1:
        beside = [each for each in suspects if _beside_something_nearer(ends, int(each[0]), int(each[1]), tracks, rig)]
        suspects = np.array(beside) if len(beside) == 1 else suspects
    return _without(ends, suspects)


def _without(ends: Ends, suspects: Int64[Array, "n 2"]) -> Ends:
    """The ends with some called occluded."""
    position, covariance, flags = ends.position_px.copy(), ends.covariance_px2.copy(), ends.flags.copy()
    which = tuple(suspects.T)
    position[which], covariance[which] = np.nan, np.nan
    flags[which] |= int(BreakPointFlag.OCCLUDED)
    return replace(ends, position_px=position, covariance_px2=covariance, flags=flags)


def _beside_something_nearer(ends: Ends, number: int, side: int, tracks: Sequence[Track], rig: Rig) -> bool:
    """Whether a stripe of the same laser begins beside an end and, by its depth, in front of the face."""
    laser = int(ends.laser[number])
    points = _points(ends, rig)[np.isfinite(ends.position_px[..., 0])]
    towards = towards_camera(nearest_plane(points)[0], points.mean(axis=0))
    end_x = float(ends.straight_x[number, side])
    for track in tracks:
        near_x = track.x_end if side == 0 else track.x_start
        outward = (near_x - end_x) * (-1 if side == 0 else 1)
        if track.laser in (laser, UNLABELLED) and -BESIDE_PX / 4 < outward < BESIDE_PX:
            ray = undistorted_rays(np.array([near_x, track.y(near_x)]), rig.camera)
            point = intersect(ray, rig.lasers.normal[laser], np.asarray(rig.lasers.distance_m[laser]))
            if towards @ (point - points.mean(axis=0)) > IN_FRONT_M:
                return True
    return False


def _points(ends: Ends, rig: Rig) -> Float64[Array, "track end=2 xyz=3"]:
    """The ends in the camera frame."""
    normal, distance = rig.lasers.normal[ends.laser][:, None], rig.lasers.distance_m[ends.laser][:, None]
    return intersect(rays(ends.position_px, rig.camera), normal, distance)


def _fit(ends: Ends, seen: Seen, rig: Rig) -> ArcFit:
    """How well the seen ends fit two arcs about one centre, in the plane nearest to them."""
    track, arc = np.nonzero(seen)
    planes = np.concatenate([rig.lasers.normal, rig.lasers.distance_m[:, None]], axis=1)
    along_px = np.sqrt(ends.covariance_px2[..., 0, 0][seen])
    if len(track) <= FITTED_EXACTLY:
        along_px = np.hypot(along_px, CIRCLE_SIGMA_PX)
    places = ends.position_px[seen]
    return arc_fit(places, arc.astype(np.int32), along_px, planes[ends.laser[track]], lens(rig.camera), CIRCLE_SIGMA_PX)
