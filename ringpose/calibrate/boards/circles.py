"""Projected centres of the circles of an asymmetric grid (ringpose-method(7), section 7).

The projection of a circle is an ellipse whose centre is not the projection of the circle's centre, because the nearer
half appears larger. The difference grows with the square of the radius, which is measured from the dark area.

OpenCV's ellipse centres depend on a threshold, which is biased by uneven illumination: by 0.01 px where the brightness
changes by 0.1 % per pixel. Here the share of ink of each pixel is measured between the levels of ink and paper, both
planes, and position and size of an ellipse with a blurred edge are fitted to these shares. The fit is one linear
least-squares step for each circle, repeated after the homography is estimated again; the model is linear enough near
OpenCV's centres that an iterative solver would gain nothing.
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import ndtr

from ringpose.calibrate.boards.edge_profile import MIN_BLUR_PX
from ringpose.calibrate.boards.image_patch import grey_around
from ringpose.types.arrays import Array, Bool, Float64, UInt8

_ROUNDS = 2

DIM_DN, BRIGHT_DN = 110.0, 200.0
"""Images with paper darker than the first are scaled to the second, so that OpenCV uses several thresholds."""

WHITE_PERCENT = 98
"""Percentile of the image that is taken as paper."""

MIN_CONTRAST_DN = 10.0
"""Minimum contrast for a measurement of a circle's area."""

_SHARES = (-0.5, 1.5)
"""Limits of a pixel's noisy share of ink: clipping at 0 would add the noise of paper to the area."""


class CircleCenters(NamedTuple):
    """Projected centres of circles."""

    points_px: Float64[Array, "corner xy=2"]
    radius_m: float
    """Radius of all circles; zero if it could not be measured."""


def circle_centers(
    grey: UInt8[Array, "row column"], points_m: Float64[Array, "corner xyz=3"], columns: int, rows: int
) -> CircleCenters | None:
    """Projected centres of the circles with these positions on the board; None if not all are found."""
    middles_px = circle_middles(grey, columns, rows)
    if middles_px is None:
        return None
    homography = _homography(points_m, middles_px)
    radius_m = _radius_m(grey, middles_px, points_m[:, :2], homography)
    for _ in range(_ROUNDS if radius_m else 0):
        middles_px = levelled_middles(grey, middles_px, circle_conics(points_m[:, :2], radius_m, homography))
        homography = _homography(points_m, middles_px)
    return CircleCenters(middles_px - ellipse_offsets(points_m[:, :2], radius_m, homography), radius_m)


def _homography(
    points_m: Float64[Array, "corner xyz=3"], middles_px: Float64[Array, "corner xy=2"]
) -> Float64[Array, "3 3"]:
    return np.asarray(cv2.findHomography(points_m[:, :2], middles_px)[0], dtype=np.float64)


def circle_middles(grey: UInt8[Array, "row column"], columns: int, rows: int) -> Float64[Array, "corner xy=2"] | None:
    """OpenCV's centres of the ellipses; None if not all are found."""
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
    found, middles = cv2.findCirclesGrid(brightened(grey), (columns, rows), flags=flags)
    return np.asarray(middles, dtype=np.float64).reshape(-1, 2) if found else None


def brightened(grey: UInt8[Array, "row column"]) -> UInt8[Array, "row column"]:
    """A dark image scaled to normal brightness: OpenCV's lowest threshold for circles is 50 grey levels."""
    white = float(np.percentile(grey, WHITE_PERCENT))
    if not 0 < white < DIM_DN:
        return grey
    return np.rint(np.minimum(grey * (BRIGHT_DN / white), 255.0)).astype(np.uint8)


def ellipse_offsets(
    centers_m: Float64[Array, "corner xy=2"], radius_m: float, homography: Float64[Array, "3 3"]
) -> Float64[Array, "corner xy=2"]:
    """Centre of the ellipse minus projection of the circle's centre, for circles on a plane."""
    middles = _conic_middles(circle_conics(centers_m, radius_m, homography))
    offsets: Float64[Array, "corner xy=2"] = middles - cv2.perspectiveTransform(centers_m[None], homography)[0]
    return offsets


