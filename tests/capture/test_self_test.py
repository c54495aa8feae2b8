"""The self-test, with a simulated camera and lasers with injected faults."""

import time

import pytest
from drawn_camera import DrawnCamera

from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.self_test import run_self_test
from ringpose.errors import LaserSafetyError
from ringpose.simulate.serve.relays import RelayContacts, RelayFaults


class ContactLasers(LaserDriver):
    count = 3

    def __init__(self, contacts: RelayContacts) -> None:
        self.contacts = contacts

    def set_mask(self, lasers: int) -> None:
        for laser in range(self.count):
            self.contacts.command(laser, bool(lasers >> laser & 1), time.monotonic())

    def read_mask(self) -> int | None:
        return None

    def close(self) -> None:
        pass


@pytest.fixture
def walked(rng, monkeypatch):
    """The checks of a self-test of lasers with these faults, by name."""
    monkeypatch.setattr("ringpose.capture.self_test.MAX_SETTLE_S", 0.05)

    def findings(**faults):
        contacts = RelayContacts(3, RelayFaults(**faults))
        camera, lasers = DrawnCamera(contacts, rng, brightness_dn=100.0), ContactLasers(contacts)
        with camera, lasers:
            return {finding.check: finding for finding in run_self_test(camera, lasers, 0.005)}

    return findings


def test_every_laser_is_walked_through(walked):
    found = walked()

    assert {"laser 1", "laser 2", "laser 3", "exposure, laser 3", "settle"} <= set(found)
    assert {finding.verdict for finding in found.values()} == {"ok"}


def test_a_dark_laser_is_a_fault_and_the_rest_is_walked_through(walked):
    found = walked(dead=frozenset({1}))

    assert [check for check, finding in found.items() if finding.verdict == "fault"] == ["laser 2"]


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ({"welded": frozenset({0})}, "laser 1: is not seen to go on or off, and a stripe shows while all are off"),
        ({"stuck": frozenset({1})}, "laser 2: is seen after it was switched off; cut the power"),
    ],
)
def test_a_laser_that_stays_on_is_a_safety_fault(walked, faults, words):
    with pytest.raises(LaserSafetyError, match=words):
        walked(**faults)
