"""The edges as arcs: on the circles they stand for, with derivatives that are differences."""

import numpy as np
import pytest

from ringpose.geometry.ring_arcs import STATE, RingArcs, arc_points, moved, off_face_m

SIDE = np.where(np.arange(12) % 2, 1.0, -1.0)
ALONG_M = np.linspace(-0.3, 0.3, 12)


def arcs(curvature: float = 1.7) -> RingArcs:
    normal = np.array([0.2, -0.1, -0.97])
    normal /= np.linalg.norm(normal)
    across = np.cross([0.0, 1.0, 0.0], normal)
    across /= np.linalg.norm(across)
    return RingArcs(
        origin=np.array([0.05, 0.02, 0.5]),
        axes=np.stack([across, np.cross(normal, across), normal]),
        curvature=curvature,
        half_band_m=0.015,
    )


@pytest.mark.parametrize("curvature", [1.7, -0.8])
def test_points_lie_on_two_circles_about_one_centre(curvature):
    ring = arcs(curvature)
    center = ring.origin + ring.axes[0] / curvature

    points, _ = arc_points(ring, ALONG_M, SIDE)

    radius = np.linalg.norm(points - center, axis=-1)
    np.testing.assert_allclose(radius, 1 / abs(curvature) - np.sign(curvature) * SIDE * 0.015, rtol=1e-12)
    np.testing.assert_allclose((points - ring.origin) @ ring.axes[2], 0.0, atol=1e-15)


def test_straight_arcs_are_two_parallel_lines():
    ring = arcs(0.0)

    points, outward = arc_points(ring, ALONG_M, SIDE)

    np.testing.assert_allclose((points - ring.origin) @ ring.axes[0], SIDE * 0.015, atol=1e-15)
    np.testing.assert_allclose(outward, SIDE[:, None] * ring.axes[0], atol=1e-15)


@pytest.mark.parametrize("curvature", [1.7, 0.0, -0.8])
def test_distance_off_the_face_is_the_step_made_outward(curvature):
    ring = arcs(curvature)
    points, outward = arc_points(ring, ALONG_M, SIDE)
    step_m = np.linspace(-0.01, 0.02, 12)

    beyond_m, _ = off_face_m(ring, (points + step_m[:, None] * outward) * 3.0, SIDE)

    np.testing.assert_allclose(beyond_m, step_m, atol=1e-14)


@pytest.mark.parametrize("number", range(7), ids=STATE)
@pytest.mark.parametrize("curvature", [1.7, 0.0])
def test_derivatives_are_central_differences(rng, number, curvature):
    ring = arcs(curvature)
    rays = arc_points(ring, ALONG_M, SIDE)[0] + 0.002 * rng.normal(size=(12, 3))
    step = np.zeros(7)
    step[number] = 1e-6

    _, derivatives = off_face_m(ring, rays, SIDE)

    ahead, behind = (off_face_m(moved(ring, sign * step), rays, SIDE)[0] for sign in (1, -1))
    np.testing.assert_allclose(derivatives[:, number], (ahead - behind) / 2e-6, atol=1e-8)


def test_axes_stay_at_right_angles_after_large_steps():
    after = moved(arcs(), np.array([0.5, -0.4, 0.01, 0.02, 0.6, 0.1, 0.001])).axes

    np.testing.assert_allclose(after @ after.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(after) > 0
