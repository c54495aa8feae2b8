"""`pylon:`: Basler cameras through pypylon, `pip install ringpose[pylon]`.

pylon:              the first camera found
pylon:12345678      by its serial number
"""

import time
import warnings
from typing import Any

import numpy as np

from ringpose.capture.cameras.genapi import GenApiCamera, first_line
from ringpose.capture.cameras.triggered import FrameGrab, mid_stamp_s
from ringpose.errors import DeviceError

EXTRA = "pip install ringpose[pylon]"


class PylonCamera(GenApiCamera):
    """A camera that pypylon can drive."""

    _camera: Any = None
    _pylon: Any = None

    def close(self) -> None:
        """Close the camera."""
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.Close()

    def _connect(self) -> None:
        self.close()
        try:
            self._pylon = pypylon()
        except ImportError as error:
            raise DeviceError(self.uri.text, "needs pypylon, which is not installed", EXTRA) from error
        factory = self._pylon.TlFactory.GetInstance()
        devices = [info for info in factory.EnumerateDevices() if self.uri.address in ("", info.GetSerialNumber())]
        if not devices:
            raise DeviceError(self.uri.text, "no such camera", "see ringpose capture --list")
        try:
            self._camera = self._pylon.InstantCamera(factory.CreateDevice(devices[0]))
            self._camera.Open()
        except Exception as error:
            self._camera = None
            raise DeviceError(self.uri.text, first_line(error), "close other programs that use the camera") from error
        self._set_up()

    def _start(self) -> None:
        self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def _stop(self) -> None:
        self._camera.StopGrabbing()

    def _grab(self, limit_s: float) -> FrameGrab:
        pylon, camera, limit_ms = self._pylon, self._camera, int(1e3 * limit_s)
        try:
            camera.WaitForFrameTriggerReady(limit_ms, pylon.TimeoutHandling_ThrowException)
            before_s = time.time()
            camera.ExecuteSoftwareTrigger()
            stamp_s = mid_stamp_s(before_s)
            result = camera.RetrieveResult(limit_ms, pylon.TimeoutHandling_Return)
        except Exception as error:
            raise DeviceError(self.uri.text, first_line(error), "check its cable and its power") from error
        if not result or not result.IsValid():
            return FrameGrab(stamp_s=stamp_s)
        try:
            return self._grabbed(result, stamp_s)
        finally:
            result.Release()

    def _grabbed(self, result: Any, stamp_s: float) -> FrameGrab:
        number = int(result.BlockID)
        if not result.GrabSucceeded():
            problem = f"a frame was bad ({result.ErrorDescription or hex(result.ErrorCode)})"
            return FrameGrab(stamp_s=stamp_s, problem=problem, frame_id=number, is_late=False)
        return FrameGrab(
            stamp_s=stamp_s,
            image=np.array(result.Array),
            device_stamp_s=1e-9 * result.TimeStamp if result.TimeStamp else None,
            frame_id=number,
        )

    def _node(self, name: str) -> Any:
        from pypylon import genicam

        node = self._camera.GetNodeMap().GetNode(name)
        return node if node is not None and genicam.IsReadable(node) else None

    def _limits(self, node: Any) -> tuple[Any, Any]:
        return (node.Min, node.Max) if hasattr(node, "Min") else (None, None)

    def _value(self, node: Any) -> Any:
        return node.Value

    def _set_value(self, node: Any, value: int | float | str) -> None:
        node.Value = value


def pypylon() -> Any:
    """Basler's module, imported with warnings ignored: its C part crashes if they are raised as errors."""
    with warnings.catch_warnings(action="ignore"):
        from pypylon import pylon
    return pylon
