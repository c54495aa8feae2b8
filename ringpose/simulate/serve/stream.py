"""The stream channel of the virtual camera: frames as datagrams at the rate of a link, with injected losses."""

import socket
import threading
import time
from collections import OrderedDict
from contextlib import suppress

import numpy as np

from ringpose.wire.gvsp import StreamedFrame

LINK_BYTES_PER_S = 125e6
"""Gigabit Ethernet."""

KEPT_FRAMES = 4
"""Number of frames whose packets can be sent again."""

_BURST_BYTES = 16_000
"""Bytes sent without delay: less than common receive buffers."""


class Stream:
    """Sends frames from one address to one client."""

    def __init__(self, address: str, loss: float = 0.0, *, resends: bool = True, seed: int = 1) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((address, 0))
        self._loss = loss
        self._resends = resends
        self._generator = np.random.default_rng(seed)
        self._client: tuple[str, int] | None = None
        self._kept: OrderedDict[int, StreamedFrame] = OrderedDict()
        self._lock = threading.Lock()
        self.lost_packets = 0
        self.resent_packets = 0

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
            self.resent_packets += len(numbers)
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
