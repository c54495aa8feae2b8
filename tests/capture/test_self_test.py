"""The self-test and the settling time, with a simulated camera and lasers with injected faults, in virtual time."""

from contextlib import nullcontext
from unittest.mock import create_autospec

import numpy as np
import pytest

from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.laser_check import lit_pixels
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.self_test import run_self_test
from ringpose.capture.settle import SETTLE_MARGIN, measured_settle_s
from ringpose.capture.shot_check import require_off
from ringpose.errors import LaserSafetyError
from ringpose.simulate.serve.relays import RelayFaults
from ringpose.types.image import Frame

EXPOSURE_S = 0.005


@pytest.fixture
def devices(drawn_devices):
    """A camera, and lasers with the given faults that report no mask."""
    return lambda **faults: drawn_devices(RelayFaults(**faults), reports=False, brightness_dn=100.0)


@pytest.fixture
def walked(devices):
    """The checks of a self-test of lasers with these faults, by name."""

    def findings(**faults):
        camera, lasers = devices(**faults)
        with camera, lasers:
            return {finding.check: finding for finding in run_self_test(camera, lasers, EXPOSURE_S)}

    return findings


def test_every_laser_is_walked_through(walked):
    found = walked(operate_s=0.002, release_s=0.002)

    assert {"laser 1", "laser 2", "laser 3", "exposure, laser 3", "settle"} <= set(found)
    assert {finding.verdict for check, finding in found.items() if check != "board"} == {"ok"}


@pytest.mark.parametrize(("reports", "verdict"), [(True, "ok"), (False, "warning")])
def test_a_board_that_does_not_report_its_relays_is_a_warning(drawn_devices, reports, verdict):
    camera, lasers = drawn_devices(reports=reports)
    with camera, lasers:
        found = {finding.check: finding for finding in run_self_test(camera, lasers, EXPOSURE_S)}

    assert found["board"].verdict == verdict


def test_a_dark_laser_is_a_fault_and_the_rest_is_walked_through(walked):
    found = walked(dead=frozenset({1}))

    assert [check for check, finding in found.items() if finding.verdict == "fault"] == ["laser 2"]


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ({"welded": frozenset({0})}, "laser 1 was not seen to go on or off, and a stripe shows while all are off"),
        ({"stuck": frozenset({1})}, "laser 2 was seen while all are off; cut the power"),
    ],
)
def test_a_laser_that_stays_on_is_a_safety_fault(walked, faults, words):
    with pytest.raises(LaserSafetyError, match=words):
        walked(**faults)


@pytest.mark.parametrize(("fault", "words"), [("stuck", "seen while all are off"), ("welded", "a stripe shows")])
def test_the_settling_time_is_not_measured_beyond_a_laser_that_stays_on(devices, fault, words):
    camera, lasers = devices(**{fault: frozenset({0})})
    with camera, lasers:
        began_s = lasers.clock.monotonic()
        with pytest.raises(LaserSafetyError, match=f"laser 1 was .*{words}"):
            measured_settle_s(camera, lasers, EXPOSURE_S)
        shares_on = lasers.contacts.shares(began_s, lasers.clock.monotonic())

    assert shares_on[0] > 0
    assert shares_on[1:] == (0.0, 0.0)


@pytest.mark.parametrize(
    "delay_s", [0.0, pytest.param(0.001, marks=pytest.mark.slow), 0.03, pytest.param(0.08, marks=pytest.mark.slow)]
)
def test_the_settling_time_is_the_slowest_delay_to_within_one_exposure(devices, delay_s):
    camera, lasers = devices(operate_s=delay_s / 2, release_s=delay_s)
    with camera, lasers:
        settle_s = measured_settle_s(camera, lasers, EXPOSURE_S)

    assert delay_s - 1e-9 < settle_s / SETTLE_MARGIN < delay_s + EXPOSURE_S + 1e-9


@pytest.mark.parametrize(
    ("ambient_dn", "stays_on"),
    [((40.0, 70.0), False), ((60.0, 30.0), True), ((40.0, 40.0), False), ((40.0, 40.0), True)],
)
def test_whether_a_laser_went_off_is_seen_in_changing_ambient_light(rng, ambient_dn, stays_on):
    def image(level_dn, is_on):
        grey = rng.normal(level_dn, 2.0, (300, 400))
        grey[150:153, 50:350] += 40.0 * is_on
        return grey.clip(0, 255).astype(np.uint8)

    camera, lasers = create_autospec(CameraDriver, instance=True), create_autospec(LaserDriver, instance=True)
    camera.trigger.return_value = Frame(image=image(ambient_dn[1], stays_on), lasers=0, stamp_s=0.0, exposure_s=0.01)
    before = image(ambient_dn[0], False), image(ambient_dn[0], True)
    pixels = lit_pixels(before[1], [before[0]], 255)

    with pytest.raises(LaserSafetyError, match="laser 1 was seen while all are off") if stays_on else nullcontext():
        require_off(camera, lasers, 0, pixels, 0.0)
