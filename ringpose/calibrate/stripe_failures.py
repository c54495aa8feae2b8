"""Why a frame does not show as many stripes on the board as lasers are on."""

import cv2
import numpy as np

from ringpose.calibrate.board_points import outline_m
from ringpose.calibrate.board_surface import BoardSurface
from ringpose.calibrate.normal_spread import normal_spread
from ringpose.geometry.rays import project
from ringpose.types.arrays import Array, Bool, Float64, UInt

FAINT_SIGMAS = 8.0
"""A board on which nothing stands out by so many standard deviations of its noise shows no laser at all."""

FULL_SHARE = 0.02
"""Of a board's pixels; more of them full are no stripe's, which covers 1 % of it."""


WIDEST_PX = 25.0
"""Full width at half its height that a stripe has at most: a quarter of the size is the least that is searched."""

_SMOOTHING_PX = 2.0


def stripe_failure(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    surface: BoardSurface,
    found: int,
    on: list[int],
    saturation_dn: int,
) -> str:
    """The reason in words, with what was measured; `found` stripes where the lasers `on` are on."""
    lasers = f"{len(on)} lasers are on" if len(on) > 1 else f"laser {on[0] + 1} is on"
    if found > len(on):
        return f"more stripes on the board where {lasers}: reflections, or another light?"
    said = f"{found} stripe{'s' * (found != 1)} on the board where {lasers}"
    board = _on_board(surface, image.shape)
    if not board.any():
        return f"{said}: the board is out of the image"
    full = float(np.mean(image[board] >= saturation_dn))
    if full > FULL_SHARE:
        return f"{said}: {100 * full:.0f} % of the board is saturated"
    lit = image[board].astype(np.float64) - (0.0 if dark is None else dark[board])
    background = float(np.median(lit))
    noise = max(normal_spread(lit - background), 1.0)
    brightest = float(np.percentile(lit, 99.8)) - background
    width_px = 0.0 if dark is None else _width_px(image, dark, board, background + brightest / 2)
    if brightest > FAINT_SIGMAS and width_px > WIDEST_PX:
        return f"{said}: blurred, or not the lasers' light: {width_px:.0f} px wide at half its height"
    if brightest < FAINT_SIGMAS * noise:
        most = f"nothing stands out by more than {brightest:.0f} of {saturation_dn} grey values"
        return f"{said}: too dark, or beside the board: {most}"
    return f"{said}: missing or cut off, though something is {brightest:.0f} grey values bright"


def _width_px(
    image: UInt[Array, "row column"], dark: UInt[Array, "row column"], board: Bool[Array, "row column"], half_dn: float
) -> float:
    """Width, where it is largest, of what the lasers make brighter than this."""
    lit = cv2.GaussianBlur(image.astype(np.float32) - dark, (0, 0), _SMOOTHING_PX)
    bright = ((lit > half_dn) & board).astype(np.uint8)
    return 2.0 * float(cv2.distanceTransform(bright, cv2.DIST_L2, 5).max())


def _on_board(surface: BoardSurface, shape: tuple[int, ...]) -> Bool[Array, "row column"]:
    """The pixels of the board's printed face."""
    width, height = outline_m(surface.board)
    corners = np.array([[0.0, 0.0, 0.0], [width, 0.0, 0.0], [width, height, 0.0], [0.0, height, 0.0]])
    pixels: Float64[Array, "4 2"] = project(
        corners @ surface.pose.rotation.T + surface.pose.translation_m, surface.camera
    )
    mask = np.zeros(shape, dtype=np.uint8)
    if np.isfinite(pixels).all():
        cv2.fillConvexPoly(mask, np.rint(pixels).astype(np.int32), 1)
    return mask.astype(bool)
