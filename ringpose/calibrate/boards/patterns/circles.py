"""Projected centres of the circles of a grid, dark or light ones (ringpose-method(7), section 7).

The projection of a circle is an ellipse whose centre is not the projection of the circle's centre, because the nearer
half appears larger. The difference grows with the square of the radius, which is measured from the dark area.

OpenCV's ellipse centres depend on a threshold, which is biased by uneven illumination: by 0.01 px where the brightness
changes by 0.1 % per pixel. Here the share of ink of each pixel is measured between the grey levels of ink and paper,
both planes, and centre and size of an ellipse with a blurred edge are fitted to these shares. The fit is one linear
least-squares step for each circle, and is done twice, the homography estimated again in between. It is not iterated to
convergence, by `scipy.optimize.least_squares` or otherwise: eight more rounds change the rms error of the homography
by at most 0.002 px on nine photographs (0.06 to 0.5 px).
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import ndtr

from ringpose.calibrate.boards.patterns.chessboard import unmirrored, upright
from ringpose.calibrate.boards.patterns.image_patch import (
    MIN_BLUR_PX,
    GreyImage,
    Offsets,
    Patch,
    brightness_plane,
    grey_around,
)
from ringpose.types.arrays import Array, Float64

Centers = Float64[Array, "circle xy=2"]
"""One point for each circle, on the board (m) or in the image (px)."""

DIM_DN, BRIGHT_DN = 110.0, 200.0
"""Images with paper darker than the first are scaled to the second, so that OpenCV uses several thresholds."""

WHITE_PERCENT = 98
"""Percentile of the image that is taken as paper."""

MIN_CONTRAST_DN = 10.0
"""Minimum contrast for a measurement of a circle's area."""

EDGE_PX = 4.0
"""Half width of the strip along an ellipse in which the shares of ink are fitted: it contains the blurred edge."""

PAPER_PX = 4.0
"""Width of the ring of paper outside that strip, in which the grey level of the paper is measured."""

MIN_LEVEL_PIXELS = 20
"""Minimum number of pixels for a grey level that is a plane, of paper or ink."""

NEAR_PLACE = 0.3
"""Distance of a circle from the place that its neighbours predict, in spacings: distortion displaces it by less than
0.1; doubled, wrongly ordered circles would pass, and what is printed beside the grid be part of it."""

MIN_SIZE_RATIO = 0.5
"""Smallest ratio of a circle's diameter to the typical one: 0.56 at the far side of a board that is tilted by 60
degrees and fills an image 54 degrees wide. At half of it, the zeros of a ruler beside a grid of 16 mm would pass;
doubled, no tilted board."""

_ROUNDS = 2

_SHARES = (-0.5, 1.5)
"""Limits of a pixel's noisy share of ink: clipping at 0 would add the noise of paper to the area."""


class CircleCenters(NamedTuple):
    """Projected centres of circles."""

    points_px: Float64[Array, "corner xy=2"]
    radius_m: float
    """Radius of all circles; zero if it could not be measured."""


def circle_centers(
    grey: GreyImage, points_m: Float64[Array, "corner xyz=3"], columns: int, rows: int, is_asymmetric: bool
) -> CircleCenters | None:
    """Projected centres of the circles with these positions on the board; None if not all are found.

    Light circles on a dark board are dark ones in the negative, which is searched if the image shows no grid.
    """
    grid_m = points_m[:, :2].reshape(rows, columns, 2)
    for image in (grey, negative(grey)):
        for without_small in (False, True):  # what is printed beside the circles seldom matters, and circles are whole
            ellipses_px = opencv_ellipse_centers(image, columns, rows, is_asymmetric, without_small)
            if ellipses_px is not None and _is_whole_grid(image, ellipses_px, grid_m):
                return _projected_centers(image, ellipses_px, points_m[:, :2])
    return None


def negative(grey: GreyImage) -> GreyImage:
    """The image with dark and bright exchanged, its brightest pixel black."""
    return grey.max() - grey


