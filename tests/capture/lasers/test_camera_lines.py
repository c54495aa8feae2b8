"""Lasers at a camera's output lines."""

import pytest

from ringpose.capture.lasers.camera_lines import LineLasers
from ringpose.capture.lasers.driver import LaserContext
from ringpose.capture.uri import LASERS, device_uri, driver
from ringpose.errors import DeviceError, LaserSafetyError


class NotedLines:
    """A fake camera whose lines are all high at first."""

    def __init__(self, says=True, stuck=""):
        self.high = dict.fromkeys(("Line1", "Line2", "Line4"), True)
        self.calls, self.says, self.stuck = [], says, stuck

    def set_output(self, line, high):
        self.calls.append(f"{line} {'high' if high else 'low'}")
        if line not in self.high:
            raise DeviceError("camera", f"has no {line}")
        self.high[line] = high or line == self.stuck

    def output(self, line):
        return self.high[line] if self.says else None


def line_lasers(camera, text="line:Line2,Line4,Line1", names=None) -> LineLasers:
    uri = device_uri(text, "--lasers", LASERS)
    lasers = driver(LASERS, "line")(uri, LaserContext(names=names, camera=camera))
    assert isinstance(lasers, LineLasers)
    return lasers


def test_all_lines_are_low_after_opening():
    camera = NotedLines()

    line_lasers(camera).open()

    assert camera.high == {"Line1": False, "Line2": False, "Line4": False}


def test_lasers_are_switched_off_before_others_are_switched_on():
    camera = NotedLines()
    lasers = line_lasers(camera)
    lasers.set_mask(0b001)
    camera.calls.clear()

    lasers.set_mask(0b010)

    assert camera.calls == ["Line2 low", "Line1 low", "Line4 high"]
    assert lasers.read_mask() == 0b010


def test_a_line_that_remains_high_is_a_safety_fault():
    with pytest.raises(LaserSafetyError, match="mask 2"), line_lasers(NotedLines(stuck="Line4")) as _:
        pass


def test_a_camera_that_does_not_report_its_lines_gives_no_mask():
    assert line_lasers(NotedLines(says=False)).read_mask() is None


def test_lines_may_be_named_by_their_lasers():
    camera = NotedLines()
    lasers = line_lasers(camera, "line:right:Line1,left:Line2,middle:Line4", ("left", "middle", "right"))

    lasers.set_mask(0b100)

    assert [line for line, high in camera.high.items() if high] == ["Line1"]
