"""`v4l2:`: webcams and other cameras of the kernel, through OpenCV: `v4l2:/dev/video0?flush=2`.

Such a camera runs freely and knows no trigger. A frame that began before the lasers were switched is worth nothing, so
as many frames as `flush` says (2 if it does not) are thrown away before each one that counts. Exposure control
depends on the driver. For measurements take a camera with a trigger.
"""

import time
from typing import Any

import cv2
import numpy as np

from ringpose.capture.cameras.triggered import MAX_SKIPPED, FrameGrab, SoftwareTriggeredCamera
from ringpose.capture.uri import DeviceUri
from ringpose.errors import DeviceError
from ringpose.opencv_log import silent_opencv
from ringpose.types.arrays import Array, UInt8

FLUSHED = 2

_MANUAL = 1.0
"""V4L2_EXPOSURE_MANUAL."""

_EXPOSURE_UNIT_S = 1e-4
"""Of V4L2_CID_EXPOSURE_ABSOLUTE."""


class V4l2Camera(SoftwareTriggeredCamera):
    """A camera that OpenCV can read; its name may also be a numbered image sequence, such as `frames/%03d.png`."""

    PARAMETERS = (*SoftwareTriggeredCamera.PARAMETERS, "flush")

    _capture: Any = None

    def __init__(self, uri: DeviceUri) -> None:
        super().__init__(uri)
        self._flushed = uri.whole("flush", FLUSHED, MAX_SKIPPED)

    def bounds(self, feature: str) -> tuple[float, float] | None:
        """The kernel knows them, OpenCV does not tell them."""
        return None

    def set(self, feature: str, value: int | float | str) -> None:
        """Exposure and gain; what the camera does not take is an error."""
        if feature == "PixelFormat" and value == "Mono8":
            return
        if feature not in _PROPERTIES or isinstance(value, str):
            raise DeviceError(self.uri.text, f"has no feature {feature} to be set to {value}")
        scale = 1e-6 / _EXPOSURE_UNIT_S if feature == "ExposureTime" else 1.0
        if feature == "ExposureTime":
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL)
        if not self._capture.set(_PROPERTIES[feature], scale * value):
            remedy = "set it by v4l2-ctl, and leave it out here"
            raise DeviceError(self.uri.text, f"does not take {feature} {value:g}", remedy)

    def close(self) -> None:
        """Let go of the device."""
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.release()

    def _connect(self) -> None:
        self.close()
        self._capture = _opened(self.uri.place)
        if not self._capture.isOpened():
            remedy = "see ringpose capture --list; your user may have to be of the group video"
            raise DeviceError(self.uri.text, "cannot be opened", remedy)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def _start(self) -> None:
        """It runs already."""

    def _stop(self) -> None:
        """It runs on."""

    def _grab(self, limit_s: float) -> FrameGrab:
        for _ in range(self._flushed):
            self._capture.grab()
        stamp_s = time.time()
        is_there, image = self._capture.read()
        return FrameGrab(stamp_s=stamp_s, image=_grey(image) if is_there else None, is_late=False)

    def _number(self, feature: str) -> float | None:
        """What can be asked for; zero is how OpenCV says that it cannot."""
        if feature not in _PROPERTIES:
            return None
        value = float(self._capture.get(_PROPERTIES[feature]))
        return None if value <= 0 else value * (_EXPOSURE_UNIT_S / 1e-6 if feature == "ExposureTime" else 1.0)

    def _format(self) -> str:
        return "Mono8"

    def _identity(self) -> tuple[str, int, int]:
        sizes = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        width, height = (int(self._capture.get(size)) for size in sizes)
        return self.uri.place, width, height


_PROPERTIES = {"ExposureTime": cv2.CAP_PROP_EXPOSURE, "Gain": cv2.CAP_PROP_GAIN}


def _opened(place: str) -> Any:
    """OpenCV's capture, which writes no log of its own if there is no such device."""
    with silent_opencv():
        return cv2.VideoCapture(place, cv2.CAP_V4L2 if place.startswith("/dev/") else cv2.CAP_ANY)


def _grey(image: UInt8[Array, "row column *channel"]) -> UInt8[Array, "row column"]:
    """Luminance of a colour image."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
