"""A virtual camera, and the Aravis driver for it."""

import pytest
from fake_camera import camera_of
from served_scene import small_scene

from ringpose.capture.cameras.aravis import AravisCamera
from ringpose.simulate.serve.faults import parsed_faults
from ringpose.simulate.serve.virtual_device import Setup, VirtualDevice
from ringpose.types.options import AdvancePolicy


@pytest.fixture
def serve(tmp_path, loopback_address):
    """Starts a virtual camera with injected faults."""
    started = []

    def started_stand_in(*faults: str, **setup) -> VirtualDevice:
        scene = small_scene(tmp_path)
        whole = Setup(address=loopback_address, move=AdvancePolicy.NEVER, faults=parsed_faults(faults, 3), **setup)
        started.append(VirtualDevice(scene, whole).__enter__())
        return started[-1]

    yield started_stand_in
    for each in started:
        each.__exit__(None, None, None)


@pytest.fixture
def camera(loopback_address):
    """Creates a driver with an address and parameters."""

    def driver(address: str = loopback_address, **parameters: str) -> AravisCamera:
        return camera_of(f"aravis:{address}", **parameters)

    return driver
