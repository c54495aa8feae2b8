"""What every triggered camera does alike: expose, wait for that one frame, try again if it came broken.

Features by their names in the Standard Features Naming Convention, and what older cameras call them.
"""

import time
from abc import abstractmethod
from contextlib import suppress
from dataclasses import dataclass

from ringpose.capture.cameras.driver import CameraDescription, CameraDriver
from ringpose.capture.uri import DeviceUri
from ringpose.errors import DeviceError
from ringpose.types.arrays import Array, UInt
from ringpose.types.image import Frame

TRIES = 3
"""Triggers for one frame: the first one after a pause, or one with lost packets, may be in vain."""

ANSWER_LIMIT_S = 2.0
"""How long a frame may take beyond its exposure."""

MAX_SKIPPED = 1000
"""Frames that may be thrown away before one that counts."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameGrab:
    """What came of one trigger."""

    stamp_s: float
    """Host clock (Unix epoch, UTC) at the trigger."""
    image: UInt[Array, "row column"] | None = None
    problem: str = "no frame came"
    """Why there is no image."""
    device_stamp_s: float | None = None
    frame_id: int | None = None
    is_late: bool = True
    """Whether a frame may still be on its way, so that the next one could be taken for another."""


class SoftwareTriggeredCamera(CameraDriver):
    """A camera that is told each exposure and triggered once for each frame; what a driver adds is below.

    Its URI may say `format` (Mono8 or Mono12), `gain` (dB), `timeout` (s) and `skip`: how many frames to throw away
    after a change of the exposure, for cameras that apply it late.
    """

    PARAMETERS: tuple[str, ...] = ("format", "gain", "timeout", "skip")

    def __init__(self, uri: DeviceUri) -> None:
        uri.refuse_unknown(self.PARAMETERS)
        self.uri = uri
        self.dropped = 0
        """Frames that were lost since it was opened, by its own count."""
        self._pixel_format = uri.parameters.get("format", "")
        self._timeout_s = uri.number("timeout", ANSWER_LIMIT_S, 0.01, 3600.0)
        self._skip = uri.whole("skip", 0, MAX_SKIPPED)
        self._wanted_gain_db = uri.number("gain", 0.0) if "gain" in uri.parameters else None
        self._gain_db: float | None = None
        self._ready_lines: set[str] = set()
        self._description: CameraDescription | None = None
        self._last_id: int | None = None
        self._own_exposure_s = self._exposure_s = self._armed_s = 0.0
        if self._pixel_format and self._pixel_format not in SATURATION_DN:
            raise uri.problem(f'format "{self._pixel_format}" is not known', f"say one of {', '.join(SATURATION_DN)}")

    def open(self) -> None:
        """Take the camera and set it to single frames by software trigger."""
        self.dropped, self._last_id, self._ready_lines, self._description = 0, None, set(), None
        self._connect()
        if self._pixel_format:
            self.set("PixelFormat", self._pixel_format)
        if self._format() not in SATURATION_DN:
            remedy = "ask for ?format=Mono8 or, where the camera has it, Mono12"
            raise DeviceError(self.uri.text, f"sends pixels in the format {self._format()}", remedy)
        if self._wanted_gain_db is not None:
            self.set("Gain", self._wanted_gain_db)
        self._gain_db = self._number("Gain")
        exposure_us = self._number("ExposureTime")
        self._own_exposure_s = self._exposure_s = self._armed_s = 0.0 if exposure_us is None else 1e-6 * exposure_us
        self._start()

    def arm(self, exposure_s: float | None) -> None:
        """Set the exposure of the frames to come."""
        self._armed_s = self._own_exposure_s if exposure_s is None else exposure_s
        self._expose_for(self._armed_s)

    def trigger(self, lasers: int, exposure_s: float | None = None) -> Frame:
        """A whole frame, if need be in several attempts."""
        self._expose_for(self._armed_s if exposure_s is None else exposure_s)
        dropped_before = self.dropped
        for attempt in range(1, TRIES + 1):
            grab = self._grab(self._exposure_s + self._timeout_s)
            self._count(grab.frame_id)
            if grab.image is not None:
                return Frame(
                    image=grab.image,
                    lasers=lasers,
                    stamp_s=grab.stamp_s,
                    exposure_s=self._exposure_s,
                    device_stamp_s=grab.device_stamp_s,
                    frame_id=grab.frame_id,
                    gain_db=self._gain_db,
                    attempts=attempt,
                    dropped=self.dropped - dropped_before,
                )
            if grab.is_late:
                self._restart()
        raise DeviceError(self.uri.text, f"{grab.problem}, {TRIES} times in a row", self._loss_remedy())

    def set_output(self, line: str, high: bool) -> None:
        """Set an output line by its SFNC name (`Line1`); output k, low before it is, becomes the source of line k."""
        number = _line_number(line, self.uri)
        if line not in self._ready_lines:
            self._set_user_output(number, False)
            self.set("LineSelector", line)
            with suppress(DeviceError):  # the lines of some cameras are outputs for ever
                self.set("LineMode", "Output")
            self.set("LineSource", f"UserOutput{number}")
            self._ready_lines.add(line)
        self._set_user_output(number, high)

    def output(self, line: str) -> bool | None:
        """Whether an output line is high."""
        self.set("UserOutputSelector", f"UserOutput{_line_number(line, self.uri)}")
        high = self._number("UserOutputValue")
        return None if high is None else bool(high)

    def _set_user_output(self, number: int, high: bool) -> None:
        self.set("UserOutputSelector", f"UserOutput{number}")
        self.set("UserOutputValue", high)

    def describe(self) -> CameraDescription:
        """Which camera it is, as it was when it was opened."""
        if self._description is None:
            name, width, height = self._identity()
            self._description = CameraDescription(
                name=name, image_width=width, image_height=height, saturation_dn=SATURATION_DN[self._format()]
            )
        return self._description

    def _expose_for(self, exposure_s: float) -> None:
        if exposure_s == self._exposure_s or self._number("ExposureTime") is None:
            return
        self.set("ExposureTime", 1e6 * exposure_s)
        self._exposure_s = exposure_s
        for _ in range(self._skip):
            self._count(self._grab(exposure_s + self._timeout_s).frame_id)

    def _count(self, frame_id: int | None) -> None:
        """Count the frames that are missing between two numbers."""
        if frame_id is None:
            return
        if self._last_id is not None:
            self.dropped += self._lost_between(self._last_id, frame_id)
        self._last_id = frame_id

    def _restart(self) -> None:
        """Let no late frame be taken for the next one; a camera may number its frames anew."""
        self._stop()
        self._last_id = None
        self._start()

    def _lost_between(self, last: int, frame_id: int) -> int:
        return max(frame_id - last - 1, 0)

    def _loss_remedy(self) -> str:
        return "check its cable, and that nothing else sets its trigger"

    @abstractmethod
    def _connect(self) -> None:
        """Take the camera."""

    @abstractmethod
    def _start(self) -> None:
        """Make it wait for software triggers."""

    @abstractmethod
    def _stop(self) -> None:
        """End that."""

    @abstractmethod
    def _grab(self, limit_s: float) -> FrameGrab:
        """Trigger once, and wait for the frame that comes of it."""

    @abstractmethod
    def _number(self, feature: str) -> float | None:
        """The present value of a numeric feature; None if there is none."""

    @abstractmethod
    def _format(self) -> str:
        """The present pixel format."""

    @abstractmethod
    def _identity(self) -> tuple[str, int, int]:
        """Name, width and height."""


def mid_stamp_s(before_s: float) -> float:
    """The middle between a time and now, host clock: when a command that was answered meanwhile took effect."""
    return (before_s + time.time()) / 2


def _line_number(line: str, uri: DeviceUri) -> int:
    number = line.removeprefix("Line")
    if number == line or not number.isascii() or not number.isdigit():
        raise DeviceError(uri.text, f'has no output line "{line}"', "lines are called Line1, Line2, ...")
    return int(number)


ALIASES = {
    "ExposureTime": ("ExposureTime", "ExposureTimeAbs"),
    "Gain": ("Gain", "GainAbs", "GainRaw"),
    "AcquisitionFrameRate": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"),
    "UserOutputValueAll": ("UserOutputValueAll", "UserOutputValueAllRaw"),
    "DeviceTemperature": ("DeviceTemperature", "DeviceTemperatureAbs", "TemperatureAbs"),
}

SATURATION_DN = {"Mono8": 255, "Mono10": 1023, "Mono12": 4095, "Mono14": 16383, "Mono16": 65535}
"""The last grey value of the pixel formats that a driver can be asked for."""


def spellings(feature: str) -> tuple[str, ...]:
    """Under which names a feature may be found, the standard one first."""
    return ALIASES.get(feature, (feature,))
