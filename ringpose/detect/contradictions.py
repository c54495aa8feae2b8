"""Whether stripes can be where the rig says: images upside down, mirrored or of another camera are none of its own."""

import numpy as np

from ringpose.detect.faces import planes_per_m
from ringpose.detect.tracks import lens
from ringpose.kernels.lines import CENTERS, LASER, MIDDLE_X, MIDDLE_Y, SLOPE, X_END, X_START
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.detection import UNLABELLED
from ringpose.types.rig import Rig

POSSIBLE_PER_M = (-1 / 3, 20.0)
"""One over the depth of what a camera sees: from 5 cm to beyond the horizon, by what calibration and noise may add."""

LONG_COLUMNS = 30
"""Shorter tracks may be reflections, or a facet's."""

MOST = 0.5
"""Share of the long tracks' columns that must be possible; in 81 rendered shots all of them are, turned upside down at
most two thirds."""


def lie_nowhere(tracks: Float64[Array, "track column=11"], rig: Rig) -> bool:
    """Whether most of what is straight lies behind the camera or in its lens, whichever laser drew it."""
    long = tracks[tracks[:, CENTERS] >= LONG_COLUMNS]
    possible = _possible(long, rig)
    drawn = long[:, [LASER]] == np.arange(possible.shape[1])
    anywhere = (possible & (drawn | (long[:, [LASER]] == UNLABELLED))).any(axis=1)
    return float(long[anywhere, CENTERS].sum()) < MOST * float(long[:, CENTERS].sum())


def _possible(tracks: Float64[Array, "track column=11"], rig: Rig) -> Bool[Array, "track laser"]:
    """Whether some of a track can lie before the camera if that laser drew it."""
    optics = lens(rig.camera)
    x_px = tracks[:, [X_START, X_END]]
    y_px = tracks[:, [MIDDLE_Y]] + tracks[:, [SLOPE]] * (x_px - tracks[:, [MIDDLE_X]])
    rays = np.stack([(x_px - optics.cx) / optics.fx, (y_px - optics.cy) / optics.fy, np.ones_like(x_px)], axis=-1)
    per_m = rays @ planes_per_m(rig).T
    possible: Bool[Array, "track laser"] = (per_m.max(axis=1) > POSSIBLE_PER_M[0]) & (
        per_m.min(axis=1) < POSSIBLE_PER_M[1]
    )
    return possible
