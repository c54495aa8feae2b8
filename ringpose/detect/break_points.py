"""Break points: the ends of the face's tracks refined in the image, their edges named, and what lies between them."""

from collections.abc import Sequence

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
    ends, right_is_inner, clear = checked(_joined(parts), tracks, rig)
    order = np.array([1, 0]) if right_is_inner else np.array([0, 1])
    flags = ends.flags[:, order] | (0 if clear else int(BreakPointFlag.EDGE_UNKNOWN))
    labelled = all(image.labelled for image in images if any(laser in image.lasers for laser in ends.laser))
    return _gathered(face, ends, order, flags, len(rig.lasers.names), labelled=labelled)


def _named(shown: Sequence[tuple[int, Track]], ends: StripeEnds) -> Ends:
    """The ends of one image's tracks with their lasers, covariances and flags."""
    seen = np.isfinite(ends.position_px[..., 0])
    with np.errstate(invalid="ignore"):
        kink = ends.outside > KINK_LEVEL
    flags = int(BreakPointFlag.SATURATED) * ends.saturated + int(BreakPointFlag.KINK) * kink
    across = np.array(
        [[track.sigma(x) for x in row] for (_, track), row in zip(shown, ends.position_px[..., 0], strict=True)]
    )
    return Ends(
        laser=np.array([laser for laser, _ in shown], dtype=np.int64),
        position_px=ends.position_px,
        covariance_px2=_covariance(ends.slope, ends.sigma_px, across),
        flags=np.where(seen, flags, int(BreakPointFlag.CLIPPED)).astype(np.int64),
        straight_x=np.array([[track.x_start, track.x_end] for _, track in shown]),
    )


def _covariance(
    slope: Float64[Array, "track end"], along: Float64[Array, "track end"], across: Float64[Array, "track end"]
) -> Float64[Array, "track end xy=2 xy=2"]:
    """Covariance of points that err by `along` (columns) along a line of that slope, which errs by `across` (rows)."""
    direction = np.stack([np.ones_like(slope), slope], axis=-1)
    covariance: Float64[Array, "track end xy=2 xy=2"] = (
        along[..., None, None] ** 2 * direction[..., :, None] * direction[..., None, :]
    )
    covariance[..., 1, 1] += across**2
    return covariance


def _joined(parts: Sequence[Ends]) -> Ends:
    """The ends of all images in one record."""
    return Ends(
        laser=np.concatenate([part.laser for part in parts]),
        position_px=np.concatenate([part.position_px for part in parts]),
        covariance_px2=np.concatenate([part.covariance_px2 for part in parts]),
        flags=np.concatenate([part.flags for part in parts]),
        straight_x=np.concatenate([part.straight_x for part in parts]),
    )


def _gathered(
    face: Face, ends: Ends, order: Int64[Array, "2"], flags: Int64[Array, "track 2"], count: int, *, labelled: bool
) -> BreakPoints:
    """The record over all lasers of the rig, NaN where nothing was seen."""
    position, covariance = np.full((count, 2, 2), np.nan), np.full((count, 2, 2, 2), np.nan)
    all_flags = np.zeros((count, 2), dtype=np.int64)
    position[ends.laser], covariance[ends.laser] = ends.position_px[:, order], ends.covariance_px2[:, order]
    covariance[np.isnan(position[..., 0])] = np.nan
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
