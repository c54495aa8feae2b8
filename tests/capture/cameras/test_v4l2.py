"""The OpenCV driver with a numbered image sequence instead of a video device."""

import cv2
import numpy as np
import pytest
from fake_camera import camera_of

from ringpose.errors import DeviceError, UsageError


@pytest.fixture
def sequence(tmp_path) -> str:
    """A folder of images; image k has the grey value 10 k."""
    for number in range(9):
        cv2.imwrite(str(tmp_path / f"{number:03d}.png"), np.full((6, 8, 3), 10 * number, np.uint8))
    return str(tmp_path / "%03d.png")


@pytest.mark.parametrize(("parameters", "greys"), [({}, [20, 50, 80]), ({"flush": "0"}, [0, 10, 20])])
def test_frames_that_began_too_early_are_discarded(sequence, parameters, greys):
    with (opened := camera_of(f"v4l2:{sequence}", **parameters)):
        frames = [opened.trigger(0) for _ in range(3)]

    assert [int(frame.image[0, 0]) for frame in frames] == greys
    assert frames[0].image.shape == (6, 8)


@pytest.mark.parametrize("flush", ["nan", "-1", "1.5"])
def test_an_invalid_number_of_frames_is_a_usage_error(flush):
    with pytest.raises(UsageError, match=f'flush is "{flush}"'):
        camera_of("v4l2:frames/%03d.png", flush=flush)


def test_the_size_is_the_images(sequence):
    with (opened := camera_of(f"v4l2:{sequence}")):
        description = opened.describe()

    assert (description.image_width, description.image_height, description.saturation_dn) == (8, 6, 255)


def test_a_camera_without_further_frames_is_an_error(sequence):
    with (opened := camera_of(f"v4l2:{sequence}", flush="0")):
        for _ in range(9):
            opened.trigger(0)
        with pytest.raises(DeviceError, match="no frame came, 3 times in a row"):
            opened.trigger(0)


def test_an_absent_device_is_an_error():
    with pytest.raises(DeviceError, match=r"cannot be opened; see ringpose capture --list"):
        camera_of("v4l2:/dev/video99").open()


def test_an_unknown_feature_is_rejected(sequence):
    with (opened := camera_of(f"v4l2:{sequence}")), pytest.raises(DeviceError, match="has no feature TriggerMode"):
        opened.set("TriggerMode", "On")


def test_opencv_adds_no_messages_of_its_own(capfd):
    with pytest.raises(DeviceError):
        camera_of("v4l2:/dev/video99").open()

    assert capfd.readouterr() == ("", "")
