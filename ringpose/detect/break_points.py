"""Break points: the ends of the face's tracks refined in the image, their edges named, and what lies between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from ringpose.detect.faces import Face
from ringpose.detect.frames import LaserImage
from ringpose.detect.stripe_ends import KINK_LEVEL, profile_along, reached_x, stripe_end, stripe_sigma
from ringpose.detect.tracks import BORDER_PX, Track
from ringpose.geometry.circles import concentric_arcs
from ringpose.geometry.planes import nearest_plane
from ringpose.geometry.rays import intersect, project, rays, undistorted_rays
from ringpose.types.arrays import Array
from ringpose.types.break_points import BreakPointFlag, BreakPoints
from ringpose.types.rig import Rig

BEYOND_COLUMNS = 40
"""Columns beyond a track in which its end is looked for."""

CIRCLE_SIGMA_PX = 0.5
"""How far a refined end may lie from its circle besides its own sigma: calibration, an edge's chamfer."""

OCCLUDED_COST = 12.0
"""Drop in squared sigmas over two that calls one end of six occluded: below 1e-5 by chance, six ends tried."""

SIDE_SIGMAS = 2.0
"""How clearly the curvature must say on which side the ring's centre lies."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ends:
    """The two ends of each face track, left then right, in distorted pixels."""

    laser: Int64[Array, "track"]
    position_px: Float64[Array, "track end=2 xy=2"]
    covariance_px2: Float64[Array, "track end=2 xy=2 xy=2"]
    flags: Int64[Array, "track end=2"]


def break_points(face: Face, images: dict[int, LaserImage], rig: Rig, saturation_dn: int) -> BreakPoints:
    """The break points of a face; `images` are the frames that show each laser."""
    refined = [_track_ends(laser, track, images[laser], rig, saturation_dn) for laser, track in face.tracks]
    ends = Ends(
        laser=np.array([laser for laser, _ in face.tracks], dtype=np.int64),
        position_px=np.array([each[0] for each in refined]),
        covariance_px2=np.array([each[1] for each in refined]),
        flags=np.array([each[2] for each in refined], dtype=np.int64),
    )
    ends = _without_occluded(ends, rig)
    right_is_inner, clear = _side_of_center(ends, rig)
    order = np.array([1, 0]) if right_is_inner else np.array([0, 1])
    flags = ends.flags[:, order] | (0 if clear else int(BreakPointFlag.EDGE_UNKNOWN))
    return _gathered(face, ends, order, flags, rig, labelled=all(images[laser].labelled for laser in ends.laser))


def _gathered(
    face: Face, ends: Ends, order: Int64[Array, "2"], flags: Int64[Array, "track 2"], rig: Rig, *, labelled: bool
) -> BreakPoints:
    """The record over all lasers of the rig, NaN where nothing was seen."""
    count = len(rig.lasers.names)
    position, covariance = np.full((count, 2, 2), np.nan), np.full((count, 2, 2, 2), np.nan)
    all_flags = np.zeros((count, 2), dtype=np.int64)
    position[ends.laser], covariance[ends.laser] = ends.position_px[:, order], ends.covariance_px2[:, order]
    all_flags[ends.laser] = flags
    start, end, sigma = np.full((count, 2), np.nan), np.full((count, 2), np.nan), np.full((count, 2), np.nan)
    for laser, track in face.tracks:
        start[laser] = track.x_start, track.y(track.x_start)
        end[laser] = track.x_end, track.y(track.x_end)
        sigma[laser] = track.sigma(track.x_start), track.sigma(track.x_end)
    return BreakPoints(
        position_px=position,
        covariance_px2=covariance,
        flags=all_flags,
        face_start_px=start,
        face_end_px=end,
        face_sigma_px=sigma,
        labelled=labelled,
    )


def _track_ends(
    laser: int, track: Track, image: LaserImage, rig: Rig, saturation_dn: int
) -> tuple[Float64[Array, "2 2"], Float64[Array, "2 2 2"], list[int]]:
    """Positions, covariances and flags of a track's left and right end."""
    x, y = _distorted_line(track, rig)
    on_face = (x >= track.x_start) & (x <= track.x_end)
    sigma = stripe_sigma(image.signal, x[on_face].astype(np.int64), y[on_face])
    profile = profile_along(image.lit, image.dark, (x, y), sigma, saturation_dn)
    position, covariance, flags = np.full((2, 2), np.nan), np.full((2, 2, 2), np.nan), [0, 0]
    for side, (near_x, outward) in enumerate(((x[on_face][0], -1), (x[on_face][-1], 1))):
        end = stripe_end(profile, reached_x(profile, float(near_x), outward), outward, sigma)
        if end is None or _at_border(end.x, rig):
            flags[side] = int(BreakPointFlag.CLIPPED)
            continue
        position[side] = end.x, np.interp(end.x, x, y)
        slope = float(np.interp(end.x + 0.5, x, y) - np.interp(end.x - 0.5, x, y))
        along, across = np.array([1.0, slope]), np.array([-slope, 1.0])
        covariance[side] = (
            end.sigma**2 * np.outer(along, along) + track.sigma(end.x) ** 2 * np.outer(across, across)
        ) / np.hypot(1, slope) ** 2
        flags[side] = int(BreakPointFlag.SATURATED) * end.saturated | int(BreakPointFlag.KINK) * (
            end.outside > KINK_LEVEL
        )
    return position, covariance, flags


