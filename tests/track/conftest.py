"""Streams of records of moving rings."""

import numpy as np
import pytest
from moving_rings import Shots, drawn_motion, stream

from ringpose.types.pose import PoseLine


@pytest.fixture(scope="module")
def records() -> list[PoseLine]:
    """Three seconds of a ring in slow motion, six shots a second."""
    rng = np.random.default_rng(18)
    return stream(drawn_motion(rng), 3.0, Shots(), rng)
