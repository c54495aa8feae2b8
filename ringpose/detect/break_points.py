"""Break points: the ends of the face's tracks refined in the image, their edges named, and what lies between them."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.detect.consistency import Ends, checked
from ringpose.detect.faces import Face
from ringpose.detect.frames import LaserImage
from ringpose.detect.stripe_ends import StripeEnds, stripe_ends
from ringpose.detect.tracks import Track
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.break_points import BreakPointFlag, BreakPoints
from ringpose.types.rig import Rig

KINK_LEVEL = 0.25
"""A level beyond the edge of this share of the face's means that the stripe runs on: a wall."""

UNCLEAR_PX = 0.75
"""Ends with a greater sigma are flagged: two of them are the 1.5 px that no end may be off without a flag."""

CLIPPED_PHASE = 0.022
"""Error of a saturated stripe's centre, times the sigma of its section in pixels.

Pixels sample the two corners that clipping makes: each errs by half its bend times the second Bernoulli polynomial of
its phase (Euler and Maclaurin). A stripe of 1.65 times the largest value is clipped over one sigma on either side, and
filters weigh the corners by 0.85 of the flanks. All columns err alike where a track stays within a row of pixels; over
the rows that it crosses the error averages out.
"""


FACET_SIGMAS = 6.0
"""Columns over which what lies beneath a stripe is alike, in sigmas of its section: what is finer than the section is
wide averages out across it. The line follows what is coarser, so that its centres show little of that."""


def break_points(
    face: Face, tracks: Sequence[Track], images: Sequence[LaserImage], rig: Rig, saturation_dn: int
) -> BreakPoints:
    """The break points of a face among all tracks; `images` are the frames that show the lasers."""
    parts = []
    for image in images:
        shown = [(laser, track) for laser, track in face.tracks if laser in image.lasers]
        if shown:
            found = stripe_ends([track for _, track in shown], image, rig.camera, saturation_dn)
            parts.append(_named(shown, found))
    ends, right_is_inner, clear = checked(_edges_alike(_joined(parts)), tracks, rig)
    order = np.array([1, 0]) if right_is_inner else np.array([0, 1])
    flags = ends.flags[:, order] | (0 if clear else int(BreakPointFlag.EDGE_UNKNOWN))
    labelled = all(image.labelled for image in images if any(laser in image.lasers for laser in ends.laser))
    return _gathered(face, ends, order, flags, len(rig.lasers.names), labelled=labelled)


def _named(shown: Sequence[tuple[int, Track]], ends: StripeEnds) -> Ends:
    """The ends of one image's tracks with their lasers, covariances and flags."""
    tracks = [track for _, track in shown]
    x = ends.position_px[..., 0]
    straight_x = np.array([[track.x_start, track.x_end] for track in tracks])
    found = (x, ends.sigma_px, ends.outside, ends.saturated, ends.blunt)
    flags = [
        [_flags(*end) for end in zip(*sides, strict=True)]
        for sides in zip(*(each.tolist() for each in found), strict=True)
    ]
    shape = (ends.slope.tolist(), ends.sigma_px.tolist(), _line_sigmas(tracks, x, ends).tolist())
    return Ends(
        laser=np.array([laser for laser, _ in shown], dtype=np.int64),
        position_px=ends.position_px,
        covariance_px2=np.array(
            [[_covariance(*end) for end in zip(*sides, strict=True)] for sides in zip(*shape, strict=True)]
        ),
        flags=np.array(flags, dtype=np.int64),
        straight_x=straight_x,
        straight_sigma_px=_line_sigmas(tracks, straight_x, ends),
    )


