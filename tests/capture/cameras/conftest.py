"""A virtual camera, and the Aravis driver for it."""

from contextlib import ExitStack

import pytest
from fake_camera import camera_of
from served_scene import small_scene

from ringpose.capture.cameras.aravis import AravisCamera
from ringpose.simulate.serve.faults import parsed_faults
from ringpose.simulate.serve.virtual_device import Setup, VirtualDevice, virtual_device
from ringpose.types.options import AdvancePolicy


@pytest.fixture
def serve(tmp_path, loopback_address):
    """Starts a virtual camera with injected faults."""
    with ExitStack() as stack:

        def started(*faults: str, **setup) -> VirtualDevice:
            whole = Setup(address=loopback_address, move=AdvancePolicy.NEVER, faults=parsed_faults(faults, 3), **setup)
            return stack.enter_context(virtual_device(small_scene(tmp_path), whole))

        yield started


@pytest.fixture
def camera(loopback_address):
    """Creates a driver with an address and parameters."""

    def driver(address: str = loopback_address, **parameters: str) -> AravisCamera:
        return camera_of(f"aravis:{address}", **parameters)

    return driver
