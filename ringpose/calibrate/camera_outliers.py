"""Views and corners that lie farther from the rest than chance puts them."""

from collections.abc import Sequence

import numpy as np

from ringpose.calibrate.normal_spread import normal_spread
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose, BoardView

VIEW_FACTOR = 2.5
"""A view is rejected if its rms is this many times the median of the views'. Good sets stay below 1.5."""

FLOOR_PX = 0.05
"""No view and no corner below this is rejected: that is the corner finders' own accuracy."""

LARGEST_VIEW_SHARE = 1 / 3
"""If more views than this disagree, nobody knows which are the bad ones."""

CORNER_SIGMAS = 5.0
"""A corner is left out if it is so many standard deviations off; of normal errors four in a million are."""

LARGEST_CORNER_SHARE = 0.05
"""More corners than this are never left out, so that a bad lens model is not hidden by its own victims."""


def outlying_view(poses: Sequence[BoardPose]) -> int | None:
    """Index of the view that stands out most, if one does."""
    rms = np.array([pose.residual_rms_px for pose in poses])
    worst = int(np.argmax(rms))
    limit = max(VIEW_FACTOR * float(np.median(rms)), FLOOR_PX)
    return worst if rms[worst] > limit else None


def view_reason(poses: Sequence[BoardPose], worst: int) -> str:
    """Why this view is left out, in words."""
    rms = [pose.residual_rms_px for pose in poses]
    return f"rms {rms[worst]:.2f} px, {rms[worst] / float(np.median(rms)):.1f} times the median of the views"


def outlying_corners(errors: Sequence[Float64[Array, "_ xy=2"]]) -> list[Bool[Array, "_"]]:
    """Which corners of each view are too far off, by the spread of the bulk of all views' corners."""
    every = np.concatenate(errors)
    sigma_px = normal_spread(every)
    lengths = np.linalg.norm(every, axis=1)
    allowed = int(LARGEST_CORNER_SHARE * len(lengths))
    limit = max(CORNER_SIGMAS * sigma_px, FLOOR_PX, float(np.sort(lengths)[len(lengths) - allowed - 1]))
    return [np.asarray(np.linalg.norm(error, axis=1) > limit) for error in errors]


def whole_markers(view: BoardView, left_out: Bool[Array, "corner"]) -> Bool[Array, "corner"]:
    """The same, and with a corner between a marker's sides the marker's other three: sides have two ends."""
    if view.likeness == 0:
        return left_out
    return np.repeat(left_out.reshape(-1, 4).any(axis=1), 4)
