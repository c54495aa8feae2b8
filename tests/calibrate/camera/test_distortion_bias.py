"""Bias of corners and circle centres by distortion, against formulas."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from known_views import TRUE_CAMERA

from ringpose.calibrate.boards.corner_errors import endpoint_correlation, without_distortion_bias
from ringpose.calibrate.boards.patterns.circles import seen_offsets
from ringpose.types.board import BoardView

CORNERS_M = np.array([[0.0, 0, 0], [0.08, 0, 0], [0.08, 0.08, 0], [0, 0.08, 0]])
PLACES_M = np.array([[0.06, 0.02, 0.5], [0.01, 0.09, 0.5], [-0.19, -0.15, 0.5]])
LEFT_OUT = 0.05


@pytest.fixture
def bent_camera():
    return replace(TRUE_CAMERA, distortion_coefficients=np.array([-0.2, 0.3, 0.0, 0.0, 0.0]))


def bent_px(points_m: np.ndarray, camera) -> np.ndarray:
    flat = points_m[..., :2] / points_m[..., 2:]
    squared = np.sum(flat**2, axis=-1, keepdims=True)
    k1, k2 = camera.distortion_coefficients[:2]
    matrix = camera.camera_matrix
    return flat * (1 + k1 * squared + k2 * squared**2) * [matrix[0, 0], matrix[1, 1]] + matrix[:2, 2]


def drawn_corner(marker_m: np.ndarray, corner: int, camera) -> np.ndarray:
    """Intersection of parabolas through equally spaced pixels of the inner part of both sides."""
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    corner_m, beside_m, below_m = marker_m[[corner, corner ^ 1, 3 - corner]]
    parabolas = []
    for other_m, along in ((beside_m, 0), (below_m, 1)):  # as functions of x and of y
        side = bent_px(corner_m + share * (other_m - corner_m), camera)
        side = side[np.argsort(side[:, along])]
        ends = side[[0, -1], along]
        places = ends[0] + np.linspace(LEFT_OUT, 1 - LEFT_OUT, 400) * (ends[1] - ends[0])
        across = np.interp(places, side[:, along], side[:, 1 - along])
        parabolas.append(np.polynomial.Polynomial.fit(places, across, 2))
    flat, steep = parabolas
    x, y = bent_px(corner_m, camera)
    for _ in range(20):
        x, y = steep(y), flat(x)
    return np.array([x, y])


@pytest.fixture(params=[0.0, 0.5], ids=["facing", "tilted"])
def drawn_markers(request, bent_camera):
    """Three markers on a board at a tilt, their corners as parabolas give them, and where they are."""
    points_m = (PLACES_M[:, None] + CORNERS_M).reshape(-1, 3) - [0, 0, 0.5]
    turn = cv2.Rodrigues(np.array([request.param, -0.8 * request.param, 0.0]))[0]
    places = (points_m @ turn.T + [0, 0, 0.5]).reshape(-1, 4, 3)
    found = [drawn_corner(marker, corner, bent_camera) for marker in places for corner in range(4)]
    view = BoardView(
        name="v",
        ids=np.arange(12),
        points_board_m=points_m,
        points_px=np.array(found),
        end_correlation=endpoint_correlation(LEFT_OUT),
    )
    return view, bent_px(places.reshape(-1, 3), bent_camera)


def test_marker_corners_are_corrected_for_curved_sides(drawn_markers, bent_camera):
    view, true_px = drawn_markers

    moved = without_distortion_bias(view, bent_camera)

    before, after = (np.linalg.norm(one.points_px - true_px, axis=1).max() for one in (view, moved))
    assert before > 0.03
    assert after < 0.1 * before


@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_circle_centres_are_corrected_for_distortion(tilt, bent_camera):
    """Centres as they are found: corrected for perspective by the homography of the distorted image."""
    columns, rows = np.meshgrid(np.arange(-3, 4), np.arange(-2, 3))
    centers_m = 0.05 * np.stack([columns.ravel(), rows.ravel(), 0 * rows.ravel()], axis=1).astype(np.float64)
    radius_m = 0.015 * np.sqrt((np.arange(40) + 0.5) / 40)[:, None]
    angle = 2 * np.pi * np.arange(60) / 60
    disc = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), 0 * radius_m + 0 * angle], -1).reshape(-1, 3)
    turn, apart, step = cv2.Rodrigues(np.array([tilt, -0.5 * tilt, 0.0]))[0], np.array([0.0, 0.0, 0.5]), 1e-6
    inner, *moved = [
        bent_px((centers_m[:, None] + disc + step * axis) @ turn.T + apart, bent_camera)
        for axis in (np.zeros(3), np.eye(3)[0], np.eye(3)[1])
    ]
    one, other = ((place - inner) / step for place in moved)
    area = np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])[..., None]
    ellipses_px = (inner * area).sum(axis=1) / area.sum(axis=1)
    view = BoardView(
        name="v",
        ids=np.arange(len(centers_m)),
        points_board_m=centers_m,
        points_px=ellipses_px - seen_offsets(centers_m, ellipses_px, 0.015),
        circle_radius_m=0.015,
    )

    found = without_distortion_bias(view, bent_camera)

    true_px = bent_px(centers_m @ turn.T + apart, bent_camera)
    before, after = (np.linalg.norm(one.points_px - true_px, axis=1).max() for one in (view, found))
    assert before > 0.1
    assert after < 0.05 * before


def test_corners_of_a_chessboard_need_no_correction(drawn_markers, bent_camera):
    view = replace(drawn_markers[0], end_correlation=0.0)

    assert without_distortion_bias(view, bent_camera) is view
