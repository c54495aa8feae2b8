"""Centres of the circles of an asymmetric grid in an image (ringpose-method(7), section 7).

A tilted circle is seen as an ellipse whose middle is not where the circle's centre is seen: its near half is seen
larger. The difference grows with the square of the radius, which is measured by the dark area.
"""

from typing import NamedTuple

import cv2
import numpy as np

from ringpose.calibrate.circle_middles import levelled_middles
from ringpose.calibrate.image_patch import grey_around
from ringpose.types.arrays import Array, Float64, UInt8

_ROUNDS = 2

DIM_DN, BRIGHT_DN = 110.0, 200.0
"""Paper darker than this is made so bright that circles are looked for at several levels between it and their ink."""

WHITE_PERCENT = 98
"""Of the pixels are darker than the brightest paper."""

LOWEST_CONTRAST_DN = 10.0
"""Below this a circle's area tells nothing."""

_SHARES = (-0.5, 1.5)
"""What a pixel may be of ink, with its noise: cut off at 0, paper would be part of the circle."""


class CircleCenters(NamedTuple):
    """Where circles' centres are seen."""

    points_px: Float64[Array, "corner xy=2"]
    radius_m: float
    """Of all circles; zero if it cannot be told."""


def circle_centers(
    grey: UInt8[Array, "row column"], points_m: Float64[Array, "corner xyz=3"], columns: int, rows: int
) -> CircleCenters | None:
    """Where the circles' centres are seen, whose places on the board are given; None if not all are found."""
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
    """The middles of the ellipses that the image shows; None if not all are found."""
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
    found, middles = cv2.findCirclesGrid(brightened(grey), (columns, rows), flags=flags)
    return np.asarray(middles, dtype=np.float64).reshape(-1, 2) if found else None


def brightened(grey: UInt8[Array, "row column"]) -> UInt8[Array, "row column"]:
    """A dark image as bright as others are: OpenCV looks for circles at levels of 50 grey values and more alone."""
    white = float(np.percentile(grey, WHITE_PERCENT))
    if not 0 < white < DIM_DN:
        return grey
    return np.rint(np.minimum(grey * (BRIGHT_DN / white), 255.0)).astype(np.uint8)


def ellipse_offsets(
    centers_m: Float64[Array, "corner xy=2"], radius_m: float, homography: Float64[Array, "3 3"]
) -> Float64[Array, "corner xy=2"]:
    """Middle of the ellipse less the image of the centre, for circles on a plane."""
    middles = _conic_middles(circle_conics(centers_m, radius_m, homography))
    offsets: Float64[Array, "corner xy=2"] = middles - cv2.perspectiveTransform(centers_m[None], homography)[0]
    return offsets


def seen_offsets(
    points_m: Float64[Array, "corner xyz=3"], points_px: Float64[Array, "corner xy=2"], radius_m: float
) -> Float64[Array, "corner xy=2"]:
    """The same for circles that are seen in these places, as if nothing but perspective had put them there."""
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
    """A conic's middle is the pole of the line at infinity."""
    middles: Float64[Array, "corner xy=2"] = np.linalg.solve(conics[:, :2, :2], -conics[:, :2, 2:])[..., 0]
    return middles


def _radius_m(
    grey: UInt8[Array, "row column"],
    middles_px: Float64[Array, "corner xy=2"],
    centers_m: Float64[Array, "corner xy=2"],
    homography: Float64[Array, "3 3"],
) -> float:
    """The circles' common radius, by the dark area of each and the scale there; zero where no area can be told."""
    distance = np.linalg.norm(middles_px[:, None] - middles_px, axis=-1)
    np.fill_diagonal(distance, np.inf)
    areas_px = np.array(
        [_dark_area(grey, middle, 0.5 * float(near)) for middle, near in zip(middles_px, distance.min(1), strict=True)]
    )
    weight = centers_m @ homography[2, :2] + homography[2, 2]
    scale = abs(float(np.linalg.det(homography))) / np.abs(weight) ** 3
    told = np.isfinite(areas_px)
    return float(np.sqrt(np.median(areas_px[told] / scale[told]) / np.pi)) if told.any() else 0.0


def _dark_area(grey: UInt8[Array, "row column"], middle: Float64[Array, "xy=2"], reach: float) -> float:
    """Pixels that are dark about a circle's middle, parts counted; NaN at the image's rim and without contrast."""
    around = grey_around(grey, middle, int(reach))
    if around is None:
        return float("nan")
    patch, offset = around
    away = np.hypot(offset[..., 0], offset[..., 1])
    rim = patch[(away > reach - 2.0) & (away <= reach)]
    heart = patch[away < 2.0]
    if not len(rim) or not len(heart) or np.median(rim) - np.median(heart) < LOWEST_CONTRAST_DN:
        return float("nan")
    bright, dark = float(np.median(rim)), float(np.median(heart))
    share = np.clip((bright - patch) / (bright - dark), *_SHARES)
    return float(share[away <= reach].sum())
