"""Base class of software-triggered cameras: set the exposure, trigger, wait for the frame, repeat if it is damaged.

Features are named by the Standard Features Naming Convention (SFNC).
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
"""Triggers for one frame: the first one after a pause may be ignored, and packets may get lost."""

TIMEOUT_S = 2.0
"""Default time that a frame may take beyond its exposure."""

MAX_SKIPPED = 1000
"""Maximum number of frames to discard before one that is used."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameGrab:
    """The result of one trigger."""

    stamp_s: float
    """Host clock (Unix epoch, UTC) at the trigger."""
    image: UInt[Array, "row column"] | None = None
    problem: str = "no frame came"
    """Why there is no image."""
    device_stamp_s: float | None = None
    frame_id: int | None = None
    is_late: bool = True
    """Whether a frame may still arrive, which could be mistaken for the next one."""


class SoftwareTriggeredCamera(CameraDriver):
    """A camera that is triggered once for each frame; a driver implements the abstract methods.

    Parameters of its URI are `format` (Mono8 or Mono12), `gain` (dB), `timeout` (s) and `skip`: the number of frames to
    discard after a change of the exposure, for cameras that apply it late.
    """

    PARAMETERS: tuple[str, ...] = ("format", "gain", "timeout", "skip")

    def __init__(self, uri: DeviceUri) -> None:
        uri.reject_unknown(self.PARAMETERS)
        self.uri = uri
        self.dropped = 0
        """Number of frames lost since opening, by the camera's frame numbers."""
        self._pixel_format = uri.parameters.get("format", "")
        self._timeout_s = uri.number("timeout", TIMEOUT_S, 0.01, 3600.0)
        self._skip = uri.whole("skip", 0, MAX_SKIPPED)
        self._requested_gain_db = uri.number("gain", 0.0) if "gain" in uri.parameters else None
        self._gain_db: float | None = None
        self._ready_lines: set[str] = set()
        self._description: CameraDescription | None = None
        self._last_id: int | None = None
        self._own_exposure_s = self._exposure_s = self._armed_s = 0.0
        if self._pixel_format and self._pixel_format not in SATURATION_DN:
            raise uri.problem(f'format "{self._pixel_format}" is not known', f"use one of {', '.join(SATURATION_DN)}")

    def open(self) -> None:
        """Open the camera and set it to single frames by software trigger."""
        self.dropped, self._last_id, self._ready_lines, self._description = 0, None, set(), None
        self._connect()
        if self._pixel_format:
            self.set("PixelFormat", self._pixel_format)
        if self._format() not in SATURATION_DN:
            remedy = "use ?format=Mono8 or, if the camera has it, Mono12"
            raise DeviceError(self.uri.text, f"sends pixels in the format {self._format()}", remedy)
        if self._requested_gain_db is not None:
            self.set("Gain", self._requested_gain_db)
        self._gain_db = self._number("Gain")
        exposure_us = self._number("ExposureTime")
        self._own_exposure_s = self._exposure_s = self._armed_s = 0.0 if exposure_us is None else 1e-6 * exposure_us
        self._start()

    def arm(self, exposure_s: float | None) -> None:
        """Set the exposure of the next frames."""
        self._armed_s = self._own_exposure_s if exposure_s is None else exposure_s
        self._expose_for(self._armed_s)

    def trigger(self, lasers: int, exposure_s: float | None = None) -> Frame:
        """A complete frame, after up to `TRIES` triggers."""
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
            if grab.is_late:  # a late frame must not be mistaken for the next one; frame numbers may restart
                self._stop()
                self._last_id = None
                self._start()
        raise DeviceError(self.uri.text, f"{grab.problem}, {TRIES} times in a row", self._loss_remedy())

    def set_output(self, line: str, high: bool) -> None:
        """Set an output line by its SFNC name (`Line1`); user output k is set low, then made the source of line k."""
        number = _line_number(line, self.uri)
        if line not in self._ready_lines:
            self._set_user_output(number, False)
            self.set("LineSelector", line)
            with suppress(DeviceError):  # on some cameras the direction of the lines is fixed
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
        """Properties of the camera, read once after opening."""
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
        """Count the frames lost since the previous frame number."""
        if frame_id is None:
            return
        if self._last_id is not None:
            self.dropped += self._lost_between(self._last_id, frame_id)
        self._last_id = frame_id

    def _lost_between(self, last: int, frame_id: int) -> int:
        return max(frame_id - last - 1, 0)

    def _loss_remedy(self) -> str:
        return "check its cable, and that nothing else sets its trigger"

    @abstractmethod
    def _connect(self) -> None:
        """Open the camera."""

    @abstractmethod
    def _start(self) -> None:
        """Prepare the camera to wait for software triggers."""

    @abstractmethod
    def _stop(self) -> None:
        """Stop waiting for software triggers."""

    @abstractmethod
    def _grab(self, limit_s: float) -> FrameGrab:
        """Trigger once, and wait for the frame."""

    @abstractmethod
    def _number(self, feature: str) -> float | None:
        """The current value of a numeric feature; None if the camera does not have it."""

    @abstractmethod
    def _format(self) -> str:
        """The current pixel format."""

    @abstractmethod
    def _identity(self) -> tuple[str, int, int]:
        """Name of the camera, width and height of its images."""


def mid_stamp_s(before_s: float) -> float:
    """The mean of a time and now (host clock): estimated time at which a command sent in between took effect."""
    return (before_s + time.time()) / 2


def _line_number(line: str, uri: DeviceUri) -> int:
    number = line.removeprefix("Line")
    if number == line or not number.isascii() or not number.isdigit():
        raise DeviceError(uri.text, f'has no output line "{line}"', "lines are named Line1, Line2, ...")
    return int(number)


SATURATION_DN = {"Mono8": 255, "Mono10": 1023, "Mono12": 4095, "Mono14": 16383, "Mono16": 65535}
"""Maximum grey value of the supported pixel formats."""
