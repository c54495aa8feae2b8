"""Stripes on the board in one shot, labelled where the frames identify the laser (ringpose-method(7), section 6).

On a board, a light plane draws a straight line, also in the undistorted image. Lines are extracted one after the
other from the stripe centres of a frame, the one that carries the most light first; centres beside the usable regions
of the board's plane, and texture, do not form lines. `stripe_failure` finds the reason where the number of stripes is
wrong.

The sheet that carries the print is wider than it. Two points in a light plane that one line of sight meets are the
same point: a line that the print shows may be followed beyond it as far as it is straight. A line beside the print
counts where the image shows the sheet from the print up to it (`with_sheet_seen`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ringpose.calibrate.boards.patterns.image_patch import in_full_image, reduced
from ringpose.calibrate.boards.pose import board_pose
from ringpose.detect.difference_images import LaserImage
from ringpose.detect.stripes import find_stripes, shown_ghost
from ringpose.geometry.board import black_rectangles, marker_corners, outline_m
from ringpose.geometry.least_squares import robust_std
from ringpose.geometry.rays import intersect, project, rays, undistorted_pixels
from ringpose.types.arrays import Array, Bool, Float64, UInt, UInt8
from ringpose.types.board import Board, BoardPose, BoardView
from ringpose.types.calibration import StripeView
from ringpose.types.detection import SubtractedGhost
from ringpose.types.image import Frame, Shot, board_image, dark_image
from ringpose.types.rig import Camera

NEAR_PX = 1.5
"""Centres within this distance of a line belong to it, before its own scatter is known."""

TRIALS = 300
"""Random pairs tried for each line: with a fifth of the light on the line, all miss it once in 200 000 frames."""

MINIMUM_CENTERS = 40
"""Minimum number of centres on a line: fewer are texture or dust."""

RIVAL_SHARE = 0.5
"""A frame is ambiguous if an additional line has at least this share of the light of its weakest stripe."""

OUTLIER_SIGMAS = 3.5
"""Centres farther from their line than this number of robust standard deviations are left out."""

SHRINKINGS = (1, 2, 4)
"""Factors by which a frame is reduced until its stripes are narrow enough for the stripe detector: a saturated or
defocused stripe has two ridges, its shoulders, at a width of 15 px, and one at 4 px."""

FAINT_SIGMAS = 8.0
"""Peak over the noise on the board, in standard deviations, below which no laser light is visible."""

FULL_SHARE = 0.02
"""Share of saturated pixels above which the board itself is saturated: a stripe covers 1 % of it."""

MAX_WIDTH_PX = 25.0
"""Largest full width at half maximum of a stripe: images are reduced to a quarter at most."""

PRINT_MARGIN_PX = 5.0
"""Distance from a printed edge within which a stripe's profile is asymmetric: three stripe sigmas."""

_PRINT_PERCENTILES = (5, 90)
"""Percentiles of the grey values on the board that are those of its dark and light parts: of the usual boards a twelfth
or more is black, of the lasers' light without a frame to subtract a twentieth or less of the board is lit."""

_SHEET_REDUCTION = 2
"""Factor by which the image is reduced in which the sheet is followed: averages noise, and thin lines of print."""

_SMOOTHING_PX = 2.0
"""Standard deviation of the smoothing against noise and speckle before the width of bright regions is measured."""

