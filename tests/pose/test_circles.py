import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.pose.closed_form import nearest_crossing

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