def _distorted_line(track: Track, rig: Rig) -> tuple[Float64[Array, "n"], Float64[Array, "n"]]:
    """The track's line in the image as taken: whole columns x and the y there, some way beyond its ends."""
    straight_x = np.linspace(track.x_start - BEYOND_COLUMNS, track.x_end + BEYOND_COLUMNS, 64)
    straight = np.stack([straight_x, track.middle_y + track.slope * (straight_x - track.middle_x)], axis=-1)
    bent = project(undistorted_rays(straight, rig.camera), rig.camera)
    first, last = max(np.ceil(bent[0, 0]), 0), min(np.floor(bent[-1, 0]), rig.camera.image_width - 1)
    x = np.arange(first, last + 1, dtype=np.float64)
    return x, np.interp(x, bent[:, 0], bent[:, 1])


def _at_border(x: float, rig: Rig) -> bool:
    return x < BORDER_PX or x > rig.camera.image_width - 1 - BORDER_PX


def _flat(ends: Ends, rig: Rig) -> tuple[Float64[Array, "n 2"], Bool[Array, "track 2"], Float64[Array, "n"]]:
    """The seen ends in the plane nearest to them: coordinates, which were seen, and metres a pixel at each."""
    seen = np.isfinite(ends.position_px[..., 0])
    normal, distance = rig.lasers.normal[ends.laser][:, None], rig.lasers.distance_m[ends.laser][:, None]
    points = intersect(rays(ends.position_px, rig.camera), normal, distance)[seen]
    plane_normal, _, _ = nearest_plane(points)
    across = np.cross(plane_normal, [0.0, 1.0, 0.0])  # runs along image rows, so that "right" keeps its meaning
    across *= np.sign(across[0]) / np.linalg.norm(across)
    axes = np.stack([across, np.cross(plane_normal, across)])
    return (points - points.mean(axis=0)) @ axes.T, seen, points[:, 2] / rig.camera.camera_matrix[0, 0]


def _without_occluded(ends: Ends, rig: Rig) -> Ends:
    """The ends without the one that lies off the circles of the others, if there is such a one."""
    flat, seen, metres_a_pixel = _flat(ends, rig) if np.isfinite(ends.position_px).sum() >= 12 else (None, None, None)
    if flat is None or seen is None or metres_a_pixel is None:
        return ends
    circle = np.broadcast_to([0, 1], seen.shape)[seen]
    sigma = np.hypot(np.sqrt(ends.covariance_px2[seen][:, 0, 0]), CIRCLE_SIGMA_PX) * metres_a_pixel

    def cost(used: Array) -> float:
        outside = concentric_arcs(flat[used], circle[used]).outside
        return float(0.5 * np.sum((outside / sigma[used]) ** 2))

    everything = cost(np.ones(len(flat), dtype=bool))
    without = np.array([cost(np.arange(len(flat)) != each) for each in range(len(flat))])
    worst = int(np.argmin(without))
    if everything - without[worst] < OCCLUDED_COST:
        return ends
    track, side = np.argwhere(seen)[worst]
    position, flags = ends.position_px.copy(), ends.flags.copy()
    covariance = ends.covariance_px2.copy()
    position[track, side], covariance[track, side] = np.nan, np.nan
    flags[track, side] |= int(BreakPointFlag.OCCLUDED)
    return Ends(laser=ends.laser, position_px=position, covariance_px2=covariance, flags=flags)


def _side_of_center(ends: Ends, rig: Rig) -> tuple[bool, bool]:
    """Whether the ring's centre lies to the right of the stripes (their right ends are inner), and if that is clear.

    The sign of the arcs' curvature says it; its sigma by differences.
    """
    seen = np.isfinite(ends.position_px[..., 0])
    if np.count_nonzero(seen) < 4 or min(np.count_nonzero(seen, axis=0)) < 1 or len(ends.laser) < 2:
        return False, False
    flat, seen, metres_a_pixel = _flat(ends, rig)
    circle = np.broadcast_to([0, 1], seen.shape)[seen]
    step = np.sqrt(ends.covariance_px2[seen][:, 0, 0]) * metres_a_pixel
    moved = flat + np.stack([np.diag(step), np.zeros((len(flat), len(flat)))], axis=-1)
    here = float(concentric_arcs(flat, circle).curvature)
    sigma = float(np.linalg.norm(concentric_arcs(moved, circle).curvature - here))
    return here > 0, abs(here) > SIDE_SIGMAS * sigma