_NOTHING = np.empty((0, 2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardSurface:
    """The flat sheet that carries the board, in one view."""

    board: Board
    pose: BoardPose
    camera: Camera
    surround_m: float = 0.0
    """Width of the flat sheet beyond the board's outline, as far as it is given."""
    sheet: Bool[Array, "small_row small_column"] | None = None
    """Where the image, reduced by `_SHEET_REDUCTION`, shows the sheet beside the print; None if it is not searched."""
    lit_dn: float = 0.0
    """Grey value above which the sheet is lit by more than ambient light."""
    first_is_used: bool = False
    """Whether stripes are used on a chessboard's squares of the outer top-left one's colour, or on the others."""

    def usable(self, points_px: Float64[Array, "n xy=2"]) -> Bool[Array, "n"]:
        """Which pixels lie on the sheet and away from printed edges."""
        board = self.board
        on_board_m = (triangulated(points_px, self.pose, self.camera) - self.pose.translation_m) @ self.pose.rotation
        position_m: Float64[Array, "n xy=2"] = np.nan_to_num(on_board_m[:, :2], nan=np.inf)
        margin = PRINT_MARGIN_PX * float(self.pose.translation_m[2] / self.camera.camera_matrix[0, 0])
        low = -self.surround_m if self.surround_m else margin
        usable = np.all((position_m > low) & (position_m < np.array(outline_m(board)) - low), axis=1)

        marker_margin = margin
        if board.kind == "charuco":  # a grid of squares too: the margin beside a marker is its white rim
            marker_margin = min(margin, ((board.square_m or 0.0) - (board.marker_m or 0.0)) / 4)
        printed_m = marker_corners(board)
        if board.kind not in ("chessboard", "charuco"):
            printed_m = np.concatenate([printed_m, black_rectangles(board)])
        for corners in printed_m[..., :2]:
            low_m, high_m = corners.min(axis=0) - marker_margin, corners.max(axis=0) + marker_margin
            near = (position_m > low_m) & (position_m < high_m)
            usable &= ~np.all(near, axis=1)

        if board.kind in ("chessboard", "charuco"):
            square, counts = np.array(board.square_size_m), np.array([board.squares_x or 0, board.squares_y or 0])
            cell = np.where(np.isfinite(position_m), position_m, -square) / square
            near_edge = (np.abs(cell - np.rint(cell)) * square).min(axis=1) < margin
            printed = np.all((position_m > -margin) & (position_m < counts * square + margin), axis=1)
            usable &= ~(near_edge & printed)
        if board.kind == "chessboard":  # on a ChArUco board all squares are used, because markers fill the light ones
            column, row = np.floor(cell).T
            on_square = np.all((cell >= 0) & (np.floor(cell) < counts), axis=1)
            usable &= ~(on_square & ((column + row) % 2 == (1 if self.first_is_used else 0)))
        return usable

    def beside(self, points_px: Float64[Array, "n xy=2"]) -> Bool[Array, "n"]:
        """Which pixels show the sheet beside the print, by the image."""
        if self.sheet is None:
            return np.zeros(len(points_px), dtype=bool)
        x, y = np.rint((points_px - (_SHEET_REDUCTION - 1) / 2) / _SHEET_REDUCTION).astype(np.int64).T
        rows, columns = self.sheet.shape
        shown = (x >= 0) & (y >= 0) & (x < columns) & (y < rows)
        shown[shown] = self.sheet[y[shown], x[shown]]
        return shown

    def crossed_by(self, points_px: Float64[Array, "n xy=2"], spacing_px: int) -> bool:
        """Whether centres at this spacing cover half of their line on the sheet; those of glare do not."""
        middle = points_px.mean(axis=0)
        along = np.linalg.svd(points_px - middle, full_matrices=False)[2][0]
        along = along / np.abs(along).max()  # a pixel along the rows or the columns
        reach = (self.camera.image_width + self.camera.image_height) // spacing_px
        line_px = middle + spacing_px * np.arange(-reach, reach + 1)[:, None] * along
        return 2 * len(points_px) > int(self.beside(line_px).sum())


def stripe_view(
    shot: Shot, view: BoardView, board: Board, camera: Camera, names: Sequence[str], surround_m: float | None = None
) -> StripeView:
    """The stripes on the board in one shot, by laser where the frames identify it.

    Frames with one laser on label their stripe; those with several are used for lasers without such a frame. `names`
    are those of the lasers, by mask bit.
    """
    surface = board_surface(shot, board, board_pose(view, camera), camera, surround_m)
    dark = dark_image(shot)
    lasers = len(names)
    every = (1 << lasers) - 1
    labelled: dict[int, Float64[Array, "_ xy=2"]] = {}
    unlabelled: tuple[Float64[Array, "_ xy=2"], ...] = ()
    remarks: list[str] = []
    ghosts: list[tuple[int, SubtractedGhost]] = []
    most = 0
    for frame in sorted(shot.frames, key=lambda frame: (frame.lasers & every).bit_count()):
        on = [laser for laser in range(lasers) if frame.lasers >> laser & 1]
        if not on or all(laser in labelled for laser in on):
            continue
        lines = sorted(stripe_lines(frame.image, dark, surface, len(on)), key=lambda line: line.position_px)
        stripes = tuple(line.points_px for line in lines)
        most = max(most, len(stripes))
        if len(stripes) != len(on):
            lit = [names[laser] for laser in on]
            remark = stripe_failure(frame.image, dark, surface, len(stripes), lit, shot.saturation_dn)
            remarks += [] if remarks and len(on) > 1 else [remark]
            continue
        ghost = _shown_ghost(shot, frame, dark, along_columns=lines[0].upright)
        ghosts += [] if ghost is None else [(laser, ghost) for laser in on]
        if len(on) == 1:
            labelled[on[0]] = stripes[0]
        elif len(on) == lasers and not unlabelled:
            unlabelled = stripes
    return StripeView(
        board=view,
        stripes_px=tuple(labelled.get(laser, _NOTHING) for laser in range(lasers)),
        unlabelled_px=unlabelled,
        remarks=tuple(remarks),
        lit=frozenset(laser for laser in range(lasers) if (shot.lasers >> laser & 1).any()),
        max_stripes=most,
        print_m=outline_m(board),
        ghosts=tuple(ghosts),
    )


def _shown_ghost(
    shot: Shot, frame: Frame, dark: UInt[Array, "row column"] | None, *, along_columns: bool
) -> SubtractedGhost | None:
    """The ghost of the stripes in a frame, its offset across them."""
    lit = np.ascontiguousarray(frame.image.T) if along_columns else frame.image
    image = LaserImage(
        lit=lit,
        dark=dark if dark is None or not along_columns else np.ascontiguousarray(dark.T),
        saturation_dn=shot.saturation_dn,
        threshold_scale_dn=shot.usual_full_dn,
        lasers=(),
        stamp_s=frame.stamp_s,
    )
    return shown_ghost(image)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeLine:
    """Centres of one stripe on the board."""

    points_px: Float64[Array, "n xy=2"]
    light: float
    """Sum of the peak intensities of its centres."""
    printed_light: float
    """That of the centres on the print, which are the board's for certain."""
    upright: bool
    """True if it runs along the columns, false if along the rows."""

    @property
    def position_px(self) -> float:
        """Mean position across the stripe: the row, or the column of an upright stripe."""
        return float(self.points_px[:, 0 if self.upright else 1].mean())


def stripe_lines(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    surface: BoardSurface,
    lasers: int,
) -> list[StripeLine]:
    """One line for each laser that is on, brightest first; fewer or more if the frame shows another number."""
    extracted: list[StripeLine] = []
    for shrinking in SHRINKINGS:
        lines = _lines_at_scale(image, dark, surface, lasers, shrinking)
        if len(lines) == lasers:
            return lines
        extracted = extracted or lines
    return extracted


def _lines_at_scale(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    surface: BoardSurface,
    lasers: int,
    shrinking: int,
) -> list[StripeLine]:
    """The lines of the lasers in a reduced frame, all along rows or all along columns.

    One line more than `lasers` is returned if it is about as bright as they are.
    """
    small, small_dark = reduced(image, shrinking), None if dark is None else reduced(dark, shrinking)
    along_rows, upright = (_lines(small, small_dark, surface, lasers, shrinking, way) for way in (False, True))
    best = max(along_rows, upright, key=lambda lines: _light(lines[:lasers]))
    rivals = [line for line in best[lasers:] if line.light > RIVAL_SHARE * best[lasers - 1].light]
    return best[:lasers] + rivals


def _light(lines: list[StripeLine]) -> tuple[float, float]:
    """Light by which lines along the rows or along the columns are chosen: on the print, else on all of the sheet."""
    return sum((line.printed_light for line in lines), 0.0), sum((line.light for line in lines), 0.0)


def _lines(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    surface: BoardSurface,
    lasers: int,
    shrinking: int,
    upright: bool,
) -> list[StripeLine]:
    """Up to one line more than `lasers` along the rows of a reduced frame or, upright, along its columns.

    Lines on the print come first, each followed over the sheet beside it. If there are fewer than lasers, the others
    may run beside the print only.
    """
    if upright:
        image, dark = np.ascontiguousarray(image.T), None if dark is None else np.ascontiguousarray(dark.T)
    stripes = find_stripes(image, dark)
    centers_px = in_full_image(stripes.position_px, shrinking)
    points_px = centers_px[:, ::-1].copy() if upright else centers_px
    printed, beside = surface.usable(points_px), surface.beside(points_px)
    if dark is None:  # between the print and a dark table, a strip of the sheet itself looks like a stripe
        column, row = np.rint(stripes.position_px).astype(np.int64).T
        beside &= image[row, column] > surface.lit_dn
    on_sheet = printed | beside
    points_px, peak, printed = points_px[on_sheet], stripes.peak_dn[on_sheet], printed[on_sheet]
    straight = undistorted_pixels(points_px, surface.camera) / shrinking
    straight = straight[:, ::-1].copy() if upright else straight
    lines = _straight_lines(straight, peak, printed, lasers + 1)
    if np.sum(~printed) >= MINIMUM_CENTERS:
        wider = _straight_lines(straight, peak, np.ones_like(printed), 2 * (lasers + 1))
        others = [line for line in wider if not any((line & own).any() for own in lines)]
        lines = [next((line for line in wider if 2 * np.sum(line & own) > own.sum()), own) for own in lines]
        if len(lines) < lasers:
            crossing = [line for line in others if surface.crossed_by(points_px[line], shrinking)]
            lines += crossing[: lasers + 1 - len(lines)]
    return [
        StripeLine(
            points_px=points_px[line],
            light=float(peak[line].sum()),
            printed_light=float(peak[line & printed].sum()),
            upright=upright,
        )
        for line in lines
    ]


def _straight_lines(
    points: Float64[Array, "n xy=2"], peak: Float64[Array, "n"], left: Bool[Array, "n"], most: int
) -> list[Bool[Array, "n"]]:
    """Which points each line consists of, the one that carries the most light first; of the points `left` only."""
    lines: list[Bool[Array, "n"]] = []
    rng = np.random.default_rng(0)
    while len(lines) < most and left.sum() >= MINIMUM_CENTERS:
        index = np.flatnonzero(left)
        near = np.zeros_like(left)
        near[index] = _on_brightest_line(points[index], peak[index], rng)
        if near.sum() < MINIMUM_CENTERS:
            break
        lines.append(near & _clean(points, near))
        left = left & ~near
    return lines


def _on_brightest_line(
    points: Float64[Array, "n xy=2"], peak: Float64[Array, "n"], rng: np.random.Generator
) -> Bool[Array, "n"]:
    """Centres near the line y = a + b x, |b| < 1, that carries the most light (RANSAC weighted by intensity)."""
    pairs = rng.choice(len(points), size=(TRIALS, 2), p=peak / peak.sum())
    first, second = points[pairs[:, 0]], points[pairs[:, 1]]
    run = second[:, 0] - first[:, 0]
    apart = np.abs(run) > MINIMUM_CENTERS
    slope = (second[apart, 1] - first[apart, 1]) / run[apart]
    along_rows = np.abs(slope) < 1.0
    best = np.zeros(len(points), dtype=bool)
    most = 0.0
    for start, gradient in zip(first[apart][along_rows], slope[along_rows], strict=True):
        near = np.abs(points[:, 1] - start[1] - gradient * (points[:, 0] - start[0])) < NEAR_PX
        light = float(peak[near].sum())
        if light > most:
            best, most = near, light
    return best


def _clean(points: Float64[Array, "n xy=2"], on_line: Bool[Array, "n"]) -> Bool[Array, "n"]:
    """The centres on a line that are within the outlier limit of its least-squares fit."""
    used = on_line
    for _ in range(3):
        line = np.polynomial.polynomial.polyfit(points[used, 0], points[used, 1], 1)
        residual = np.abs(points[:, 1] - np.polynomial.polynomial.polyval(points[:, 0], line))
        limit = OUTLIER_SIGMAS * robust_std(residual[used])
        used = on_line & (residual <= max(limit, 1e-6))
    return used


def stripe_failure(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    surface: BoardSurface,
    stripes: int,
    on: Sequence[str],
    saturation_dn: int,
) -> str:
    """The reason, with measured values, why `stripes` is not the number of lasers that are `on`."""
    lasers = f"{len(on)} lasers are on" if len(on) > 1 else f"{on[0]} is on"
    if stripes > len(on):
        return f"more stripes on the board where {lasers}: reflections, or another light?"
    finding = f"{stripes} stripe{'s' * (stripes != 1)} on the board where {lasers}"
    board = _on_board(surface, image.shape)
    if not board.any():
        return f"{finding}: the board is out of the image"
    full = float(np.mean(image[board] >= saturation_dn))
    if full > FULL_SHARE:
        return f"{finding}: {100 * full:.0f} % of the board is saturated"
    lit = image[board].astype(np.float64) - (0.0 if dark is None else dark[board])
    background = float(np.median(lit))
    noise = max(robust_std(lit - background), 1.0)
    brightest = float(np.percentile(lit, 99.8)) - background
    width_px = 0.0
    if dark is not None:  # largest width of the region that the lasers make brighter than half of the maximum
        smooth = cv2.GaussianBlur(image.astype(np.float32) - dark, (0, 0), _SMOOTHING_PX)
        bright = ((smooth > background + brightest / 2) & board).astype(np.uint8)
        width_px = 2.0 * float(cv2.distanceTransform(bright, cv2.DIST_L2, 5).max())
    if brightest > FAINT_SIGMAS and width_px > MAX_WIDTH_PX:
        return f"{finding}: blurred, or not the lasers' light: {width_px:.0f} px wide at half its height"
    anywhere = replace(surface, surround_m=math.inf, sheet=None)
    if surface.sheet is not None and stripes < len(stripe_lines(image, dark, anywhere, len(on))) <= len(on):
        return (
            f"{finding}: beside it, past an edge or a mark in the image; if the flat sheet reaches so far, "
            "give its width (--surround)"
        )
    if brightest < FAINT_SIGMAS * noise:
        most = f"nothing stands out by more than {brightest:.0f} of {saturation_dn} grey values"
        return f"{finding}: too dark, or beside the board: {most}"
    return f"{finding}: missing or cut off, though something is {brightest:.0f} grey values bright"


def _on_board(surface: BoardSurface, shape: tuple[int, ...]) -> Bool[Array, "row column"]:
    """Mask of the pixels inside the board's outline."""
    width, height = outline_m(surface.board)
    corners = np.array([[0.0, 0.0, 0.0], [width, 0.0, 0.0], [width, height, 0.0], [0.0, height, 0.0]])
    pixels: Float64[Array, "4 2"] = project(
        corners @ surface.pose.rotation.T + surface.pose.translation_m, surface.camera
    )
    mask = np.zeros(shape, dtype=np.uint8)
    if np.isfinite(pixels).all():
        cv2.fillConvexPoly(mask, np.rint(pixels).astype(np.int32), 1)
    return mask.astype(bool)


def board_surface(
    shot: Shot, board: Board, pose: BoardPose, camera: Camera, surround_m: float | None = None
) -> BoardSurface:
    """The board's face in a shot; on a chessboard, the grey values determine which squares are used.

    Without a width of the sheet beyond the print it reaches as far as the image shows it.

    Light squares are used: black ink reflects a tenth of the light, and centres on it scatter three times as much.
    Without a frame with lasers off to subtract, dark squares are used: there, stripes stand out from the background.
    """
    first_is_dark = True
    if board.kind == "chessboard":
        image = board_image(shot)
        row, column = np.mgrid[0 : board.squares_y or 0, 0 : board.squares_x or 0]
        centers = np.stack([column + 0.5, row + 0.5], axis=-1).reshape(-1, 2) * board.square_size_m
        points = np.column_stack([centers, np.zeros(len(centers))]) @ pose.rotation.T + pose.translation_m
        x, y = np.rint(np.nan_to_num(project(points, camera), nan=-1.0)).T
        inside = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
        grey = image[y[inside].astype(np.int64), x[inside].astype(np.int64)]
        odd = (row + column).ravel()[inside] % 2 == 1  # squares of the other colour than the outer top-left one
        if odd.any() and not odd.all():
            first_is_dark = float(np.median(grey[odd])) >= float(np.median(grey[~odd]))
    surface = BoardSurface(
        board=board, pose=pose, camera=camera, surround_m=surround_m or 0.0,
        first_is_used=first_is_dark == (dark_image(shot) is None),
    )  # fmt: skip
    return surface if surround_m is not None else with_sheet_seen(surface, board_image(shot))


def with_sheet_seen(surface: BoardSurface, image: UInt[Array, "row column"]) -> BoardSurface:
    """The surface with the sheet beside the print, as far as the image shows it without a break from the print on.

    The sheet is as light as the light parts of the print. It ends where the image is darker than half-way to the dark
    ones: at its edge with a shadow or a darker table behind, and at marks on it. Stripes in the image, which could lead
    over the edge, are crossed only as far as the widest stripe is wide.
    """
    grey = reduced(image, _SHEET_REDUCTION)
    board = reduced(_on_board(surface, image.shape).astype(np.uint8), _SHEET_REDUCTION)
    if not board.any():
        return replace(surface, sheet=board > 0)
    dark, light = np.percentile(grey[board > 0], _PRINT_PERCENTILES).tolist()
    half = (light - dark) / 2
    stripes = grey > max((light + float(grey.max())) / 2, light + 2 * half)
    clear = cv2.erode(((grey > light - half) | (board > 0)).astype(np.uint8), _disc(PRINT_MARGIN_PX))
    _, region = cv2.connectedComponents(clear * ~stripes, connectivity=4)
    seen = np.isin(region, np.unique(region[(board > 0) & (region > 0)])).astype(np.uint8)
    seen |= cv2.dilate(seen, _disc(MAX_WIDTH_PX / 2)) & stripes
    sheet = (seen > 0) & (clear > 0) & (cv2.dilate(board, _disc(PRINT_MARGIN_PX)) == 0)
    return replace(surface, sheet=sheet, lit_dn=light + half)


def _disc(radius_px: float) -> UInt8[Array, "side side"]:
    """A disc of this radius in the image, as the mask of a reduced one."""
    side = 2 * math.ceil(radius_px / _SHEET_REDUCTION) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), dtype=np.uint8)


def triangulated(points_px: Float64[Array, "n xy=2"], pose: BoardPose, camera: Camera) -> Float64[Array, "n xyz=3"]:
    """Intersections of distorted pixels' rays r with the board: P = t r, t = (n_b . c_b) / (n_b . r), camera frame."""
    normal = pose.rotation[:, 2]
    return intersect(rays(points_px, camera), normal, np.array(float(normal @ pose.translation_m)))
