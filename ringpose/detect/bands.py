"""Where to look for stripes whose places are predicted: a window about each, instead of the whole frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringpose.detect.frames import LaserImage
from ringpose.detect.stripe_centers import find_stripes
from ringpose.geometry.rays import project, undistorted_rays
from ringpose.types.arrays import Array, Float64
from ringpose.types.break_points import BreakPoints
from ringpose.types.camera import Camera
from ringpose.types.stripes import Stripes, joined_stripes

BAND_PX = 24
"""Rows above and below a predicted stripe that are searched: 15 mm at 1 m in the time between two frames."""

BESIDE_PX = 60
"""Columns beyond a predicted stripe's ends that are searched: motion, and the ends' own surroundings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """Rows and columns of a frame, the last of each exclusive."""

    top: int
    bottom: int
    left: int
    right: int

    def meets(self, other: "Window") -> bool:
        """Whether the two have a pixel in common."""
        return (
            self.top < other.bottom and other.top < self.bottom and self.left < other.right and other.left < self.right
        )

    def with_other(self, other: "Window") -> "Window":
        """The smallest window that holds both."""
        return Window(
            top=min(self.top, other.top),
            bottom=max(self.bottom, other.bottom),
            left=min(self.left, other.left),
            right=max(self.right, other.right),
        )


def predicted_windows(predicted: BreakPoints, lasers: Sequence[int], camera: Camera) -> list[Window]:
    """Windows about the predicted stripes of some lasers, those that meet made one."""
    windows: list[Window] = []
    for laser in lasers:
        ends = np.stack([predicted.face_start_px[laser], predicted.face_end_px[laser]])
        if np.isfinite(ends).all():
            window = _window(project(undistorted_rays(ends, camera), camera), camera)
            meeting = [each for each in windows if each.meets(window)]
            windows = [each for each in windows if each not in meeting]
            for each in meeting:
                window = window.with_other(each)
            windows.append(window)
    return windows


def stripes_in(windows: Sequence[Window], image: LaserImage) -> Stripes:
    """The stripes in some windows of a frame, where they lie in the whole frame."""
    parts = []
    for window in windows:
        rows, columns = slice(window.top, window.bottom), slice(window.left, window.right)
        dark = None if image.dark is None else np.ascontiguousarray(image.dark[rows, columns])
        lit = np.ascontiguousarray(image.lit[rows, columns])
        stripes = find_stripes(lit, dark, saturation_dn=image.saturation_dn)
        shifted = stripes.position_px + np.array([window.left, window.top], dtype=np.float64)
        parts.append(replace(stripes, position_px=shifted))
    return joined_stripes(parts)


def _window(ends: Float64[Array, "end=2 xy=2"], camera: Camera) -> Window:
    """The window about a stripe between two points, within the image."""
    left, top = ends.min(axis=0)
    right, bottom = ends.max(axis=0)
    return Window(
        top=max(int(top) - BAND_PX, 0),
        bottom=min(int(bottom) + BAND_PX + 1, camera.image_height),
        left=max(int(left) - BESIDE_PX, 0),
        right=min(int(right) + BESIDE_PX + 1, camera.image_width),
    )
