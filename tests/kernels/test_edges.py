"""The kernels that follow a ring's edges, against OpenCV's projection, SciPy's interpolation and true arcs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import map_coordinates, uniform_filter1d

from ringpose.detect.edge_search import PlaceParams, edge_places, edge_profiles
from ringpose.geometry.ring import RingArcs, edge_points
from ringpose.kernels.lines import Lens

LENS = Lens(1778.0, 1781.0, 790.0, 611.0, -0.12, 0.05, 4e-4, -3e-4, 0.01)
RATIONAL = LENS._replace(k4=0.02, k5=-0.01, k6=0.004)
PLACES = PlaceParams(image_width=1600, image_height=1200, spacing_px=12.0, sigma_px=1.3)

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


def covariance(sigma: float) -> np.ndarray:
    half = np.random.default_rng(1).normal(size=(7, 7))
    return sigma**2 * half @ half.T


def imaged(points, lens):
    """OpenCV's pixels of points in the camera's frame."""
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    if not len(points):
        return np.empty((0, 2))
    return cv2.projectPoints(np.ascontiguousarray(points), np.zeros(3), np.zeros(3), matrix, np.array(lens[4:12]))[
        0
    ].reshape(-1, 2)


@pytest.mark.parametrize("lens", [LENS, RATIONAL])
@given(step=steps_of_state)
def test_places_lie_on_the_edges_where_opencv_sees_them(lens, step):
    ring = arcs(step)

    found = edge_places(ring, covariance(0.0), lens, PLACES)

    point, outward, side, place, normal, metres = np.split(found[:, :12], [3, 6, 7, 9, 11], axis=1)
    center = ring.origin + ring.axes[0] / ring.curvature
    radius = 1 / ring.curvature + side[:, 0] * ring.half_band_m
    np.testing.assert_allclose((point - ring.origin) @ ring.axes[2], 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(point - center, axis=1), np.abs(radius), atol=1e-9)
    np.testing.assert_allclose(outward * radius[:, None] * side, point - center, atol=1e-9)
    assert ((place > PLACES.margin_px) & (place < np.array([1600, 1200]) - 1 - PLACES.margin_px)).all()
    np.testing.assert_allclose(place, imaged(point, lens), atol=1e-6)
    off_face = (imaged(point + 1e-4 * outward, lens) - place) / 1e-4
    np.testing.assert_allclose(np.sum(normal * off_face, axis=1) * metres[:, 0], 1.0, rtol=1e-3)
    along = imaged(point + 1e-4 * np.cross(ring.axes[2], outward), lens) - place
    np.testing.assert_allclose(np.sum(normal * along, axis=1), 0.0, atol=1e-4)


def test_places_begin_at_the_origin_and_are_as_far_apart_as_asked_for():
    found = edge_places(arcs(), covariance(0.0), LENS, PLACES)

    for side in (1.0, -1.0):
        own = found[found[:, 6] == side]
        np.testing.assert_array_equal(np.diff(own[:, 12]), 1.0)
        at_origin = own[own[:, 12] == 0][0]
        np.testing.assert_allclose(at_origin[:3], arcs().origin - side * 0.015 * arcs().axes[0], atol=1e-12)
        steps = np.linalg.norm(np.diff(own[:, 7:9], axis=0), axis=1)
        assert steps == pytest.approx(12.0, rel=0.1)


@pytest.mark.parametrize("parameter", range(7))
def test_there_are_no_places_where_the_edge_is_predicted_worse_than_asked_for(parameter):
    known = np.zeros((7, 7))
    known[parameter, parameter] = (0.003, 0.003, 0.02, 3e-4, 0.004, 0.1, 3e-4)[parameter] ** 2

    found = edge_places(arcs(), known, LENS, PLACES)

    everywhere = edge_places(arcs(), covariance(0.0), LENS, PLACES)
    step = np.zeros(7)
    step[parameter] = 1e-3 * np.sqrt(known[parameter, parameter])
    angle = everywhere[:, 12] * PLACES.spacing_px * arcs().origin[2] / LENS.fx
    there, _ = edge_points(arcs().retract(step), angle, everywhere[:, 6])
    beyond = np.sum((imaged(there, LENS) - everywhere[:, 7:9]) * everywhere[:, 9:11], axis=1)
    assert abs(len(found) - np.sum(np.abs(beyond) * 1e3 < PLACES.sigma_px)) <= 4


def test_a_straight_ring_has_places_on_both_edges():
    straight = replace(arcs(), curvature=0.0)

    found = edge_places(straight, covariance(0.0), LENS, PLACES)

    across = (found[:, :3] - straight.origin) @ straight.axes[0]
    np.testing.assert_allclose(across, -0.015 * found[:, 6], atol=1e-12)
    assert set(found[:, 6]) == {1.0, -1.0}


def test_so_many_places_at_most_are_to_both_sides():
    found = edge_places(arcs(), covariance(0.0), LENS, PLACES._replace(farthest=3.0))

    assert np.abs(found[:, 12]).max() == 3


def test_a_ring_behind_the_camera_has_no_places():
    behind = replace(arcs(), origin=np.array([0.0, 0.0, -0.5]))

    assert len(edge_places(behind, covariance(0.0), LENS, PLACES)) == 0


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
    variance = uniform_filter1d(np.var(surface, axis=1, ddof=1), 9) + 0.3**2 / 4
    np.testing.assert_allclose(noise_dn[inner], np.sqrt(variance)[inner], rtol=1e-9)


@pytest.mark.parametrize("normal", [np.nan, np.inf, 1e9])
@pytest.mark.parametrize("place", [np.nan, -np.inf, 20.0])
def test_places_and_normals_that_are_none_read_nothing_beyond_the_image(place, normal):
    image = np.full((40, 40), 7, np.uint8)

    value, saturated, _ = edge_profiles(image, np.full((2, 2), place), np.full((2, 2), normal), 2, 255)

    assert not value.any()
    assert not saturated.any()
