"""`aravis:`: GigE Vision and USB3 Vision cameras through libaravis.

aravis:                        the first camera found
aravis:Vendor-Model-Serial     by its name in `ringpose capture --list`
aravis://192.168.0.5           by its address, without a search
"""

import ctypes
import errno
import ipaddress
import socket
import threading
import time
from contextlib import suppress
from ctypes import byref, c_double, c_int64, c_size_t
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.capture.cameras.aravis_library import PACKAGE, Aravis, AravisError, library
from ringpose.capture.cameras.genapi import GenApiCamera
from ringpose.capture.cameras.triggered import FrameGrab, SoftwareTriggeredCamera, mid_stamp_s
from ringpose.capture.uri import DeviceUri
from ringpose.errors import DeviceError
from ringpose.types.arrays import Array, UInt
from ringpose.wire.gvcp import PORT
from ringpose.wire.gvsp import blocks_between

BUFFERS = 4

MAX_PACKET_BYTES = 65535
"""Maximum of an IP packet; cameras have lower limits."""

_SUCCESS = 0

_NO_PACKET_SOCKET = 1
"""`ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED`: run by root, the library reads packet sockets, which receive all
traffic until their filter is set; an unrelated packet taken for a frame's then requests gigabytes: the process ends."""

_DENIED = ("access-denied", "controller privilege")
"""Parts of the library's messages; its error codes differ between versions."""

_INCOMPLETE = (2, 3, 4)
"""Timeout, missing packets, wrong packet (`ArvBufferStatus`): only part of the frame arrived."""


