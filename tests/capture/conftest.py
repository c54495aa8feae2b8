"""A camera and lasers in virtual time."""

import pytest
from drawn_camera import ContactLasers, DrawnCamera
from virtual_time import VirtualTime

from ringpose.capture.lasers.driver import LaserDriver
from ringpose.simulate.serve.relays import RelayContacts


@pytest.fixture
def drawn_devices(rng, monkeypatch):
    """Creates a camera, and the lasers that it sees, switched by contacts with faults."""
    clock = VirtualTime()
    for module in ("drawn_camera", "ringpose.capture.pipeline", "ringpose.capture.self_test", LaserDriver.__module__):
        monkeypatch.setattr(f"{module}.time", clock)

    def created(faults=None, reports=True, **camera_options):
        contacts = RelayContacts(3, faults)
        return DrawnCamera(contacts, rng, **camera_options), ContactLasers(contacts, clock, reports)

    return created
