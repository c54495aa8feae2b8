"""Break points: the ends of the face's tracks refined in the image, their edges named, and what lies between them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64

from ringpose.detect.consistency import Ends, side_of_center, without_occluded
from ringpose.detect.faces import Face
from ringpose.detect.frames import LaserImage
from ringpose.detect.stripe_ends import KINK_LEVEL, Line, profile_along, reached_x, stripe_end, stripe_sigma
from ringpose.detect.tracks import BORDER_PX, Track
from ringpose.geometry.rays import project, undistorted_rays
from ringpose.types.arrays import Array
from ringpose.types.break_points import BreakPointFlag, BreakPoints
from ringpose.types.rig import Rig

BEYOND_COLUMNS = 40
"""Columns beyond a track in which its end is looked for."""


def break_points(
    face: Face, tracks: Sequence[Track], images: dict[int, LaserImage], rig: Rig, saturation_dn: int
) -> BreakPoints:
    """The break points of a face among all tracks; `images` are the frames that show each laser."""
    refined = [_track_ends(laser, track, images[laser], rig, saturation_dn) for laser, track in face.tracks]
    ends = Ends(
        laser=np.array([laser for laser, _ in face.tracks], dtype=np.int64),
        position_px=np.array([each[0] for each in refined]),
        covariance_px2=np.array([each[1] for each in refined]),
        flags=np.array([each[2] for each in refined], dtype=np.int64),
        straight_x=np.array([[track.x_start, track.x_end] for _, track in face.tracks]),
    )
    ends = without_occluded(ends, tracks, rig)
    right_is_inner, clear = side_of_center(ends, rig)
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
    line = _distorted_line(track, rig)
    x, y, face_x = line.x, line.y, line.x[line.on_face]
    sigma = stripe_sigma(image.signal, face_x.astype(np.int64), y[line.on_face])
    profile = profile_along(image.lit, image.dark, line, sigma, saturation_dn)
    position, covariance, flags = np.full((2, 2), np.nan), np.full((2, 2, 2), np.nan), [0, 0]
    for side, (near_x, outward) in enumerate(((face_x[0], -1), (face_x[-1], 1))):
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


def _distorted_line(track: Track, rig: Rig) -> Line:
    """The track's line in the image as taken."""
    straight_x = np.linspace(track.x_start - BEYOND_COLUMNS, track.x_end + BEYOND_COLUMNS, 64)
    straight = np.stack([straight_x, track.middle_y + track.slope * (straight_x - track.middle_x)], axis=-1)
    bent = project(undistorted_rays(straight, rig.camera), rig.camera)
    first, last = max(np.ceil(bent[0, 0]), 0), min(np.floor(bent[-1, 0]), rig.camera.image_width - 1)
    x = np.arange(first, last + 1, dtype=np.float64)
    start, end = np.interp([track.x_start, track.x_end], straight_x, bent[:, 0])
    return Line(x=x, y=np.interp(x, bent[:, 0], bent[:, 1]), on_face=(x > start - 0.5) & (x < end + 0.5))


def _at_border(x: float, rig: Rig) -> bool:
    return x < BORDER_PX or x > rig.camera.image_width - 1 - BORDER_PX
