"""A virtual GigE Vision camera: its sockets, its threads, its exposures, and the stream of its frames."""

import ipaddress
import queue
import select
import socket
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ringpose.errors import DeviceError
from ringpose.simulate.serve import genicam as features
from ringpose.simulate.serve.control import Client, Control
from ringpose.simulate.serve.genicam import TICKS_PER_S, Identity, Registers
from ringpose.types.arrays import Array, UInt
from ringpose.wire import gige_registers as bootstrap
from ringpose.wire.gvcp import PORT, answer_bytes, request_in
from ringpose.wire.gvsp import UDP_OVERHEAD, Leader, PixelFormat, StreamedFrame, block_after, piece_size

MIN_PACKET, MAX_PACKET = 576, 16260
"""Bounds of the packet size of the stream, in bytes."""

_POLL_S = 0.05
"""Interval at which a waiting thread checks whether to stop."""

LINK_BYTES_PER_S = 125e6
"""Gigabit Ethernet."""

KEPT_FRAMES = 4
"""Number of frames whose packets can be sent again."""

_BURST_BYTES = 16_000
"""Bytes sent without delay: less than common receive buffers."""


ExposedImage = Callable[[float, float, float, Literal[8, 12]], tuple[UInt[Array, "row column"], Mapping[str, Any]]]
"""Makes the grey values of an exposure that has just ended, and its log record.

The arguments are the exposure's start (monotonic clock) and duration in seconds, the gain in dB, and the bit depth.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraFaults:
    """Injected faults of the camera."""

    loss: float = 0.0
    """Share of the packets of the stream that are lost."""
    resends: bool = True
    """Whether lost packets are sent again on request."""
    dies_after: int | None = None
    """Number of frames after which it stops answering."""
    keeps_lines: bool = False
    """Whether its output lines keep their state when the client times out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Exposure:
    began_s: float
    """Monotonic clock."""
    stopped: threading.Event
    """Set when its acquisition has ended."""


