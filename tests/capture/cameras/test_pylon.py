"""The pylon driver with the emulated camera of pypylon."""

import os
import sys

import pytest
from fake_camera import camera_of
from needed import needed_module

from ringpose.errors import DeviceError


@pytest.fixture
def emulated():
    os.environ["PYLON_CAMEMU"] = "1"  # pypylon reads it when it is imported
    needed_module("pypylon.pylon", "ringpose[pylon]")

    return lambda address="", **parameters: camera_of(f"pylon:{address}", **parameters)


def test_each_trigger_gives_one_frame_of_the_emulated_camera(emulated):
    with (camera := emulated()):
        description = camera.describe()
        camera.arm(0.002)
        frames = [camera.trigger(mask) for mask in (0, 1, 2, 4)]

        assert (description.image_width, description.image_height) == frames[0].image.shape[::-1]
        assert [frame.lasers for frame in frames] == [0, 1, 2, 4]
        assert [frame.exposure_s for frame in frames] == 4 * [0.002]
        assert [frame.frame_id - frames[0].frame_id for frame in frames] == [0, 1, 2, 3]
        assert camera.dropped == 0


def test_twelve_bits_and_gain_are_set(emulated):
    with (camera := emulated(format="Mono12")):
        assert camera.describe().saturation_dn == 4095
        assert camera.trigger(0).image.dtype == "uint16"


def test_failed_frames_are_triggered_again(emulated):
    with (camera := emulated()):
        camera.set("ForceFailedBufferCount", 2)
        camera._camera.GetNodeMap().GetNode("ForceFailedBuffer").Execute()
        frames = [camera.trigger(0) for _ in range(3)]

    assert max(frame.attempts for frame in frames) > 1


def test_output_lines_are_set_and_read(emulated):
    with (camera := emulated()):
        camera.set_output("Line2", True)

        assert [camera.output(f"Line{number}") for number in (1, 2, 3)] == [False, True, False]


def test_an_exposure_out_of_bounds_is_rejected(emulated):
    with (camera := emulated()), pytest.raises(DeviceError, match=r"ExposureTime cannot be .*; it takes"):
        camera.arm(1e6)


def test_an_absent_camera_is_an_error(emulated):
    with pytest.raises(DeviceError, match="no such camera"):
        emulated("99999999").open()


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pypylon", None)

    with pytest.raises(DeviceError, match=r"needs pypylon.*pip install ringpose\[pylon\]"):
        camera_of("pylon:").open()