def _projected_centers(grey: GreyImage, ellipses_px: Centers, centers_m: Centers) -> CircleCenters:
    """The centres of dark ellipses refined, and corrected for the perspective of their circles."""
    image_from_board = _homography(centers_m, ellipses_px)
    radius_m = _radius_m(grey, ellipses_px, centers_m, image_from_board)
    for _ in range(_ROUNDS if radius_m else 0):
        ellipses_px = refined_ellipse_centers(grey, ellipses_px, circle_conics(centers_m, radius_m, image_from_board))
        image_from_board = _homography(centers_m, ellipses_px)
    return CircleCenters(ellipses_px - ellipse_offsets(centers_m, radius_m, image_from_board), radius_m)


def opencv_ellipse_centers(
    grey: GreyImage, columns: int, rows: int, is_asymmetric: bool, without_small: bool = False
) -> Centers | None:
    """OpenCV's centres of the dark ellipses in the order of the board's circles; None if not all are found."""
    image = brightened(grey)
    detector = blob_detector(image, columns * rows, without_small)
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if is_asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    for by_clusters in (cv2.CALIB_CB_CLUSTERING, 0):  # clusters of near circles; if clutter is near, the graph of them
        is_found, centers = cv2.findCirclesGrid(image, (columns, rows), flags=kind | by_clusters, blobDetector=detector)
        if is_found:
            grid = np.asarray(centers, dtype=np.float64).reshape(rows, columns, 2)
            return (_rows_in_turn(grid) if is_asymmetric else upright(unmirrored(grid), columns == rows)).reshape(-1, 2)
    return None


def _rows_in_turn(
    grid: Float64[Array, "grid_row grid_column xy=2"],
) -> Float64[Array, "grid_row grid_column xy=2"]:
    """An asymmetric grid with its rows in their order.

    OpenCV finds grids with an even number of rows by their graph only, and exchanges the rows of each pair where it
    starts from the other end.
    """
    from_first = grid.mean(axis=1) - grid[0].mean(axis=0)
    if len(grid) % 2 or len(grid) < 4 or from_first[1] @ from_first[2] > 0:
        return grid
    return grid.reshape(-1, 2, *grid.shape[1:])[:, ::-1].reshape(grid.shape)


def blob_detector(image: GreyImage, circles: int, without_small: bool) -> cv2.SimpleBlobDetector:
    """OpenCV's detector of the dark blobs in a brightened image, each at most its share of one that the board fills.

    Without small blobs, such as the zeros of the ruler and the label on a sheet: those much smaller than is typical,
    the median of as many of the largest blobs as the board has circles, however many small ones there are.
    """
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.maxArea = image.size / circles
    if without_small:
        diameters_px = sorted(blob.size for blob in cv2.SimpleBlobDetector.create(parameters).detect(image))
        if diameters_px:
            parameters.minArea = np.pi / 4 * (MIN_SIZE_RATIO * float(np.median(diameters_px[-circles:]))) ** 2
    return cv2.SimpleBlobDetector.create(parameters)


def _is_whole_grid(grey: GreyImage, ellipses_px: Centers, grid_m: Float64[Array, "grid_row grid_column xy=2"]) -> bool:
    """Whether each circle is where its neighbours predict it, and no further ones are beyond a side of the grid.

    Perspective is undone first. A row is predicted by three rows beside it, of which every other one is shifted if the
    grid is asymmetric.
    """
    image = brightened(grey)
    blobs = blob_detector(image, len(ellipses_px), without_small=True).detect(image)
    board_from_image = np.linalg.inv(_homography(grid_m.reshape(-1, 2), ellipses_px))
    seen_px = np.concatenate([ellipses_px, np.array([blob.pt for blob in blobs]).reshape(-1, 2)])
    seen_m = cv2.perspectiveTransform(seen_px[None], board_from_image)[0]
    rows, blobs_m = seen_m[: len(ellipses_px)].reshape(grid_m.shape), seen_m[len(ellipses_px) :]
    columns, near_m = rows.swapaxes(0, 1), NEAR_PLACE * float(np.linalg.norm(grid_m[1, 0] - grid_m[0, 0]))
    predicted = [(rows[:-3], rows[1:-2] + rows[2:-1] - rows[3:]), (columns[:-2], 2 * columns[1:-1] - columns[2:])]
    if any((np.linalg.norm(places - circles, axis=-1) > near_m).any() for circles, places in predicted):
        return False
    beyond = [2 * columns[0] - columns[1], 2 * columns[-1] - columns[-2]]
    if len(rows) > 2:
        beyond += [rows[0] + rows[1] - rows[2], rows[-1] + rows[-2] - rows[-3]]
    nearest_m = [np.linalg.norm(places[:, None] - blobs_m, axis=-1).min(axis=1) for places in beyond]
    return all(np.mean(distance_m < near_m) < 0.5 for distance_m in nearest_m)