def seen_offsets(
    points_m: Float64[Array, "corner xyz=3"], points_px: Float64[Array, "corner xy=2"], radius_m: float
) -> Float64[Array, "corner xy=2"]:
    """The same for circles with these projected centres, without distortion."""
    return ellipse_offsets(points_m[:, :2], radius_m, _homography(points_m, points_px))


def circle_conics(
    centers_m: Float64[Array, "corner xy=2"], radius_m: float, homography: Float64[Array, "3 3"]
) -> Float64[Array, "corner 3 3"]:
    """The circles' conics in the image: C becomes H^-T C H^-1."""
    inverse = np.linalg.inv(homography)
    conics = np.zeros((len(centers_m), 3, 3))
    conics[:, 0, 0] = conics[:, 1, 1] = 1.0
    conics[:, :2, 2] = conics[:, 2, :2] = -centers_m
    conics[:, 2, 2] = np.sum(centers_m**2, axis=1) - radius_m**2
    seen: Float64[Array, "corner 3 3"] = inverse.T @ conics @ inverse
    return seen


def _conic_middles(conics: Float64[Array, "corner 3 3"]) -> Float64[Array, "corner xy=2"]:
    """A conic's centre is the pole of the line at infinity."""
    middles: Float64[Array, "corner xy=2"] = np.linalg.solve(conics[:, :2, :2], -conics[:, :2, 2:])[..., 0]
    return middles


def _radius_m(
    grey: UInt8[Array, "row column"],
    middles_px: Float64[Array, "corner xy=2"],
    centers_m: Float64[Array, "corner xy=2"],
    homography: Float64[Array, "3 3"],
) -> float:
    """The circles' common radius from their dark areas and local scales; zero if no area could be measured."""
    distance = np.linalg.norm(middles_px[:, None] - middles_px, axis=-1)
    np.fill_diagonal(distance, np.inf)
    areas_px = np.array(
        [_dark_area(grey, middle, 0.5 * float(near)) for middle, near in zip(middles_px, distance.min(1), strict=True)]
    )
    weight = centers_m @ homography[2, :2] + homography[2, 2]
    scale = abs(float(np.linalg.det(homography))) / np.abs(weight) ** 3
    measured = np.isfinite(areas_px)
    return float(np.sqrt(np.median(areas_px[measured] / scale[measured]) / np.pi)) if measured.any() else 0.0


def _dark_area(grey: UInt8[Array, "row column"], middle: Float64[Array, "xy=2"], reach: float) -> float:
    """Dark area around a circle's centre in pixels; NaN at the image's rim and for low contrast."""
    around = grey_around(grey, middle, int(reach))
    if around is None:
        return float("nan")
    patch, offset = around
    away = np.hypot(offset[..., 0], offset[..., 1])
    rim = patch[(away > reach - 2.0) & (away <= reach)]
    heart = patch[away < 2.0]
    if not len(rim) or not len(heart) or np.median(rim) - np.median(heart) < MIN_CONTRAST_DN:
        return float("nan")
    bright, dark = float(np.median(rim)), float(np.median(heart))
    share = np.clip((bright - patch) / (bright - dark), *_SHARES)
    return float(share[away <= reach].sum())


BAND_PX = 4.0
"""Half width of the band along the ellipse that contains the blurred edge."""

RIM_PX = 4.0
"""Width of the ring of paper around the band in which its level is measured."""

MIN_LEVEL_PIXELS = 20
"""Minimum number of pixels for a level that is a plane, of paper or ink."""


def levelled_middles(
    grey: UInt8[Array, "row column"],
    middles_px: Float64[Array, "circle xy=2"],
    conics: Float64[Array, "circle 3 3"],
) -> Float64[Array, "circle xy=2"]:
    """Centres fitted to the edges of the ink; a centre for which this fails is unchanged.

    Each ellipse has the shape of its conic, and starts at the given centre.
    """
    found = [_middle(grey, *one) for one in zip(middles_px, conics, strict=True)]
    return np.array([start if one is None else one for start, one in zip(middles_px, found, strict=True)])