class ServedCamera:
    """A camera at a loopback address; a context manager that serves inside its block.

    `lines_changed` is called with the mask of the output lines that are high and the time (monotonic clock), `log` with
    the log record of each frame.
    """

    def __init__(
        self,
        identity: Identity,
        exposed_image: ExposedImage,
        faults: CameraFaults | None = None,
        lines_changed: Callable[[int, float], None] | None = None,
        log: Callable[[Mapping[str, Any]], None] | None = None,
    ) -> None:
        self.identity = identity
        self.registers = Registers(identity)
        self._exposed_image = exposed_image
        self._faults = faults or CameraFaults()
        self._lines_changed = lines_changed
        self._log = log
        self._control = Control(self.registers, self, keeps_lines=self._faults.keeps_lines)
        self._triggers: queue.Queue[_Exposure] = queue.Queue(maxsize=1)
        self._exposed_until_s = 0.0
        self._stopped = threading.Event()
        """Event of the current acquisition; each has its own, so that frames of an earlier one are dropped."""
        self._stopped.set()
        self._ended = threading.Event()
        self._block = 0
        self._frames = 0
        self._threads: list[threading.Thread] = []

    @property
    def is_dead(self) -> bool:
        """Whether the fault `dies_after` has occurred."""
        return self._faults.dies_after is not None and self._frames >= self._faults.dies_after

    def __enter__(self) -> "ServedCamera":
        address = self.identity.address
        self._sockets = [_bound(address, shared=False), _bound("255.255.255.255", shared=True)]
        self.stream = Stream(address, self._faults.loss, resends=self._faults.resends)
        for work in (self._serve_control, self._expose):
            thread = threading.Thread(target=work, name=f"camera {address} {work.__name__}", daemon=True)
            self._threads.append(thread)
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._stopped.set()
        for thread in self._threads:
            thread.join()
        for each in self._sockets:
            each.close()
        self.stream.close()

    def start(self) -> None:
        """See `Actions`; the stream goes to the address in the stream registers."""
        self._stopped.set()
        self.registers[features.MISSED_TRIGGERS] = 0
        address = str(ipaddress.IPv4Address(self.registers[bootstrap.STREAM_ADDRESS]))
        self.stream.open((address, self.registers[bootstrap.STREAM_PORT] & 0xFFFF))
        with suppress(queue.Empty):
            self._triggers.get_nowait()
        self._exposed_until_s = 0.0
        self._stopped = threading.Event()

    def stop(self) -> None:
        """See `Actions`."""
        self._stopped.set()
        self.stream.shut()

    def trigger(self) -> None:
        """See `Actions`; a trigger during an exposure is counted and ignored."""
        now_s = time.monotonic()
        if self._stopped.is_set() or not self.registers[features.TRIGGER_MODE]:
            return
        try:
            if now_s < self._exposed_until_s:
                raise queue.Full
            self._triggers.put_nowait(_Exposure(began_s=now_s, stopped=self._stopped))
            self._exposed_until_s = now_s + self._exposure_s
        except queue.Full:
            self.registers[features.MISSED_TRIGGERS] += 1

    def resend(self, block: int, first: int, last: int) -> None:
        """See `Actions`."""
        self.stream.resend(block, first, last)

    def fire_test_packet(self, client: Client, size: int) -> None:
        """See `Actions`."""
        port = self.registers[bootstrap.STREAM_PORT] & 0xFFFF
        self.stream.send_bytes(bytes(max(size - UDP_OVERHEAD, 8)), (client[0], port))

    def outputs_changed(self) -> None:
        """See `Actions`; line k has the state of the user output that is its source."""
        if self._lines_changed is None:
            return
        outputs = self.registers[features.USER_OUTPUT_VALUE_ALL]
        sources = [self.registers[features.LINE_SOURCE + 4 * line] for line in range(features.LINES)]
        high = sum(1 << line for line, source in enumerate(sources) if source and outputs >> (source - 1) & 1)
        self._lines_changed(high, time.monotonic())

    def stamp_ticks(self) -> int:
        """See `Actions`."""
        return time.monotonic_ns()

    @property
    def _exposure_s(self) -> float:
        return 1e-6 * self.registers.number(features.EXPOSURE_TIME, features.EXPOSURE_BOUNDS_US)

    def _serve_control(self) -> None:
        while not self._ended.is_set():
            ready, _, _ = select.select(self._sockets, [], [], _POLL_S)
            datagrams = [each.recvfrom(2048) for each in ready]
            if self.is_dead:
                continue
            self._control.expire(time.monotonic())
            for datagram, client in datagrams:
                request = request_in(datagram)
                answer = None if request is None else self._control.answer(request, client, time.monotonic())
                if answer is not None:
                    with suppress(OSError):  # the client's address is not reachable any more
                        self._sockets[0].sendto(answer_bytes(answer), client)

    def _expose(self) -> None:
        while not self._ended.is_set():
            exposure = self._next_exposure()
            if exposure is None or self.is_dead:
                continue
            exposure_s = self._exposure_s
            if exposure.stopped.wait(max(0.0, exposure.began_s + exposure_s - time.monotonic())):
                continue
            self._send(exposure.began_s, exposure_s)
            if self.registers[features.ACQUISITION_MODE] == features.SINGLE_FRAME:
                exposure.stopped.set()

    def _next_exposure(self) -> _Exposure | None:
        """The next exposure; None if there is none within the polling interval."""
        stopped = self._stopped
        if self.registers[features.TRIGGER_MODE] or stopped.is_set():
            try:
                return self._triggers.get(timeout=_POLL_S)
            except queue.Empty:
                return None
        due_s = self._exposed_until_s or time.monotonic()
        wait_s = due_s - time.monotonic()
        if stopped.wait(min(max(0.0, wait_s), _POLL_S)) or wait_s > _POLL_S:
            return None
        rate_hz = self.registers.number(features.FRAME_RATE, features.FRAME_RATE_BOUNDS_HZ)
        self._exposed_until_s = max(due_s, time.monotonic()) + 1.0 / rate_hz
        return _Exposure(began_s=time.monotonic(), stopped=stopped)

    def _send(self, began_s: float, exposure_s: float) -> None:
        """Send the frame of an exposure that has just ended, and log it."""
        pixel_format = self.registers.pixel_format
        gain_db = self.registers.number(features.GAIN, features.GAIN_BOUNDS_DB)
        bits: Literal[8, 12] = 8 if pixel_format is PixelFormat.MONO8 else 12
        image, record = self._exposed_image(began_s, exposure_s, gain_db, bits)
        self._block = block_after(self._block)
        if self._log is not None:
            self._log({"frame_id": self._block, "began_s": began_s, "exposure_s": exposure_s, **record})
        self._frames += 1
        packet_size = min(self.registers[bootstrap.STREAM_PACKET_SIZE] & bootstrap.PACKET_SIZE_MASK, MAX_PACKET)
        height, width = image.shape
        self.stream.send(
            StreamedFrame(
                block=self._block,
                leader=Leader(
                    stamp_ticks=int(began_s * TICKS_PER_S), pixel_format=pixel_format, width=width, height=height
                ),
                data=memoryview(image.astype("<u2" if bits > 8 else np.uint8, copy=False).tobytes()),
                piece_size=piece_size(max(packet_size, MIN_PACKET)),
            )
        )