def brightened(grey: GreyImage) -> GreyImage:
    """A dark image scaled to normal brightness: OpenCV's lowest threshold for circles is 50 grey levels."""
    white = float(np.percentile(grey, WHITE_PERCENT))
    if not 0 < white < DIM_DN:
        return grey
    return np.rint(np.minimum(grey * (BRIGHT_DN / white), 255.0)).astype(np.uint8)


def _homography(centers_m: Centers, ellipses_px: Centers) -> Float64[Array, "3 3"]:
    """Homography from the board's plane to the image, by the circles' centres."""
    return np.asarray(cv2.findHomography(centers_m, ellipses_px)[0], dtype=np.float64)


def _radius_m(grey: GreyImage, ellipses_px: Centers, centers_m: Centers, homography: Float64[Array, "3 3"]) -> float:
    """The circles' common radius from their dark areas and local scales; zero if no area could be measured."""
    distance = np.linalg.norm(ellipses_px[:, None] - ellipses_px, axis=-1)
    np.fill_diagonal(distance, np.inf)
    areas_px = np.array(
        [_dark_area(grey, center, 0.5 * float(near)) for center, near in zip(ellipses_px, distance.min(1), strict=True)]
    )
    weight = centers_m @ homography[2, :2] + homography[2, 2]
    scale = abs(float(np.linalg.det(homography))) / np.abs(weight) ** 3
    measured = np.isfinite(areas_px)
    return float(np.sqrt(np.median(areas_px[measured] / scale[measured]) / np.pi)) if measured.any() else 0.0


def _dark_area(grey: GreyImage, center: Float64[Array, "xy=2"], reach: float) -> float:
    """Dark area within `reach` of a circle's centre, in pixels; NaN at the image's rim and for low contrast."""
    around = grey_around(grey, center, int(reach))
    if around is None:
        return float("nan")
    patch, offset = around
    away = np.hypot(offset[..., 0], offset[..., 1])
    paper, ink = patch[(away > reach - 2.0) & (away <= reach)], patch[away < 2.0]
    if not len(paper) or not len(ink) or np.median(paper) - np.median(ink) < MIN_CONTRAST_DN:
        return float("nan")
    bright, dark = float(np.median(paper)), float(np.median(ink))
    share = np.clip((bright - patch) / (bright - dark), *_SHARES)
    return float(share[away <= reach].sum())


def circle_conics(
    centers_m: Centers, radius_m: float, homography: Float64[Array, "3 3"]
) -> Float64[Array, "circle 3 3"]:
    """The circles' conics in the image: C becomes H^-T C H^-1."""
    inverse = np.linalg.inv(homography)
    conics = np.zeros((len(centers_m), 3, 3))
    conics[:, 0, 0] = conics[:, 1, 1] = 1.0
    conics[:, :2, 2] = conics[:, 2, :2] = -centers_m
    conics[:, 2, 2] = np.sum(centers_m**2, axis=1) - radius_m**2
    return inverse.T @ conics @ inverse


def ellipse_offsets(centers_m: Centers, radius_m: float, homography: Float64[Array, "3 3"]) -> Centers:
    """Centre of the ellipse minus projection of the circle's centre, in pixels, for circles on a plane."""
    conics = circle_conics(centers_m, radius_m, homography)
    ellipses_px = np.linalg.solve(conics[:, :2, :2], -conics[:, :2, 2:])[..., 0]  # pole of the line at infinity
    return ellipses_px - cv2.perspectiveTransform(centers_m[None], homography)[0]


