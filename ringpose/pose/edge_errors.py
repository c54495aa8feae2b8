"""What the points of a visible edge err alike, as errors that are unknowns beside the ring.

A point's place errs mostly by what lies beside the edge: the foil behind it, a wall, a shadow that runs towards it.
That goes on for a while, so a part of each error is that of the neighbours too, by exp(-distance / length). Such
errors are a sum of independent waves (the Karhunen-Loeve series of this covariance; ringpose-method(7), section 5).
"""

import math

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import RingEdgePoints

ROUNDED_PX = 0.05
"""What a whole edge errs alike: where the half brightness lies on a rounded corner."""

ALIKE_SHARE = 0.4
"""Of a point's standard deviation, what it shares with its neighbours; the most likely one for 60 edges of rendered
rings before foil, walls and shadows, of which an error in pixels that is alike for all edges explains far less."""

ALIKE_PX = 150.0
"""Length along the edge over which that persists, from the same edges (100 and 200 are nearly as likely)."""

WAVES = 8
"""Shorter ones weigh less than the points' own errors."""

ERRORS = 2 * (1 + WAVES)
"""Common errors of a shot: of each edge."""


def common_errors_px(edges: RingEdgePoints) -> Float64[Array, "visible error"]:
    """What each unit error does to the points of its edge, along their normals; 0 for those of the other edge."""
    errors = np.zeros((len(edges.edge), 2, 1 + WAVES))
    for edge in (0, 1):
        own = np.flatnonzero(edges.edge == edge)
        if len(own):
            errors[own, edge, 0] = ROUNDED_PX
            along_px = _along_px(edges.position_px[own], edges.normal[own])
            errors[own, edge, 1:] = ALIKE_SHARE * edges.sigma_px[own, None] * waves(along_px)
    return errors.reshape(len(errors), ERRORS)


def waves(along_px: Float64[Array, "n"]) -> Float64[Array, "n wave"]:
    """The longest waves of a series of variance one that is alike over `ALIKE_PX`, cosines and sines by turns."""
    first, last = float(along_px.min()), float(along_px.max())
    half_px = max(0.5 * (last - first), 1.0)
    phase = _phases(half_px / ALIKE_PX)
    sign = np.where(np.arange(WAVES) % 2, -1.0, 1.0)
    size = np.sqrt(2.0 * half_px / ALIKE_PX / ((half_px / ALIKE_PX) ** 2 + phase**2))
    size /= np.sqrt(1.0 + sign * np.sin(2.0 * phase) / (2.0 * phase))
    angle = ((along_px - 0.5 * (first + last)) / half_px)[:, None] * phase
    scaled: Float64[Array, "n wave"] = size * np.where(sign > 0, np.cos(angle), np.sin(angle))
    return scaled


def _phases(lengths: float) -> Float64[Array, "wave"]:
    """Phase of each wave at the end of an edge: the solution of p = k pi/2 + atan(lengths / p), by Newton's steps.

    Each starts on that side from which it does not overshoot.
    """
    quarter = 0.5 * np.pi * np.arange(WAVES)
    phase: Float64[Array, "wave"] = np.maximum(quarter, math.sqrt(lengths / (1.0 + lengths)))
    for _ in range(6):
        off = phase - quarter - np.arctan(lengths / phase)
        phase = phase - off / (1.0 + lengths / (phase**2 + lengths**2))
    return phase


def _along_px(position_px: Float64[Array, "n xy=2"], normal: Float64[Array, "n xy=2"]) -> Float64[Array, "n"]:
    across_x, across_y = normal.sum(axis=0)
    size = math.hypot(across_x, across_y) or 1.0
    along_px: Float64[Array, "n"] = (position_px[:, 1] * across_x - position_px[:, 0] * across_y) / size
    return along_px
