"""What a rig resolves where the stripes of a shot are: how far in front of them, and how wide, a face must be.

A face is distinguished from what lies behind it by the step of its stripe, which is clear from the stripe's width on,
and by its two ends, between which there must be enough columns for a line (ringpose-method(7), section 14).
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ringpose.detect.difference_images import LaserImage
from ringpose.detect.rim import planes_per_m
from ringpose.detect.stripes import line_y_px, stripe_line_segments
from ringpose.geometry.rays import undistorted_rays
from ringpose.kernels.lines import CENTERS, LASER, MIDDLE_X, MIDDLE_Y, X_END, X_START
from ringpose.optics.feature_errors import FULL_WIDTH_SIGMAS, MIN_COLUMNS, row_offset_px_m
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import UNLABELLED, Stripes
from ringpose.types.rig import Rig

SECTION_ROWS = 12
"""Rows on either side of a centre in which the stripe's light is summed: five sigmas of one that is 6 px wide."""


def resolution_advice(stripes: Stripes, images: Sequence[LaserImage], rig: Rig) -> str:
    """From which height and width on a face would be seen beside the stripes, as a phrase.

    Empty if no stripe is of a known laser, whose light plane gives its distance. `images`: the frames of the stripes.
    """
    segments = stripe_line_segments(stripes, rig.camera)
    labelled = segments[segments[:, LASER] != UNLABELLED]
    width_px = _width_px(stripes, images)
    if not len(labelled) or not math.isfinite(width_px):
        return ""
    laser = labelled[:, LASER].astype(int)
    rays = undistorted_rays(labelled[:, [MIDDLE_X, MIDDLE_Y]], rig.camera)
    per_m = (rays * planes_per_m(rig)[laser]).sum(axis=1)
    longest = np.argsort(labelled[:, CENTERS] * (per_m > 0.0))[-1]
    if per_m[longest] <= 0.0:
        return ""
    distance_m = 1.0 / float(per_m[longest])
    nearer_m = 1.0 / (1.0 / distance_m + width_px / row_offset_px_m(rig)[laser[longest]])
    column_m = distance_m / float(rig.camera.camera_matrix[0, 0])
    height_mm, seen_px = 1e3 * (distance_m - nearer_m), _largest_step_px(labelled)
    largest = f", the largest one here is {seen_px:.1f} px" if seen_px < width_px else ""
    return (
        f"at {distance_m:.2f} m, where the stripes are, a face should be {height_mm:.0f} mm in front of what "
        f"lies behind it (a step of {width_px:.1f} px, the stripe's width{largest}) "
        f"and {1e3 * MIN_COLUMNS * column_m:.0f} mm wide ({MIN_COLUMNS} columns)"
    )


def _width_px(stripes: Stripes, images: Sequence[LaserImage]) -> float:
    """Median full width of the stripes at half of their maximum, from area and peak of their sections."""
    widths = []
    for image in images:
        of_image = np.isin(stripes.piece, np.flatnonzero(stripes.laser == image.label))
        x, y = np.rint(stripes.position_px[of_image & np.isfinite(stripes.sigma_px)]).astype(int).T
        inside = (y >= SECTION_ROWS) & (y < len(image.lit) - SECTION_ROWS)
        rows, column = y[inside] + np.arange(-SECTION_ROWS, SECTION_ROWS + 1)[:, None], x[inside]
        light = image.lit[rows, column].astype(np.float64)
        light -= np.median(light, axis=0) if image.dark is None else image.dark[rows, column]
        peak = light[SECTION_ROWS - 1 : SECTION_ROWS + 2].max(axis=0)
        widths.append(light.sum(axis=0)[peak > 0.0] / peak[peak > 0.0])
    every = np.concatenate(widths) if widths else np.zeros(0)
    return float(np.median(every)) * FULL_WIDTH_SIGMAS / math.sqrt(2.0 * math.pi) if len(every) else math.nan


def _largest_step_px(segments: Float64[Array, "segment column=12"]) -> float:
    """The largest offset between neighbouring pieces of a laser, in the middle of their gap; 0 without any."""
    steps = [0.0]
    for laser in np.unique(segments[:, LASER]):
        own = segments[segments[:, LASER] == laser]
        for left, right in pairwise(own[np.argsort(own[:, X_START])]):
            x = 0.5 * (left[X_END] + right[X_START])
            steps.append(abs(float(line_y_px(right, x) - line_y_px(left, x))))
    return max(steps)
