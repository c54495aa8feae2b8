"""Whether the ends of the face's tracks make one ring, which of them is hidden, and where the ring's centre lies."""

from dataclasses import dataclass, replace
from functools import lru_cache

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

Tracks = Float64[Array, "track column=11"]
"""Rows of `Track`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ends:
    """The ends of the face's tracks, left then right, in distorted pixels; NaN where none was seen."""

    position_px: Float64[Array, "laser end=2 xy=2"]
    covariance_px2: Float64[Array, "laser end=2 xy=2 xy=2"]
    flags: Int64[Array, "laser end=2"]
    straight_x: Float64[Array, "laser end=2"]
    """The tracks' own ends, undistorted columns."""
    straight_sigma_px: Float64[Array, "laser end=2"]
    """Of the tracks' ordinates there."""

    @property
    def seen(self) -> Bool[Array, "laser end=2"]:
        """Which of them were seen."""
        seen: Bool[Array, "laser end=2"] = ~np.isnan(self.position_px[..., 0])
        return seen


def checked(ends: Ends, tracks: Tracks, rig: Rig) -> tuple[Ends, bool, bool]:
    """The ends without a hidden one; whether the ring's centre lies to the right of the stripes; whether that is clear.

    The sign of the arcs' curvature tells the side: if the centre lies to the right, right ends are inner ones.
    """
    left, right = np.count_nonzero(ends.seen, axis=0).tolist()
    if left + right < FITTED_EXACTLY or not (left and right):
        return ends, False, False
    fit = _fit(ends, left + right, rig)
    if left + right >= 6 and fit.cost - np.nanmin(fit.cost_without) > OCCLUDED_COST:
        return checked(_without_hidden(ends, fit, tracks, rig), tracks, rig)
    return ends, fit.curvature > 0, abs(fit.curvature) > SIDE_SIGMAS * fit.curvature_sigma


def _without_hidden(ends: Ends, fit: ArcFit, tracks: Tracks, rig: Rig) -> Ends:
    """The ends without the one that lies off the circles of the others.

    If both ends of its stripe would do, the one beside a stripe on something nearer than the face is hidden;
    if that decides nothing, both are left out.
    """
    suspects = np.argwhere(fit.cost_without < np.nanmin(fit.cost_without) + TIE)
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


def _beside_something_nearer(ends: Ends, laser: int, side: int, tracks: Tracks, rig: Rig) -> bool:
    """Whether a stripe of the same laser begins beside an end and, by its depth, in front of the face."""
    points = intersect(rays(ends.position_px[ends.seen], rig.camera), *_planes_of_seen(ends, rig))
    towards = towards_camera(nearest_plane(points)[0], points.mean(axis=0))
    end_x = float(ends.straight_x[laser, side])
    for track in (Track(*row) for row in tracks.tolist()):
        near_x = track.x_end if side == 0 else track.x_start
        outward = (near_x - end_x) * (-1 if side == 0 else 1)
        if track.laser in (laser, UNLABELLED) and -BESIDE_PX / 4 < outward < BESIDE_PX:
            ray = undistorted_rays(np.array([near_x, track.y(near_x)]), rig.camera)
            point = intersect(ray, rig.lasers.normal[laser], np.asarray(rig.lasers.distance_m[laser]))
            if towards @ (point - points.mean(axis=0)) > IN_FRONT_M:
                return True
    return False


def _planes_of_seen(ends: Ends, rig: Rig) -> tuple[Float64[Array, "n xyz=3"], Float64[Array, "n"]]:
    """Normal and distance of the light plane of each end that was seen."""
    laser = np.nonzero(ends.seen)[0]
    return rig.lasers.normal[laser], rig.lasers.distance_m[laser]


def _fit(ends: Ends, seen: int, rig: Rig) -> ArcFit:
    """How well so many ends fit two arcs about one centre, in the plane nearest to them."""
    along_px = np.sqrt(ends.covariance_px2[..., 0, 0])
    if seen <= FITTED_EXACTLY:
        along_px = np.hypot(along_px, CIRCLE_SIGMA_PX)
    return arc_fit(ends.position_px, along_px, _planes(rig), lens(rig.camera), CIRCLE_SIGMA_PX)


@lru_cache(maxsize=4)
def _planes(rig: Rig) -> Float64[Array, "laser normal_and_distance=4"]:
    """The light planes."""
    return np.concatenate([rig.lasers.normal, rig.lasers.distance_m[:, None]], axis=1)
