"""`v4l2:`: webcams and other cameras of the kernel, through OpenCV: `v4l2:/dev/video0?flush=2`.

Such a camera is free-running, without a trigger. A frame that began before the lasers were switched is useless, so
`flush` frames (default 2) are discarded before each frame. Exposure control depends on the driver. For measurements,
use a camera with a trigger.
"""

import time
from typing import Any

import cv2

from ringpose.capture.cameras.triggered import MAX_SKIPPED, FrameGrab, SoftwareTriggeredCamera
from ringpose.capture.uri import DeviceUri
from ringpose.errors import DeviceError
from ringpose.opencv_log import silent_opencv

FLUSHED = 2

_MANUAL = 1.0
"""V4L2_EXPOSURE_MANUAL."""

_EXPOSURE_UNIT_S = 1e-4
"""Unit of V4L2_CID_EXPOSURE_ABSOLUTE."""


class V4l2Camera(SoftwareTriggeredCamera):
    """A camera that OpenCV can read; its name may also be a numbered image sequence, such as `frames/%03d.png`."""

    PARAMETERS = (*SoftwareTriggeredCamera.PARAMETERS, "flush")

    _capture: Any = None

    def __init__(self, uri: DeviceUri) -> None:
        super().__init__(uri)
        self._flushed = uri.whole("flush", FLUSHED, MAX_SKIPPED)

    def bounds(self, feature: str) -> tuple[float, float] | None:
        """None: OpenCV does not report the limits."""
        return None

    def set(self, feature: str, value: int | float | str) -> None:
        """Set exposure or gain; raises `DeviceError` if the camera rejects the value."""
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
        """Close the device."""
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.release()

    def _connect(self) -> None:
        self.close()
        address = self.uri.address
        with silent_opencv():  # no log output if the device does not exist
            self._capture = cv2.VideoCapture(address, cv2.CAP_V4L2 if address.startswith("/dev/") else cv2.CAP_ANY)
        if not self._capture.isOpened():
            remedy = "see ringpose capture --list; your user may have to be in the group video"
            raise DeviceError(self.uri.text, "cannot be opened", remedy)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def _start(self) -> None:
        """Nothing to do: the camera is free-running."""

    def _stop(self) -> None:
        """Nothing to do: the camera is free-running."""

    def _grab(self, limit_s: float) -> FrameGrab:
        for _ in range(self._flushed):
            self._capture.grab()
        stamp_s = time.time()
        is_read, image = self._capture.read()
        if is_read and image.ndim == 3:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return FrameGrab(stamp_s=stamp_s, image=image if is_read else None, is_late=False)

    def _number(self, feature: str) -> float | None:
        """The value of a feature; OpenCV reports 0 if it cannot read it."""
        if feature not in _PROPERTIES:
            return None
        value = float(self._capture.get(_PROPERTIES[feature]))
        return None if value <= 0 else value * (_EXPOSURE_UNIT_S / 1e-6 if feature == "ExposureTime" else 1.0)

    def _format(self) -> str:
        return "Mono8"

    def _identity(self) -> tuple[str, int, int]:
        sizes = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        width, height = (int(self._capture.get(size)) for size in sizes)
        return self.uri.address, width, height


_PROPERTIES = {"ExposureTime": cv2.CAP_PROP_EXPOSURE, "Gain": cv2.CAP_PROP_GAIN}
