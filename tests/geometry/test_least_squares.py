import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.geometry.least_squares import damped_solution, inverse_condition

SEEDS = st.integers(0, 2**32 - 1)


def system(seed, rows=5, columns=3, batch=4):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(batch, rows, columns)), rng.normal(size=(batch, rows))


@given(seed=SEEDS)
def test_without_damping_it_is_least_squares(seed):
    matrix, target = system(seed)

    solution = damped_solution(matrix, target, np.zeros(4))

    expected = [np.linalg.lstsq(a, b, rcond=None)[0] for a, b in zip(matrix, target, strict=True)]
    np.testing.assert_allclose(solution, expected, rtol=1e-7, atol=1e-9)


@given(seed=SEEDS, damping=st.floats(1e-3, 10.0))
def test_damped_it_solves_the_damped_normal_equations(seed, damping):
    matrix, target = system(seed)

    solution = damped_solution(matrix, target, np.full(4, damping))

    largest = np.sqrt(np.linalg.eigvalsh(matrix.swapaxes(1, 2) @ matrix)[:, -1])
    left = matrix.swapaxes(1, 2) @ matrix + (damping * largest[:, None, None]) ** 2 * np.eye(3)
    right = np.einsum("brc,br->bc", matrix, target)
    np.testing.assert_allclose(np.einsum("bij,bj->bi", left, solution), right, rtol=1e-8, atol=1e-9)


@given(seed=SEEDS, damping=st.floats(0.0, 10.0), more=st.floats(0.0, 10.0))
def test_more_damping_never_lengthens_the_solution(seed, damping, more):
    matrix, target = system(seed)

    less, greater = (damped_solution(matrix, target, np.full(4, d)) for d in (damping, damping + more))

    assert (np.linalg.norm(greater, axis=-1) <= np.linalg.norm(less, axis=-1) * (1 + 1e-12)).all()


def test_a_direction_without_equations_is_left_alone():
    solution = damped_solution(np.array([[[2.0, 0.0], [0.0, 0.0]]]), np.array([[6.0, 1.0]]), np.zeros(1))

    np.testing.assert_array_equal(solution, [[3.0, 0.0]])


@given(seed=SEEDS, factors=st.lists(st.floats(1e-6, 1e6), min_size=5, max_size=5))
def test_the_units_of_the_rows_do_not_touch_the_condition(seed, factors):
    matrix, _ = system(seed)

    scaled = inverse_condition(matrix * np.array(factors)[:, None])

    np.testing.assert_allclose(scaled, inverse_condition(matrix), rtol=1e-9, atol=1e-12)


@given(angle=st.floats(1e-6, np.pi / 4))
def test_two_rows_at_an_angle_have_the_tangent_of_its_half(angle):
    rows = np.array([[[1.0, 0.0], [np.cos(angle), np.sin(angle)]]])

    assert inverse_condition(rows)[0] == pytest.approx(np.tan(angle / 2), rel=1e-6)


@pytest.mark.parametrize("matrix", [np.zeros((1, 3, 2)), np.array([[[1.0, 2.0], [2.0, 4.0], [0.0, 0.0]]])])
def test_singular_equations_have_no_condition(matrix):
    assert inverse_condition(matrix)[0] == pytest.approx(0.0, abs=1e-15)