def seen_offsets(
    points_m: Float64[Array, "corner xyz=3"], points_px: Float64[Array, "corner xy=2"], radius_m: float
) -> Float64[Array, "corner xy=2"]:
    """The `ellipse_offsets` of circles, from their positions on the board and their undistorted projected centres."""
    return ellipse_offsets(points_m[:, :2], radius_m, _homography(points_m[:, :2], points_px))


def refined_ellipse_centers(grey: GreyImage, ellipses_px: Centers, conics: Float64[Array, "circle 3 3"]) -> Centers:
    """Centres of ellipses, fitted to their ink's edges; a centre for which this fails is unchanged.

    Each ellipse has the shape of its conic, and starts at the given centre.
    """
    middles = [_middle(grey, *one) for one in zip(ellipses_px, conics, strict=True)]
    return np.array([start if one is None else one for start, one in zip(ellipses_px, middles, strict=True)])


def _middle(
    grey: GreyImage, start: Float64[Array, "xy=2"], conic: Float64[Array, "3 3"]
) -> Float64[Array, "xy=2"] | None:
    """The fitted centre of one ellipse; None at the image's rim, without visible paper, and if it moves too far."""
    center = np.append(np.linalg.solve(conic[:2, :2], -conic[:2, 2]), 1.0)
    shape = conic[:2, :2] / -(center @ conic @ center)  # x^T shape x = 1 about the ellipse's centre
    semi_major_px = float(1.0 / np.sqrt(np.linalg.eigvalsh(shape)[0]))
    around = grey_around(grey, start, int(np.ceil(semi_major_px + EDGE_PX + PAPER_PX)))
    if around is None:
        return None
    patch, offset = around
    # Distance from the ellipse, negative inside: exact on the axes, and to first order near the ellipse.
    slope = offset @ shape
    size = np.sqrt(np.sum(slope * offset, axis=-1))
    gradient = np.linalg.norm(slope, axis=-1)  # zero at the very centre
    outside = (size - 1.0) * np.divide(size, gradient, out=np.full_like(size, semi_major_px), where=gradient > 0)
    share = _ink_share(patch, offset, outside)
    if share is None:
        return None
    step = _step(share, outside, slope)
    return start + step if np.linalg.norm(step) < EDGE_PX / 2 else None


def _ink_share(patch: Patch, offset: Offsets, outside: Patch) -> Patch | None:
    """Share of ink in each pixel: measured near the ellipse, elsewhere 1 inside and 0 outside.

    None without visible paper.
    """
    paper, ink = (outside > EDGE_PX) & (outside < EDGE_PX + PAPER_PX), outside < -EDGE_PX
    if paper.sum() < MIN_LEVEL_PIXELS:
        return None
    bright = brightness_plane(patch, offset, paper)
    if ink.sum() >= MIN_LEVEL_PIXELS:
        dark = brightness_plane(patch, offset, ink)
    else:  # a small circle: the grey level of its five innermost pixels
        innermost = outside <= np.partition(outside.ravel(), 4)[4]
        dark = np.full(patch.shape, float(np.median(patch[innermost])))
    if (bright - dark).min() <= 0:
        return None
    share = (bright - patch) / (bright - dark)
    return np.where(outside > EDGE_PX, 0.0, np.where(ink, 1.0, share))


def _step(share: Patch, outside: Patch, slope: Offsets) -> Float64[Array, "xy=2"]:
    """Step of the ellipse's centre that fits the shares of ink near its edge; its size is free, its blur measured here.

    `slope` has the direction of the gradient of `outside`.
    """
    near = np.abs(outside) <= EDGE_PX
    distance, seen = outside[near], share[near]
    blur_px = max(np.sqrt(np.pi / 2) * 2 * EDGE_PX * float(np.mean(np.abs(seen - (distance < 0)))), MIN_BLUR_PX)
    density = np.exp(-0.5 * (distance / blur_px) ** 2) / (blur_px * np.sqrt(2 * np.pi))
    normal = slope[near] / np.linalg.norm(slope[near], axis=-1, keepdims=True)
    jacobian = density[:, None] * np.column_stack([normal, np.ones(len(distance))])
    return np.linalg.lstsq(jacobian, seen - ndtr(-distance / blur_px))[0][:2]
