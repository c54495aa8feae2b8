import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.geometry.circles import arc_crossings, arc_equations, nearest_crossing

ANGLE = st.floats(-3.0, 3.0)


def on_circle(angle):
    return np.array([np.cos(angle), np.sin(angle), 0.0])


@given(first=ANGLE, apart=st.floats(0.1, 3.0), along=st.one_of(st.floats(-0.9, -0.01), st.floats(0.01, 0.9)))
def test_a_chord_is_crossed_at_its_nearer_end(first, apart, along):
    ends = np.stack([on_circle(first), on_circle(first + apart)])
    chord = ends[1] - ends[0]
    start = ends.mean(axis=0) + along / 2 * chord
    near = ends[int(along > 0)]

    crossing = nearest_crossing(start[None], chord[None] / np.linalg.norm(chord), np.zeros(3), np.ones(1))

    np.testing.assert_allclose(crossing[0], near, rtol=0, atol=1e-9)


@given(first=ANGLE, apart=st.floats(0.1, 3.0), beyond=st.floats(0.01, 5.0))
def test_from_outside_the_circle_the_nearer_end_is_the_one_in_front(first, apart, beyond):
    ends = np.stack([on_circle(first), on_circle(first + apart)])
    direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    start = ends[0] - beyond * direction

    crossing = nearest_crossing(start[None], direction[None], np.zeros(3), np.ones(1))

    np.testing.assert_allclose(crossing[0], ends[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("start", "direction", "place"),
    [
        ([-5.0, 2.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]),
        ([3.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
        ([3.0, 0.0, 0.6], [-1.0, 0.0, 0.0], [0.8, 0.0, 0.6]),
    ],
    ids=["passing by: nearest to the center", "through the center", "beside the plane: on the sphere"],
)
def test_a_line_is_crossed_where_it_meets_the_sphere_or_comes_nearest_to_its_center(start, direction, place):
    crossing = nearest_crossing(np.array([start]), np.array([direction]), np.zeros(3), np.ones(1))

    np.testing.assert_allclose(crossing, [place], atol=1e-12)


ARC = np.array([0, 1, 0, 1, 0, 1])


def two_arcs(radius, band, heights):
    """Points at these heights of two arcs about one centre to the right, the second one `band` farther from it."""
    radii = radius + band * np.array([0.0, 1.0])
    return np.stack([[radius - np.sqrt(r * r - h * h), h] for h in heights for r in radii])


@given(radius=st.floats(0.3, 5.0), band=st.floats(0.01, 0.05), spacing=st.floats(0.01, 0.2))
def test_arcs_cross_the_radius_through_the_mean_at_their_radii(radius, band, spacing):
    points = two_arcs(radius, band, [-spacing, 0.1 * spacing, spacing])
    center, mean = np.array([radius, 0.0]), points.mean(axis=0)

    crossings = arc_crossings(arc_equations(points, ARC))

    # positive x is towards the centre
    expected = np.linalg.norm(mean - center) - radius - np.array([0.0, band])
    np.testing.assert_allclose(crossings, expected, rtol=0, atol=1e-9)


@given(lean=st.floats(-0.5, 0.5))
def test_straight_arcs_have_no_curvature(lean):
    points = np.array([[x + lean * y, y] for y in (-0.1, 0.0, 0.1) for x in (0.0, 0.03)])

    assert float(arc_equations(points, ARC).bend[0]) == pytest.approx(0.0, abs=1e-9)