def _middle(
    grey: UInt8[Array, "row column"], middle: Float64[Array, "xy=2"], conic: Float64[Array, "3 3"]
) -> Float64[Array, "xy=2"] | None:
    shape, extent = _shape(conic)
    half = int(np.ceil(extent + BAND_PX + RIM_PX))
    around = grey_around(grey, middle, half)
    if around is None:
        return None
    patch, offset = around
    outside = _outside_px(offset, shape)
    share = _dark_share(patch, offset, outside)
    if share is None:
        return None
    step = _step(share, outside, offset @ shape)
    return middle + step if np.linalg.norm(step) < BAND_PX / 2 else None


def _step(
    share: Float64[Array, "row column"],
    outside: Float64[Array, "row column"],
    slope: Float64[Array, "row column xy=2"],
) -> Float64[Array, "xy=2"]:
    """Step of the ellipse's centre that fits the shares in the band, its size free; the blur is measured first."""
    band = np.abs(outside) <= BAND_PX
    far, seen = outside[band], share[band]
    blur_px = max(np.sqrt(np.pi / 2) * 2 * BAND_PX * float(np.mean(np.abs(seen - (far < 0)))), MIN_BLUR_PX)
    steep = np.exp(-0.5 * (far / blur_px) ** 2) / (blur_px * np.sqrt(2 * np.pi))
    normal = slope[band] / np.linalg.norm(slope[band], axis=-1, keepdims=True)
    design = steep[:, None] * np.column_stack([normal, np.ones(len(far))])
    step: Float64[Array, "xy=2"] = np.linalg.lstsq(design, seen - ndtr(-far / blur_px))[0][:2]
    return step


def _shape(conic: Float64[Array, "3 3"]) -> tuple[Float64[Array, "2 2"], float]:
    """Matrix A of the ellipse x^T A x = 1 about its centre, and its semi-major axis."""
    middle = np.append(np.linalg.solve(conic[:2, :2], -conic[:2, 2]), 1.0)
    shape: Float64[Array, "2 2"] = conic[:2, :2] / -(middle @ conic @ middle)
    return shape, float(1.0 / np.sqrt(np.linalg.eigvalsh(shape)[0]))


def _outside_px(
    offset: Float64[Array, "row column xy=2"], shape: Float64[Array, "2 2"]
) -> Float64[Array, "row column"]:
    """Approximate distance from the ellipse, negative inside; exact on the axes and to first order near the ellipse."""
    mapped = offset @ shape
    size = np.sqrt(np.sum(mapped * offset, axis=-1))
    steep = np.maximum(np.linalg.norm(mapped, axis=-1), 1e-9)
    outside: Float64[Array, "row column"] = (size - 1.0) * size / steep
    return outside


def _dark_share(
    patch: Float64[Array, "row column"],
    offset: Float64[Array, "row column xy=2"],
    outside: Float64[Array, "row column"],
) -> Float64[Array, "row column"] | None:
    """Share of ink by pixel: 1 inside, 0 outside, measured in the band; None if the paper is not visible."""
    paper, ink = (outside > BAND_PX) & (outside < BAND_PX + RIM_PX), outside < -BAND_PX
    if paper.sum() < MIN_LEVEL_PIXELS:
        return None
    bright = _level(patch, offset, paper)
    dark = (
        _level(patch, offset, ink) if ink.sum() >= MIN_LEVEL_PIXELS else np.full(patch.shape, _darkest(patch, outside))
    )
    if (bright - dark).min() <= 0:
        return None
    share = (bright - patch) / (bright - dark)
    return np.where(outside > BAND_PX, 0.0, np.where(ink, 1.0, share))


def _darkest(patch: Float64[Array, "row column"], outside: Float64[Array, "row column"]) -> float:
    """Grey level in the centre of a small circle."""
    return float(np.median(patch[outside <= np.partition(outside.ravel(), 4)[4]]))


def _level(
    patch: Float64[Array, "row column"], offset: Float64[Array, "row column xy=2"], used: Bool[Array, "row column"]
) -> Float64[Array, "row column"]:
    """Plane fitted to the brightness of the used pixels, evaluated over the whole patch."""
    design = np.concatenate([np.ones((*patch.shape, 1)), offset], axis=-1)
    rows = design[used]
    plane: Float64[Array, "row column"] = design @ np.linalg.solve(rows.T @ rows, rows.T @ patch[used])
    return plane
