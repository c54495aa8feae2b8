"""Stripes on the board in one shot, labelled where the frames identify the laser (ringpose-method(7), section 6).

On a board, a light plane draws a straight line, also in the undistorted image. Lines are extracted one after the
other from the stripe centres of a frame, the one that carries the most light first; centres beside the usable regions
of the board's plane, and texture, do not form lines. `stripe_failure` finds the reason where the number of stripes is
wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.calibrate.boards.patterns.image_patch import in_full_image, reduced
from ringpose.calibrate.boards.pose import board_pose
from ringpose.detect.difference_images import LaserImage
from ringpose.detect.stripes import GHOST_ROWS, find_stripes, shown_ghost
from ringpose.geometry.board import marker_corners, outline_m
from ringpose.geometry.least_squares import robust_std
from ringpose.geometry.rays import intersect, project, rays, undistorted_pixels
from ringpose.types.arrays import Array, Bool, Float64, UInt
from ringpose.types.board import Board, BoardPose, BoardView
from ringpose.types.calibration import StripeView
from ringpose.types.detection import Stripes, SubtractedGhost
from ringpose.types.image import Frame, Shot, board_image, dark_image
from ringpose.types.rig import Camera, LaserGhost

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
    """Width of the flat sheet beyond the board's outline."""
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
        for corner in marker_corners(board)[..., :2]:
            near = (position_m > corner[0] - marker_margin) & (position_m < corner[2] + marker_margin)
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


def stripe_view(
    shot: Shot, view: BoardView, board: Board, camera: Camera, lasers: int, surround_m: float = 0.0
) -> StripeView:
    """The stripes on the board in one shot, by laser where the frames identify it.

    Frames with one laser on label their stripe; those with several are used for lasers without such a frame.
    """
    surface = board_surface(shot, board, board_pose(view, camera), camera, surround_m)
    dark = dark_image(shot)
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
            remark = stripe_failure(frame.image, dark, surface, len(stripes), on, shot.saturation_dn)
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


MIN_GHOSTS = 3
"""Frames that must show a ghost for the rig to have it: fewer have no scatter. Twice as many are more than the stripes
of a laser in a usual calibration; half would take one board's reflection for it."""


def ghost_of_rig(ghosts: Sequence[SubtractedGhost]) -> LaserGhost | None:
    """The ghost of a laser by those of its frames, with the scatter between these; None if too few show the same one.

    A reflection of the board, or another stripe, has another offset in every view.
    """
    offset_px, ratio = np.array([[each.offset_px, each.ratio] for each in ghosts]).reshape(-1, 2).T
    same = np.abs(offset_px - np.median(offset_px)) < GHOST_ROWS if len(ghosts) else np.zeros(0, dtype=bool)
    if np.count_nonzero(same) < max(MIN_GHOSTS, len(ghosts) / 2):
        return None
    return LaserGhost(
        offset_px=float(offset_px[same].mean()),
        offset_sd_px=float(offset_px[same].std(ddof=1)),
        ratio=float(ratio[same].mean()),
        ratio_sd=float(ratio[same].std(ddof=1)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeLine:
    """Centres of one stripe on the board."""

    points_px: Float64[Array, "n xy=2"]
    light: float
    """Sum of the peak intensities of its centres."""
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
    along_rows = _lines(find_stripes(small, small_dark), surface, lasers + 1, shrinking, upright=False)
    dark_columns = None if small_dark is None else np.ascontiguousarray(small_dark.T)
    transposed = find_stripes(np.ascontiguousarray(small.T), dark_columns)
    upright = _lines(transposed, surface, lasers + 1, shrinking, upright=True)
    best = max(along_rows, upright, key=lambda lines: sum(line.light for line in lines[:lasers]))
    rivals = [line for line in best[lasers:] if line.light > RIVAL_SHARE * best[lasers - 1].light]
    return best[:lasers] + rivals


def _lines(stripes: Stripes, surface: BoardSurface, most: int, shrinking: int, upright: bool) -> list[StripeLine]:
    """The lines among the stripe centres of a frame that was reduced, and transposed for upright stripes."""
    centers_px = in_full_image(stripes.position_px, shrinking)
    points_px = centers_px[:, ::-1].copy() if upright else centers_px
    usable = surface.usable(points_px)
    points_px, peak = points_px[usable], stripes.peak_dn[usable]
    straight = undistorted_pixels(points_px, surface.camera) / shrinking
    straight = straight[:, ::-1].copy() if upright else straight
    lines: list[StripeLine] = []
    rng = np.random.default_rng(0)
    while len(lines) < most and len(points_px) >= MINIMUM_CENTERS:
        on_line = _on_brightest_line(straight, peak, rng)
        if on_line.sum() < MINIMUM_CENTERS:
            break
        clean = on_line & _clean(straight, on_line)
        lines.append(StripeLine(points_px=points_px[clean], light=float(peak[clean].sum()), upright=upright))
        rest = ~on_line
        points_px, peak, straight = points_px[rest], peak[rest], straight[rest]
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
    on: list[int],
    saturation_dn: int,
) -> str:
    """The reason, with measured values, why `stripes` is not the number of lasers that are `on`."""
    lasers = f"{len(on)} lasers are on" if len(on) > 1 else f"laser {on[0] + 1} is on"
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


def board_surface(shot: Shot, board: Board, pose: BoardPose, camera: Camera, surround_m: float = 0.0) -> BoardSurface:
    """The board's face in a shot; on a chessboard, the grey values determine which squares are used.

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
    first_is_used = first_is_dark == (dark_image(shot) is None)
    return BoardSurface(board=board, pose=pose, camera=camera, surround_m=surround_m, first_is_used=first_is_used)


def triangulated(points_px: Float64[Array, "n xy=2"], pose: BoardPose, camera: Camera) -> Float64[Array, "n xyz=3"]:
    """Intersections of distorted pixels' rays r with the board: P = t r, t = (n_b . c_b) / (n_b . r), camera frame."""
    normal = pose.rotation[:, 2]
    return intersect(rays(points_px, camera), normal, np.array(float(normal @ pose.translation_m)))