class Stream:
    """Sends frames from one address to one client, at the rate of a link, with injected losses."""

    def __init__(self, address: str, loss: float = 0.0, *, resends: bool = True) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((address, 0))
        self._loss = loss
        self._resends = resends
        self._generator = np.random.default_rng(1)
        self._client: tuple[str, int] | None = None
        self._kept: OrderedDict[int, StreamedFrame] = OrderedDict()
        self._lock = threading.Lock()
        self.lost_packets = 0

    def open(self, client: tuple[str, int]) -> None:
        """Send the following frames to this client."""
        with self._lock:
            self._client = client
            self._kept.clear()

    def shut(self) -> None:
        """Stop sending."""
        with self._lock:
            self._client = None

    def send(self, frame: StreamedFrame) -> None:
        """Send all packets of a frame at the rate of the link."""
        with self._lock:
            client = self._client
            self._kept[frame.block] = frame
            while len(self._kept) > KEPT_FRAMES:
                self._kept.popitem(last=False)
        burst = max(_BURST_BYTES // frame.piece_size, 1)
        began_s, sent_bytes = time.perf_counter(), 0
        for first in range(0, frame.packets, burst):
            numbers = range(first, min(first + burst, frame.packets))
            if self._client is not client:
                break
            self._send_packets(frame, numbers)
            sent_bytes += len(numbers) * frame.piece_size
            time.sleep(max(0.0, began_s + sent_bytes / LINK_BYTES_PER_S - time.perf_counter()))

    def resend(self, block: int, first: int, last: int) -> None:
        """Send packets of a frame again if it is still kept."""
        with self._lock:
            frame = self._kept.get(block)
        if frame is not None and self._resends:
            numbers = range(first, min(last + 1, frame.packets))
            self._send_packets(frame, numbers)

    def send_bytes(self, datagram: bytes, client: tuple[str, int]) -> None:
        """Send a datagram; one that cannot be sent is lost."""
        with suppress(OSError):
            self._socket.sendto(datagram, client)

    def close(self) -> None:
        """Close the socket."""
        self.shut()
        self._socket.close()

    def _send_packets(self, frame: StreamedFrame, numbers: range) -> None:
        client = self._client
        if client is None:
            return
        lost = self._generator.random(len(numbers)) < self._loss if self._loss else np.zeros(len(numbers), bool)
        self.lost_packets += int(lost.sum())
        for number, is_lost in zip(numbers, lost.tolist(), strict=True):
            if not is_lost:
                self.send_bytes(frame.datagram(number), client)


def _bound(address: str, *, shared: bool) -> socket.socket:
    """A socket at the GVCP port; a shared one may be bound by several cameras, which receive broadcasts."""
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    if shared:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((address, PORT))
    except OSError as error:
        bound.close()
        finding = (error.strerror or str(error)).lower()
        remedy = "another camera is served there; choose another address, such as 127.0.0.2"
        raise DeviceError(f"camera {address}", f"port {PORT} cannot be opened: {finding}", remedy) from error
    return bound
