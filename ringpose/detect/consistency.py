"""Whether the ends of the face's tracks make one ring, which of them is hidden, and where the ring's centre lies."""

from functools import lru_cache

import numpy as np

from ringpose.detect.tracks import lens
from ringpose.geometry.planes import nearest_plane, towards_camera
from ringpose.geometry.rays import intersect, rays, undistorted_rays
from ringpose.kernels.ends import Ends
from ringpose.kernels.lines import LASER, MIDDLE_X, MIDDLE_Y, SLOPE, X_END, X_START, ArcFit, arc_fit
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.detection import UNLABELLED, BreakPointFlag
from ringpose.types.rig import Rig

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
"""Columns as in `TRACK_COLUMNS`."""


def checked(ends: Ends, tracks: Tracks, rig: Rig) -> tuple[Ends, bool, bool]:
    """The ends without a hidden one; whether the ring's centre lies to the right of the stripes; whether that is clear.

    The sign of the arcs' curvature tells the side: if the centre lies to the right, right ends are inner ones.
    """
    planes, optics = _planes(rig), lens(rig.camera)
    fit = arc_fit(ends.position_px, ends.covariance_px2, planes, optics, CIRCLE_SIGMA_PX, FITTED_EXACTLY)
    if sum(fit.seen) < FITTED_EXACTLY or 0 in fit.seen:
        return ends, False, False
    if sum(fit.seen) >= 6 and fit.cost - min(fit.cost_without) > OCCLUDED_COST:
        return checked(_without_hidden(ends, fit, tracks, rig), tracks, rig)
    return ends, fit.curvature > 0, abs(fit.curvature) > SIDE_SIGMAS * fit.curvature_sigma


def _without_hidden(ends: Ends, fit: ArcFit, tracks: Tracks, rig: Rig) -> Ends:
    """The ends without the one that lies off the circles of the others.

    If both ends of its stripe would do, the one beside a stripe on something nearer than the face is hidden;
    if that decides nothing, both are left out.
    """
    cost_without = np.array(fit.cost_without).reshape(-1, 2)
    suspects = np.argwhere(cost_without < cost_without.min() + TIE)
    beside = [each for each in suspects if _beside_something_nearer(ends, int(each[0]), int(each[1]), tracks, rig)]
    if len(beside) == 1:
        return _without(ends, np.array(beside))
    labelled = np.isin(suspects[:, 0], tracks[:, LASER]).all()
    return _without(ends, suspects) if labelled else _without_stripes(ends, suspects)


def _without_stripes(ends: Ends, suspects: Int64[Array, "n 2"]) -> Ends:
    """The ends without stripes of which one is suspected: nothing hides it, and no laser is known to have drawn it."""
    lasers = np.unique(suspects[:, 0])
    left = _without(ends, np.stack([np.repeat(lasers, 2), np.tile([0, 1], len(lasers))], axis=1))
    straight, sigma = ends.straight_px.copy(), ends.straight_sigma_px.copy()
    straight[lasers], sigma[lasers] = np.nan, np.nan
    return left._replace(straight_px=straight, straight_sigma_px=sigma)


def _without(ends: Ends, suspects: Int64[Array, "n 2"]) -> Ends:
    """The ends with some called occluded."""
    position, covariance, flags = ends.position_px.copy(), ends.covariance_px2.copy(), ends.flags.copy()
    which = tuple(suspects.T)
    position[which], covariance[which] = np.nan, np.nan
    flags[which] |= int(BreakPointFlag.OCCLUDED)
    return ends._replace(position_px=position, covariance_px2=covariance, flags=flags)


def _beside_something_nearer(ends: Ends, laser: int, side: int, tracks: Tracks, rig: Rig) -> bool:
    """Whether a stripe of the same laser begins beside an end and, by its depth, in front of the face."""
    seen = ~np.isnan(ends.position_px[..., 0])
    planes = np.repeat(_planes(rig), 2, axis=0)[seen.ravel()]
    points = intersect(rays(ends.position_px[seen], rig.camera), planes[:, :3], planes[:, 3])
    points = points[np.isfinite(points).all(axis=1)]
    towards = towards_camera(nearest_plane(points)[0], points.mean(axis=0))
    own = np.isin(tracks[:, LASER], [laser, UNLABELLED])
    near_x = tracks[:, X_END if side == 0 else X_START]
    outward = (near_x - ends.straight_px[laser, side, 0]) * (-1 if side == 0 else 1)
    beside = own & (outward > -BESIDE_PX / 4) & (outward < BESIDE_PX)
    near_y = tracks[:, MIDDLE_Y] + tracks[:, SLOPE] * (near_x - tracks[:, MIDDLE_X])
    directions = undistorted_rays(np.stack([near_x, near_y], axis=-1)[beside], rig.camera)
    stripe = intersect(directions, rig.lasers.normal[[laser]], rig.lasers.distance_m[[laser]])
    return bool(np.any((stripe - points.mean(axis=0)) @ towards > IN_FRONT_M))


@lru_cache(maxsize=4)
def _planes(rig: Rig) -> Float64[Array, "laser normal_and_distance=4"]:
    """The light planes."""
    return np.concatenate([rig.lasers.normal, rig.lasers.distance_m[:, None]], axis=1)
