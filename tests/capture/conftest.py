"""A camera and lasers in virtual time."""

import pytest
from drawn_camera import ContactLasers, DrawnCamera

from ringpose.capture.lasers.driver import LaserDriver
from ringpose.simulate.serve.relays import RelayContacts


class VirtualTime:
    """The functions of `time` that the capture uses; their clocks are the same."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def time(self) -> float:
        return self.now_s

    monotonic = perf_counter = time

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


@pytest.fixture
def drawn_devices(rng, monkeypatch):
    """Creates a camera, and the lasers that it sees, switched by contacts with faults."""
    clock = VirtualTime()
    for module in ("drawn_camera", "ringpose.capture.settle", "ringpose.capture.self_test", LaserDriver.__module__):
        monkeypatch.setattr(f"{module}.time", clock)

    def created(faults=None, reports=True, **camera_options):
        contacts = RelayContacts(3, faults)
        return DrawnCamera(contacts, rng, **camera_options), ContactLasers(contacts, clock, reports)

    return created
