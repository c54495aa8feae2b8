"""The capture procedure, with fake drivers that record their calls."""

from collections.abc import Iterator
from itertools import count

import numpy as np
import pytest
from fake_camera import FakeCamera

from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.pipeline import Procedure, captured_shots
from ringpose.errors import DeviceError, LaserSafetyError, SignalReceived, UsageError
from ringpose.types.image import Frame, Shot
from ringpose.types.session import parsed_sequence


class RecordingLasers(LaserDriver):
    """Fake lasers that record their calls; the mask `stuck` is always on, `dark` never."""

    count = 3

    def __init__(self, stuck: int = 0, reports: bool = True, dark: int = 0) -> None:
        self.calls: list[str] = []
        self.on_mask, self.stuck, self.reports, self.dark = 0, stuck, reports, dark

    def open(self) -> None:
        self.calls.append("open")

    def set_mask(self, lasers: int) -> None:
        self.calls.append(f"set {lasers}")
        self.on_mask = lasers & ~self.dark | self.stuck

    def read_mask(self) -> int | None:
        return self.on_mask if self.reports else None

    def close(self) -> None:
        self.calls.append("close")


class RecordingCamera(FakeCamera):
    """A fake camera whose grey values encode the frame number and the mask of the lasers."""

    saturation_dn = 200

    def __init__(
        self, lasers: RecordingLasers, fails_at: int | None = None, error: BaseException | None = None
    ) -> None:
        self.lasers, self.fails_at, self.error = lasers, fails_at, error
        self.taken = 0
        self.exposure_s: float | None = None
        self.closed = 0

    def arm(self, exposure_s: float | None) -> None:
        self.exposure_s = exposure_s

    def trigger(self, lasers: int, exposure_s: float | None = None) -> Frame:
        if self.taken == self.fails_at and self.error:
            raise self.error
        image = np.full((2, 3), 10 * self.taken + self.lasers.on_mask, dtype=np.uint8)
        self.taken += 1
        return Frame(image=image, lasers=lasers, stamp_s=float(self.taken), exposure_s=self.exposure_s or 0.005)

    def close(self) -> None:
        self.closed += 1


def shots_of(lasers: RecordingLasers, sequence: str, camera: RecordingCamera | None = None) -> Iterator[Shot]:
    """Captures shots named 0, 1, 2 ... with these steps."""
    return captured_shots(
        camera or RecordingCamera(lasers), lasers, Procedure(steps=parsed_sequence(sequence)), map(str, count())
    )


def test_every_frame_is_triggered_while_its_lasers_are_on_and_recorded_with_them():
    lasers = RecordingLasers(dark=0b100)

    shot = next(shots_of(lasers, "off,1,2,3,off"))

    assert shot.images[:, 0, 0].tolist() == [0, 11, 22, 30, 40]
    assert shot.lasers.tolist() == [0, 1, 2, 4, 0]
    assert shot.read_lasers is not None
    assert shot.read_lasers.tolist() == [0, 1, 2, 0, 0]
    assert shot.stamp_s.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert shot.saturation_dn == 200


def test_all_lasers_are_off_when_a_shot_is_yielded():
    lasers = RecordingLasers()
    next(shots_of(lasers, "off,all"))

    assert lasers.on_mask == 0


@pytest.mark.parametrize("sequence", ["off,1", "1,2", "1+2"])
def test_a_laser_that_the_board_reports_on_though_all_are_off_is_a_safety_fault(sequence):
    lasers = RecordingLasers(stuck=0b100)

    with pytest.raises(LaserSafetyError, match="laser 3 was reported on while all are off; cut the power"):
        next(shots_of(lasers, sequence))


def test_a_shot_with_a_wrong_reported_mask_is_repeated():
    class Hasty(RecordingLasers):
        """Fake lasers that report a wrong mask until all were switched off."""

        def read_mask(self) -> int | None:
            return 0b010 if self.on_mask == 4 and "set 0" not in self.calls else self.on_mask

    lasers = Hasty()

    shot = next(shots_of(lasers, "1,3"))

    assert shot.read_lasers is not None
    assert shot.read_lasers.tolist() == [1, 4]
    assert lasers.calls.count("set 4") == 2


@pytest.mark.parametrize(("sequence", "exposure_s"), [("all", 1.5), ("off,1@9us", None), ("off,1@1500ms", 0.1)])
def test_an_exposure_out_of_bounds_is_a_usage_error(sequence, exposure_s):
    class Bounded(RecordingCamera):
        def bounds(self, feature: str) -> tuple[float, float] | None:
            return {"ExposureTime": (10.0, 1e6)}[feature]

    lasers = RecordingLasers()
    procedure = Procedure(steps=parsed_sequence(sequence), exposure_s=exposure_s)
    shots = captured_shots(Bounded(lasers), lasers, procedure, ["first"])

    with pytest.raises(UsageError, match="s; it takes 1e-05 to 1 s"):
        next(shots)

    assert lasers.calls == []


def test_a_board_that_does_not_report_gives_no_read_masks():
    lasers = RecordingLasers(reports=False)

    shot = next(shots_of(lasers, "off,1"))

    assert shot.read_lasers is None


def test_the_exposure_reaches_the_camera():
    lasers = RecordingLasers()

    (shot,) = captured_shots(
        RecordingCamera(lasers), lasers, Procedure(steps=parsed_sequence("all"), exposure_s=0.25), ["first"]
    )

    assert shot.exposure_s.tolist() == [0.25]


@pytest.mark.parametrize(
    "error", [SignalReceived(15), SignalReceived(2), DeviceError("camera", "gone"), KeyError("bug")]
)
def test_whatever_ends_a_capture_ends_with_the_lasers_off_and_both_devices_closed(error):
    lasers = RecordingLasers()
    camera = RecordingCamera(lasers, fails_at=3, error=error)

    with pytest.raises(type(error)), camera, lasers:
        next(shots_of(lasers, "off,1,2,3", camera))

    assert "set 4" in lasers.calls
    assert lasers.calls[-2:] == ["set 0", "close"]
    assert camera.closed


def test_lasers_that_cannot_be_opened_are_closed():
    class Absent(RecordingLasers):
        def open(self) -> None:
            raise DeviceError("lasers", "no such port")

    lasers = Absent()

    with pytest.raises(DeviceError), lasers:
        pass

    assert lasers.calls == ["close"]


def test_a_second_signal_while_switching_off_leaves_no_laser_on():
    class Interrupted(RecordingLasers):
        def set_mask(self, lasers: int) -> None:
            if lasers == 0 and "interrupted" not in self.calls:
                self.calls.append("interrupted")
                raise SignalReceived(15)
            super().set_mask(lasers)

    lasers = Interrupted()

    with pytest.raises(SignalReceived), lasers:
        lasers.set_mask(7)

    assert lasers.on_mask == 0
    assert lasers.calls[-1] == "close"


def test_a_laser_reported_on_at_the_end_is_a_safety_fault():
    lasers = RecordingLasers(stuck=0b010)

    with pytest.raises(LaserSafetyError, match="mask 2"), lasers:
        pass

    assert lasers.calls[-1] == "close"


def test_a_board_that_fails_while_switching_off_is_a_safety_fault():
    class Unplugged(RecordingLasers):
        def set_mask(self, lasers: int) -> None:
            self.calls.append(f"set {lasers}")
            if lasers == 0:
                raise DeviceError("/dev/ttyUSB0", "gone")

    lasers = Unplugged()

    with pytest.raises(LaserSafetyError, match="gone"), lasers:
        lasers.set_mask(7)

    assert lasers.calls == ["open", "set 7", "set 0", "set 0", "close"]
