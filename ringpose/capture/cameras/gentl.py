"""`gentl:`: any camera whose manufacturer provides a GenTL producer, through harvesters (ringpose[gentl]).

gentl:/opt/maker/producer.cti                  the first camera found by the producer
gentl:/opt/maker/producer.cti?serial=12345     by its serial number
"""

import time
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.capture.cameras.genapi import GenApiCamera, first_line
from ringpose.capture.cameras.triggered import FrameGrab, SoftwareTriggeredCamera, mid_stamp_s
from ringpose.errors import DeviceError

EXTRA = "pip install ringpose[gentl]"


class GenTlCamera(GenApiCamera):
    """A camera driven by harvesters; it must support software triggers."""

    PARAMETERS = (*SoftwareTriggeredCamera.PARAMETERS, "serial")

    _harvester: Any = None
    _acquirer: Any = None

    def close(self) -> None:
        """Close the camera and the producer."""
        acquirer, self._acquirer = self._acquirer, None
        harvester, self._harvester = self._harvester, None
        if acquirer is not None:
            acquirer.destroy()
        if harvester is not None:
            harvester.reset()

    def _connect(self) -> None:
        self.close()
        producer = Path(self.uri.address)
        try:
            from harvesters.core import Harvester
        except ImportError as error:
            raise DeviceError(self.uri.text, "needs harvesters, which is not installed", EXTRA) from error
        self._harvester = Harvester()
        if not producer.is_file():
            finding = f'there is no GenTL producer "{producer}"'
            raise DeviceError(self.uri.text, finding, "give the manufacturer's .cti file")
        serial = self.uri.parameters.get("serial")
        try:
            self._harvester.add_file(str(producer))
            self._harvester.update()
            self._acquirer = self._harvester.create({"serial_number": serial} if serial else 0)
        except Exception as error:
            remedy = "check its cable, its power, and other programs that use it"
            raise DeviceError(self.uri.text, first_line(error, "no such camera"), remedy) from error
        if self._node("TriggerSoftware") is None:
            raise DeviceError(self.uri.text, "the camera has no software trigger", "use another camera")
        self._set_up()

    def _start(self) -> None:
        self._acquirer.start()

    def _stop(self) -> None:
        self._acquirer.stop()

    def _grab(self, limit_s: float) -> FrameGrab:
        before_s = time.time()
        try:
            self._acquirer.remote_device.node_map.TriggerSoftware.execute()
            stamp_s = mid_stamp_s(before_s)
            buffer = self._acquirer.try_fetch(timeout=limit_s)
        except Exception as error:
            raise DeviceError(self.uri.text, first_line(error), "check its cable and its power") from error
        if buffer is None:
            return FrameGrab(stamp_s=stamp_s)
        try:
            return _grabbed(buffer, stamp_s)
        finally:
            buffer.queue()

    def _node(self, name: str) -> Any:
        nodes = self._acquirer.remote_device.node_map
        return getattr(nodes, name, None) if nodes.has_node(name) else None


def _grabbed(buffer: Any, stamp_s: float) -> FrameGrab:
    if not buffer.is_complete():
        return FrameGrab(stamp_s=stamp_s, problem="packets got lost", frame_id=int(buffer.frame_id), is_late=False)
    component = buffer.payload.components[0]
    data = np.array(component.data).reshape(int(component.height), int(component.width))
    ticks_ns = int(buffer.timestamp_ns or 0)
    return FrameGrab(
        stamp_s=stamp_s,
        image=data,
        device_stamp_s=1e-9 * ticks_ns if ticks_ns else None,
        frame_id=int(buffer.frame_id),
    )
