"""That shapes in signatures are held against what is passed, in the first calls of each test."""

import numpy as np
import pytest
import shape_checks
from jaxtyping import TypeCheckError

from ringpose.geometry.rotations import tilted
from ringpose.types.rig import LaserPlanes, ParameterCovariance

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(autouse=True)
def _checked(pytestconfig: pytest.Config) -> None:
    if not pytestconfig.getoption("jaxtyping_packages"):
        pytest.skip("shapes are not checked in this run (make test-baseline-cpu checks them)")


def called_until_believed() -> None:
    for _ in range(shape_checks.CALLS):
        tilted(UP, np.zeros(2))


def test_a_wrong_shape_is_an_error():
    with pytest.raises(TypeCheckError):
        tilted(UP, np.zeros(3))


def test_a_wrong_element_type_is_an_error():
    with pytest.raises(TypeCheckError):
        tilted(UP.astype(np.float32), np.zeros(2))


def test_a_records_wrong_shape_is_an_error():
    with pytest.raises(TypeCheckError):
        ParameterCovariance(parameters=("fx",), data=np.zeros(1))


def test_axes_of_one_name_are_of_one_length():
    with pytest.raises(TypeCheckError):
        LaserPlanes(names=("a",), normal=UP[None], distance_m=np.zeros(2), projector_m=UP[None])


def test_after_its_first_calls_a_function_is_believed():
    called_until_believed()

    with pytest.raises(ValueError, match="mismatch in its core dimension"):
        tilted(UP, np.zeros(3))


def test_the_next_test_checks_a_believed_function_again():
    called_until_believed()
    shape_checks.begin()

    with pytest.raises(TypeCheckError):
        tilted(UP, np.zeros(3))
