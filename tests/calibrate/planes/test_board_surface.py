"""Regions of a board in which stripes are used."""

import numpy as np
import pytest
from known_views import TRUE_CAMERA
from recorded_shots import make_shot

from ringpose.calibrate.planes.stripes.extraction import (
    PRINT_MARGIN_PX,
    BoardSurface,
    board_surface,
    triangulated,
    with_sheet_seen,
)
from ringpose.geometry.rays import project
from ringpose.types.board import Board, BoardPose
from ringpose.types.image import Shot


@pytest.fixture
def surface() -> BoardSurface:
    """Half a metre away and facing the camera: 0.28 mm a pixel."""
    pose = BoardPose(name="b", rotation=np.eye(3), translation_m=np.array([-0.1, -0.1, 0.5]), residual_rms_px=0.0)
    board = Board(kind="chessboard", squares_x=6, squares_y=5, square_m=0.03)
    return BoardSurface(board=board, pose=pose, camera=TRUE_CAMERA)


def usable_at(surface, project_px, place_m) -> bool:
    point = np.array([[*place_m, 0.0]]) + surface.pose.translation_m
    return bool(surface.usable(project_px(point))[0])


@pytest.mark.parametrize(
    ("place_m", "usable"),
    [
        ((0.045, 0.015), True),  # middle of a light square
        ((0.015, 0.015), False),  # of the dark one in the corner
        ((0.075, 0.045), True),
        ((0.045, 0.045), False),
        ((0.031, 0.015), False),  # 1 mm beside an edge
        ((0.045, 0.029), False),
        ((0.2, 0.015), False),  # beside the board
    ],
)
def test_only_light_squares_away_from_their_edges_are_used(place_m, usable, surface):
    assert usable_at(surface, lambda point: project(point, TRUE_CAMERA), place_m) is usable


@pytest.mark.parametrize("row_px", [300, 301])
def test_the_sheet_ends_a_margin_before_its_edge_in_the_image(row_px, surface):
    image = seen(surface, [1], True).images[0]
    image[:row_px] = 20

    sheet = with_sheet_seen(surface, image).sheet

    first_px = np.flatnonzero(sheet.any(axis=1))[0] * len(image) // len(sheet)
    assert PRINT_MARGIN_PX <= first_px - row_px < PRINT_MARGIN_PX + 4


def seen(surface, lasers, first_is_dark) -> Shot:
    """A shot of the board, square by square."""
    y, x = np.mgrid[0:1200:4, 0:1600:4]
    place = (
        triangulated(np.stack([x, y], axis=-1).reshape(-1, 2).astype(float), surface.pose, surface.camera)
        - surface.pose.translation_m
    )
    parity = np.floor(place[:, :2] / 0.03).astype(int).sum(axis=1) % 2
    image = np.kron(np.where(parity == first_is_dark, 200, 60).reshape(x.shape), np.ones((4, 4))).astype(np.uint8)
    return make_shot(np.stack([image] * len(lasers)), lasers)


@pytest.mark.parametrize("first_is_dark", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("lasers", "light"), [([0, 1], True), ([1], False)])
def test_light_squares_are_used_with_a_dark_frame_and_dark_squares_without(lasers, light, first_is_dark, surface):
    found = board_surface(seen(surface, lasers, first_is_dark), surface.board, surface.pose, surface.camera)

    place_m = {True: (0.045, 0.015), False: (0.015, 0.015)}[light == first_is_dark]
    assert usable_at(found, lambda point: project(point, surface.camera), place_m)