def _line_sigmas(
    tracks: Sequence[Track], x: Float64[Array, "track end=2"], ends: StripeEnds
) -> Float64[Array, "track end=2"]:
    """Standard deviations of the tracks' ordinates at those columns, with what a track's centres share.

    What lies beneath a stripe and shifts its peak by a share of itself shifts its centre by that share of its sigma.
    """
    section = ends.section_px.max(axis=1)
    facets = np.array([track.count for track in tracks]) / (FACET_SIGMAS * section)
    beneath = np.nan_to_num(section * np.sqrt(ends.beneath.max(axis=1) / np.maximum(facets, 1)))
    rows = zip(tracks, beneath.tolist(), x.tolist(), strict=True)
    own = np.array([[track.sigma(at, least) for at in both] for track, least, both in rows])
    rows_crossed = np.array([abs(track.slope) * track.length for track in tracks])
    shared = CLIPPED_PHASE / section / np.maximum(rows_crossed, 1)
    sigmas: Float64[Array, "track end=2"] = np.hypot(own, np.where(ends.saturated.any(axis=1), shared, 0.0)[:, None])
    return sigmas


def _flags(x: float, sigma: float, outside: float, saturated: bool, blunt: bool) -> int:
    """The flags of an end at that column, of that sigma, with that level outside; clipped if there is none."""
    if math.isnan(x):
        return int(BreakPointFlag.CLIPPED)
    named = {
        BreakPointFlag.SATURATED: saturated,
        BreakPointFlag.KINK: outside > KINK_LEVEL,
        BreakPointFlag.BLUNT: blunt,
        BreakPointFlag.UNCLEAR: sigma > UNCLEAR_PX and not blunt,
    }
    return sum(int(flag) for flag, is_so in named.items() if is_so)


def _covariance(slope: float, along: float, across: float) -> list[list[float]]:
    """Covariance of a point that errs `along` (columns) a line of that slope and, with the line, `across` (rows)."""
    variance = along * along
    return [[variance, variance * slope], [variance * slope, variance * slope * slope + across * across]]


def _joined(parts: Sequence[Ends]) -> Ends:
    """The ends of all images in one record."""
    if len(parts) == 1:
        return parts[0]
    return Ends(
        laser=np.concatenate([part.laser for part in parts]),
        position_px=np.concatenate([part.position_px for part in parts]),
        covariance_px2=np.concatenate([part.covariance_px2 for part in parts]),
        flags=np.concatenate([part.flags for part in parts]),
        straight_x=np.concatenate([part.straight_x for part in parts]),
        straight_sigma_px=np.concatenate([part.straight_sigma_px for part in parts]),
    )


def _edges_alike(ends: Ends) -> Ends:
    """The ends with all of an edge blunt where most of them are: it is made alike all around.

    They are then known no better than the best known of the blunt ones.
    """
    blunt = (ends.flags & int(BreakPointFlag.BLUNT)) != 0
    if not blunt.any():
        return ends
    seen = np.isfinite(ends.position_px[..., 0])
    others = seen & ~blunt & (2 * blunt.sum(axis=0) > seen.sum(axis=0))
    flags, covariance = ends.flags.copy(), ends.covariance_px2.copy()
    flags[others] |= int(BreakPointFlag.BLUNT)
    for track, side in np.argwhere(others).tolist():
        least = covariance[blunt[:, side], side, 0, 0].min()
        covariance[track, side] *= max(least / covariance[track, side, 0, 0], 1.0)
    return replace(ends, flags=flags, covariance_px2=covariance)


def _gathered(
    face: Face, ends: Ends, order: Int64[Array, "2"], flags: Int64[Array, "track 2"], count: int, *, labelled: bool
) -> BreakPoints:
    """The record over all lasers of the rig, NaN where nothing was seen."""
    position, covariance = np.full((count, 2, 2), np.nan), np.full((count, 2, 2, 2), np.nan)
    all_flags = np.zeros((count, 2), dtype=np.int64)
    position[ends.laser], covariance[ends.laser] = ends.position_px[:, order], ends.covariance_px2[:, order]
    covariance[np.isnan(position[..., 0])] = np.nan
    all_flags[ends.laser] = flags
    lines = np.full((3, count, 2), np.nan)
    for laser, track in face.tracks:
        left, right = track.x_start, track.x_end
        lines[:2, laser] = (left, track.y(left)), (right, track.y(right))
    lines[2, ends.laser] = ends.straight_sigma_px
    return BreakPoints(
        position_px=position,
        covariance_px2=covariance,
        flags=all_flags,
        face_start_px=lines[0],
        face_end_px=lines[1],
        face_sigma_px=lines[2],
        labelled=labelled,
    )
