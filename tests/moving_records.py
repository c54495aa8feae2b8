"""Fixtures of records of a moving ring, which the conftest.py of a folder imports."""

import numpy as np
import pytest
from moving_rings import Motion, Shots, drawn_motion, stream

from ringpose.types.pose import PoseLine


@pytest.fixture(scope="module")
def moving() -> Motion:
    """A ring in slow motion."""
    return drawn_motion(np.random.default_rng(18))


@pytest.fixture(scope="module")
def records(moving) -> list[PoseLine]:
    """Two seconds of it, six shots a second."""
    return stream(moving, 2.0, Shots(), np.random.default_rng(19))
