"""A shot of the board -> its view with the stripes, labelled where the frames say which laser was on."""

import numpy as np

from ringpose.calibrate.board_image import dark_image
from ringpose.calibrate.board_pose import board_pose
from ringpose.calibrate.board_surface import BoardSurface, board_surface
from ringpose.calibrate.stripe_failures import stripe_failure
from ringpose.calibrate.stripe_lines import stripe_lines
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import StripeView
from ringpose.types.camera import Camera
from ringpose.types.frame import Frame, Shot

_NOTHING = np.empty((0, 2))


def stripe_view(
    shot: Shot, view: BoardView, board: Board, camera: Camera, lasers: int, surround_m: float = 0.0
) -> StripeView:
    """The stripes that each frame shows on the board's plane.

    Frames with one laser on say which it is. Those with several are used for what no such frame shows.
    """
    surface = board_surface(shot, board, board_pose(view, camera), camera, surround_m)
    dark = dark_image(shot)
    every = (1 << lasers) - 1
    labelled: dict[int, Float64[Array, "_ xy=2"]] = {}
    unlabelled: tuple[Float64[Array, "_ xy=2"], ...] = ()
    remarks: list[str] = []
    most = 0
    for frame in sorted(shot.frames, key=lambda frame: (frame.lasers & every).bit_count()):
        on = [laser for laser in range(lasers) if frame.lasers >> laser & 1]
        if not on or all(laser in labelled for laser in on):
            continue
        stripes, remark = _stripes(frame, dark, surface, on, shot.saturation_dn)
        most = max(most, len(stripes))
        if remark:
            remarks += [] if remarks and len(on) > 1 else [remark]
        elif len(on) == 1:
            labelled[on[0]] = stripes[0]
        elif len(on) == lasers and not unlabelled:
            unlabelled = stripes
    return StripeView(
        board=view,
        stripes_px=tuple(labelled.get(laser, _NOTHING) for laser in range(lasers)),
        unlabelled_px=unlabelled,
        remarks=tuple(remarks),
        lit=frozenset(laser for laser in range(lasers) if (shot.lasers >> laser & 1).any()),
        most_stripes=most,
    )


def _stripes(
    frame: Frame, dark: np.ndarray | None, surface: BoardSurface, on: list[int], saturation_dn: int
) -> tuple[tuple[Float64[Array, "_ xy=2"], ...], str]:
    """The frame's stripes in their order across the image, and why they are not as many as lasers are on."""
    lines = stripe_lines(frame.image, dark, surface, len(on))
    lines.sort(key=lambda line: line.position_px)
    stripes = tuple(line.points_px for line in lines)
    if len(lines) != len(on):
        return stripes, stripe_failure(frame.image, dark, surface, len(lines), on, saturation_dn)
    return stripes, ""
