"""Fixtures for detection."""

import pytest
from drawn_scene import drawn_rig

from ringpose.types.rig import Rig


@pytest.fixture(scope="session")
def rig() -> Rig:
    """The rig of the drawn scenes."""
    return drawn_rig()