class AravisCamera(GenApiCamera):
    """A camera driven by libaravis; its URI has the additional parameter `packet` (bytes)."""

    PARAMETERS = (*SoftwareTriggeredCamera.PARAMETERS, "packet")

    def __init__(self, uri: DeviceUri) -> None:
        super().__init__(uri)
        self._packet_bytes = uri.whole("packet", 0, MAX_PACKET_BYTES)
        self._camera = self._device = self._stream = 0
        self._acquiring = self._is_lost = False
        self._closing: threading.Thread | None = None

    @property
    def _aravis(self) -> Aravis:
        loaded = library()
        if loaded is None:
            missing = "needs the library Aravis, which is not installed"
            raise DeviceError(self.uri.text, missing, f"apt install {PACKAGE}")
        return loaded

    def close(self) -> None:
        """Stop and close the camera; closing a lost one takes 10 s and continues in the background."""
        if self._acquiring:
            with suppress(AravisError):  # the connection may be lost already
                self._aravis.call("arv_camera_stop_acquisition", self._camera)
        instances = [instance for instance in (self._stream, self._camera) if instance]
        self._camera = self._device = self._stream = 0
        self._acquiring = False
        closing = threading.Thread(target=self._release, args=(instances,), daemon=True)
        closing.start()
        if not self._is_lost:
            closing.join()
        self._closing = closing

    def _release(self, instances: list[int]) -> None:
        for instance in instances:
            self._aravis.g_object_unref(instance)

    def warnings(self) -> tuple[str, ...]:
        """Warns if the socket buffer is smaller than a frame."""
        granted = granted_bytes()
        if not self._aravis.arv_camera_is_gv_device(self._camera) or granted is None:
            return ()
        frame_bytes = self._call("arv_camera_get_payload", self._camera)
        if granted >= frame_bytes:
            return ()
        return (f"the kernel buffers {granted} bytes of a stream, a frame has {frame_bytes}; {MORE_BUFFER}",)

    def _connect(self) -> None:
        self.close()
        if self._closing is not None:
            self._closing.join()
        self._is_lost = False
        address = self.uri.address
        check_route(address, self.uri.text)
        try:
            self._camera = self._aravis.call("arv_camera_new", address.encode() or None) or 0
        except AravisError as error:
            raise DeviceError(self.uri.text, f"no such camera: {error.message}", _NOT_FOUND) from error
        if not self._camera:
            raise DeviceError(self.uri.text, "no camera was found", _NOT_FOUND)
        self._device = self._aravis.arv_camera_get_device(self._camera)
        is_network_camera = self._aravis.arv_camera_is_gv_device(self._camera)
        if is_network_camera and not self._aravis.arv_gv_device_is_controller(self._device):
            raise self._controlled_elsewhere()
        self._aravis.arv_device_set_range_check_policy(self._device, 1)
        if is_network_camera and self._packet_bytes:
            self.set("GevSCPSPacketSize", self._packet_bytes)
        self._set_up()

    def _start(self) -> None:
        aravis = self._aravis
        if not self._stream:
            is_network_camera = aravis.arv_camera_is_gv_device(self._camera)
            if is_network_camera:
                aravis.arv_camera_gv_set_stream_options(self._camera, _NO_PACKET_SOCKET)
            try:
                self._stream = aravis.new_stream(self._camera)
            except AravisError as error:
                raise self._error(error) from error
            if is_network_camera:
                aravis.set_int_property(self._stream, "socket-buffer", 0)
                aravis.set_int_property(self._stream, "socket-buffer-size", SOCKET_BUFFER_BYTES)
            self._payload = self._call("arv_camera_get_payload", self._camera)
            for _ in range(BUFFERS):
                aravis.arv_stream_push_buffer(self._stream, aravis.arv_buffer_new_allocate(self._payload))
        self._call("arv_camera_start_acquisition", self._camera)
        self._acquiring = True

    def _stop(self) -> None:
        self._acquiring = False
        self._call("arv_camera_stop_acquisition", self._camera)
        self._drain()

    def _grab(self, limit_s: float) -> FrameGrab:
        self._drain()
        before_s = time.time()
        self._call("arv_device_execute_command", self._device, b"TriggerSoftware")
        stamp_s = mid_stamp_s(before_s)
        buffer = self._aravis.arv_stream_timeout_pop_buffer(self._stream, int(1e6 * limit_s))
        if not buffer:
            return FrameGrab(stamp_s=stamp_s)
        try:
            return self._grabbed(buffer, stamp_s)
        finally:
            self._aravis.arv_stream_push_buffer(self._stream, buffer)

    def _grabbed(self, buffer: int, stamp_s: float) -> FrameGrab:
        aravis = self._aravis
        status, frame_id = aravis.arv_buffer_get_status(buffer), int(aravis.arv_buffer_get_frame_id(buffer))
        if status != _SUCCESS:
            problem = "packets got lost" if status in _INCOMPLETE else f"a frame was bad (status {status})"
            return FrameGrab(stamp_s=stamp_s, problem=problem, frame_id=frame_id, is_late=status not in _INCOMPLETE)
        ticks_ns = int(aravis.arv_buffer_get_timestamp(buffer))
        return FrameGrab(
            stamp_s=stamp_s,
            image=self._image(buffer),
            problem="a frame was smaller than declared",
            device_stamp_s=1e-9 * ticks_ns if ticks_ns else None,
            frame_id=frame_id,
        )

    def _image(self, buffer: int) -> UInt[Array, "row column"] | None:
        """The image; None if the buffer has too few bytes."""
        aravis, size = self._aravis, c_size_t()
        width, height = aravis.arv_buffer_get_image_width(buffer), aravis.arv_buffer_get_image_height(buffer)
        data = aravis.arv_buffer_get_data(buffer, byref(size))
        kind = np.dtype(np.uint8 if aravis.arv_buffer_get_image_pixel_format(buffer) >> 16 & 0xFF == 8 else "<u2")
        image_bytes = width * height * kind.itemsize
        if not 0 < image_bytes <= size.value:
            return None
        copied = ctypes.string_at(data, image_bytes)
        return np.frombuffer(copied, dtype=kind).reshape(height, width)

    def _drain(self) -> None:
        """Discard late frames."""
        while buffer := self._aravis.arv_stream_try_pop_buffer(self._stream):
            self._aravis.arv_stream_push_buffer(self._stream, buffer)

    def _lost_between(self, last: int, frame_id: int) -> int:
        return blocks_between(last, frame_id) if frame_id <= 0xFFFF else super()._lost_between(last, frame_id)

    def _loss_remedy(self) -> str:
        granted = granted_bytes()
        if granted is not None and granted < SOCKET_BUFFER_BYTES:
            return MORE_BUFFER
        return super()._loss_remedy()

    def _node(self, name: str) -> str | None:
        return name if self._aravis.arv_device_get_feature(self._device, name.encode()) else None

    def _limits(self, node: str | None) -> tuple[float | None, float | None]:
        if node is None:
            return None, None
        kind = self._aravis.kind(self._device, node)
        if kind == "boolean":
            return 0.0, 1.0
        minimum, maximum = (c_double(), c_double()) if kind == "float" else (c_int64(), c_int64())
        self._call(f"arv_device_get_{kind}_feature_bounds", self._device, node.encode(), byref(minimum), byref(maximum))
        return float(minimum.value), float(maximum.value)

    def _value(self, node: str) -> Any:
        kind = self._aravis.kind(self._device, node)
        return self._call(f"arv_device_get_{kind}_feature_value", self._device, node.encode())

    def _text(self, feature: str) -> str:
        node = self._node(feature)
        if node is None:
            return ""
        return (self._call("arv_device_get_string_feature_value", self._device, node.encode()) or b"").decode()

    def _set_value(self, node: str, value: int | float | str) -> None:
        kind = "string" if isinstance(value, str) else self._aravis.kind(self._device, node)
        converted = value.encode() if isinstance(value, str) else float(value) if kind == "float" else round(value)
        try:
            self._aravis.call(f"arv_device_set_{kind}_feature_value", self._device, node.encode(), converted)
        except AravisError as error:
            choices = self._aravis.choices(self._device, node) if isinstance(value, str) else ()
            if not choices or value in choices:
                raise self._error(error) from error
            raise DeviceError(self.uri.text, f"{node} cannot be {value}", f"it takes {', '.join(choices)}") from error

    def _call(self, name: str, *arguments: object) -> Any:
        try:
            return self._aravis.call(name, *arguments)
        except AravisError as error:
            raise self._error(error) from error

    def _error(self, error: AravisError) -> DeviceError:
        if any(words in error.message.lower() for words in _DENIED):
            return self._controlled_elsewhere()
        if "timeout" in error.message.lower():
            self._acquiring, self._is_lost = False, True
            return DeviceError(self.uri.text, "does not answer any more", "check its cable and its power")
        return DeviceError(self.uri.text, error.message)

    def _controlled_elsewhere(self) -> DeviceError:
        remedy = "close that one, or wait 3 s if it crashed"
        return DeviceError(self.uri.text, "is controlled by another program", remedy)


_NOT_FOUND = "see ringpose capture --list; check its cable, its power, and this computer's address in its network"

SOCKET_BUFFER_BYTES = 8 << 20
"""Requested for a stream's socket; the kernel grants at most net.core.rmem_max."""

MORE_BUFFER = f"let the kernel buffer more: sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES}"

_RMEM_MAX = Path("/proc/sys/net/core/rmem_max")


def granted_bytes() -> int | None:
    """The maximum socket buffer that the kernel grants; None if it is unknown."""
    try:
        return int(_RMEM_MAX.read_text())
    except (OSError, ValueError):
        return None


def check_route(host: str, text: str) -> None:
    """Raise `DeviceError` if there is no route to an IP address, which the library would report late and unclearly."""
    try:
        address = str(ipaddress.IPv4Address(host))
    except ValueError:
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((address, PORT))
        except OSError as error:
            if error.errno not in (errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EACCES):
                raise
            remedy = "give this computer an address in the camera's network"
            raise DeviceError(text, f"there is no route to {address}", remedy) from error
