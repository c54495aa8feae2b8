"""The kernels that follow a ring's edges, against OpenCV's projection, SciPy's interpolation and true arcs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import map_coordinates, uniform_filter1d

from ringpose.detect.edge_search import EdgeTrace, PlaceParams, edge_profiles, edge_trace
from ringpose.geometry.ring import RingArcs, edge_points
from ringpose.types.rig import Camera

LENS = Camera(
    camera_name="test",
    image_width=1600,
    image_height=1200,
    camera_matrix=np.array([[1778.0, 0, 790.0], [0, 1781.0, 611.0], [0, 0, 1]]),
    distortion_model="plumb_bob",
    distortion_coefficients=np.array([-0.12, 0.05, 4e-4, -3e-4, 0.01]),
)
RATIONAL = replace(
    LENS,
    distortion_model="rational_polynomial",
    distortion_coefficients=np.append(LENS.distortion_coefficients, [0.02, -0.01, 0.004]),
)
SPACING_PX, SIGMA_PX = 12.0, 1.3
MARGIN_PX = PlaceParams(image_width=1600, image_height=1200).margin_px

steps_of_state = arrays(np.float64, 7, elements=st.floats(-1, 1)).map(
    lambda part: part * [0.4, 0.4, 0.2, 0.1, 0.7, 3.0, 0.01]
)


def arcs(step=(0.0,) * 7) -> RingArcs:
    """A ring half a metre before the camera, moved by a step of its state."""
    facing = RingArcs(
        origin=np.array([0.02, 0.05, 0.5]),
        axes=np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
        curvature=1.7,
        half_band_m=0.015,
    )
    return facing.retract(np.array(step))


def imaged(points, lens):
    """OpenCV's pixels of points in the camera's frame."""
    if not len(points):
        return np.empty((0, 2))
    points, still = np.ascontiguousarray(points), np.zeros(3)
    return cv2.projectPoints(points, still, still, lens.camera_matrix, lens.distortion_coefficients)[0].reshape(-1, 2)


def trace(ring: RingArcs, covariance: np.ndarray | None = None, lens: Camera = LENS) -> EdgeTrace:
    return edge_trace(ring, covariance, lens, SPACING_PX, SIGMA_PX)


@pytest.mark.parametrize("lens", [LENS, RATIONAL])
@given(step=steps_of_state)
def test_places_lie_on_the_edges_where_opencv_sees_them(lens, step):
    ring = arcs(step)

    found = trace(ring, lens=lens)

    point, place, metres = found.point, found.position_px, found.metres_per_px
    center = ring.origin + ring.axes[0] / ring.curvature
    radius = 1 / ring.curvature + found.edge_sign * ring.half_band_m
    np.testing.assert_allclose((point - ring.origin) @ ring.axes[2], 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(point - center, axis=1), np.abs(radius), atol=1e-9)
    np.testing.assert_allclose(found.outward * (radius * found.edge_sign)[:, None], point - center, atol=1e-9)
    assert ((place > MARGIN_PX) & (place < np.array([1600, 1200]) - 1 - MARGIN_PX)).all()
    np.testing.assert_allclose(place, imaged(point, lens), atol=1e-6)
    off_face = (imaged(point + 1e-4 * found.outward, lens) - place) / 1e-4
    np.testing.assert_allclose(np.sum(found.normal * off_face, axis=1) * metres, 1.0, rtol=1e-3)
    along = imaged(point + 1e-4 * np.cross(ring.axes[2], found.outward), lens) - place
    np.testing.assert_allclose(np.sum(found.normal * along, axis=1), 0.0, atol=1e-4)


def test_places_begin_at_the_origin_and_are_as_far_apart_as_asked_for():
    found = trace(arcs())

    for sign in (1.0, -1.0):
        own = found.selected(found.edge_sign == sign)
        np.testing.assert_array_equal(np.diff(own.number), 1.0)
        at_origin = own.point[own.number == 0][0]
        np.testing.assert_allclose(at_origin, arcs().origin - sign * 0.015 * arcs().axes[0], atol=1e-12)
        steps = np.linalg.norm(np.diff(own.position_px, axis=0), axis=1)
        assert steps == pytest.approx(SPACING_PX, rel=0.1)


@pytest.mark.parametrize("parameter", range(7))
def test_there_are_no_places_where_the_edge_is_predicted_worse_than_asked_for(parameter):
    known = np.zeros((7, 7))
    known[parameter, parameter] = (0.003, 0.003, 0.02, 3e-4, 0.004, 0.1, 3e-4)[parameter] ** 2

    found = trace(arcs(), known)

    everywhere = trace(arcs())
    step = np.zeros(7)
    step[parameter] = 1e-3 * np.sqrt(known[parameter, parameter])
    along_m = everywhere.number * SPACING_PX * arcs().origin[2] / LENS.camera_matrix[0, 0]
    there, _ = edge_points(arcs().retract(step), along_m, everywhere.edge_sign)
    beyond = np.sum((imaged(there, LENS) - everywhere.position_px) * everywhere.normal, axis=1)
    assert abs(len(found.number) - np.sum(np.abs(beyond) * 1e3 < SIGMA_PX)) <= 4


def test_a_straight_ring_has_places_on_both_edges():
    straight = replace(arcs(), curvature=0.0)

    found = trace(straight)

    across = (found.point - straight.origin) @ straight.axes[0]
    np.testing.assert_allclose(across, -0.015 * found.edge_sign, atol=1e-12)
    assert set(found.edge_sign) == {1.0, -1.0}


def test_a_ring_behind_the_camera_has_no_places():
    behind = replace(arcs(), origin=np.array([0.0, 0.0, -0.5]))

    assert len(trace(behind).number) == 0


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_profiles_are_means_of_scipys_bilinear_interpolation(dtype, rng):
    image = rng.integers(0, 250, (37, 41)).astype(dtype)
    image[10:14, 20:24] = 255
    place, angle = rng.uniform(-3, 44, (30, 2)), rng.uniform(0, 2 * np.pi, 30)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    value, saturated, noise_dn = edge_profiles(image, place, normal, 2, 255)

    across, along = np.arange(-7.0, 6.0), np.arange(4) - 1.5
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    at = (
        place[:, None, None] + across[:, None] * normal[:, None, None] + (along[:, None] * tangent[:, None])[:, :, None]
    )
    sampled = map_coordinates(image.astype(float), np.moveaxis(at[..., ::-1], -1, 0), order=1, mode="nearest")
    mean = sampled.mean(axis=1)
    surface = mean[:, :5]
    np.testing.assert_allclose(
        value * noise_dn[:, None], mean - surface.mean(axis=1, keepdims=True), rtol=1e-9, atol=1e-9
    )
    np.testing.assert_array_equal(saturated, sampled.max(axis=1) >= 254.5)
    inner = slice(4, -4)
    variance = uniform_filter1d(np.var(surface, axis=1, ddof=1), 9) + 1 / 12 / 4  # of a uniform distribution
    np.testing.assert_allclose(noise_dn[inner], np.sqrt(variance)[inner], rtol=1e-9)


@pytest.mark.parametrize("normal", [np.nan, np.inf, 1e9])
@pytest.mark.parametrize("place", [np.nan, -np.inf, 20.0])
def test_places_and_normals_that_are_none_read_nothing_beyond_the_image(place, normal):
    image = np.full((40, 40), 7, np.uint8)

    value, saturated, _ = edge_profiles(image, np.full((2, 2), place), np.full((2, 2), normal), 2, 255)

    assert not value.any()
    assert not saturated.any()
