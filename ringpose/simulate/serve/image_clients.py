"""Connections of the image server: a queue of frames, or of JPEG pictures for browsers, and what is read from them."""

import asyncio
import ipaddress
from collections import deque
from dataclasses import dataclass, replace
from urllib.parse import parse_qs, urlsplit

import cv2
import numpy as np

from ringpose.wire import images as wire
from ringpose.wire.images import MalformedMessage, ServedFrame

MAX_QUEUED = wire.MAX_SEQUENCE
"""Frames that wait for a client; when another one comes, the oldest is skipped and counted."""

MESSAGE_S = 10.0
"""Time in which a message must arrive completely once it has begun."""

MAX_STALL_S = 60.0
"""Time after which a client that does not read is disconnected."""

JPEG_QUALITY = 85


class Client:
    """A connection to a client of the frame protocol, with its subscription and a queue of frames."""

    def __init__(self, writer: asyncio.StreamWriter, changed: asyncio.Event) -> None:
        self.writer = writer
        self._changed = changed
        self._queue: deque[ServedFrame] = deque()
        self._has_frame = asyncio.Event()
        self._remaining: int | None = 0
        """Frames that were asked for and are not queued yet; None for all that follow."""
        self._awaits_shot = False
        self._missed = 0
        self._is_sending = False
        self.is_subscribed = False

    @property
    def awaits_frames(self) -> bool:
        """Whether it asked for frames that are not exposed yet."""
        return self._remaining is None or self._remaining > 0

    def awaits_more_than(self, frames: int) -> bool:
        """Whether it asked for more frames than this number, and all earlier ones are handed to the network."""
        is_asked = self._remaining is None or self._remaining > frames
        return is_asked and not self._queue and not self._is_sending

    def subscribe(self, request: wire.Subscribe | wire.Unsubscribe) -> None:
        """Begin, extend or end the subscription."""
        if isinstance(request, wire.Unsubscribe):
            self._remaining, self.is_subscribed, self._missed = 0, False, 0
            self._queue.clear()
            return
        if not self.awaits_frames:
            self._awaits_shot = request.whole_shots
        self._remaining = None if request.frames is None else request.frames + (self._remaining or 0)
        self.is_subscribed = True

    def offer(self, frame: ServedFrame) -> None:
        """Queue a frame if it was asked for; a full queue loses its oldest one."""
        if not self.awaits_frames or (self._awaits_shot and frame.step):
            return
        self._awaits_shot = False
        if len(self._queue) == MAX_QUEUED:
            self._queue.popleft()
            self._missed += 1
        elif self._remaining is not None:
            self._remaining -= 1
        self._queue.append(frame)
        self._has_frame.set()

    async def send_frames(self) -> None:
        """Send the queued frames; ends with `TimeoutError` if the client does not read."""
        while True:
            await self._has_frame.wait()
            while self._queue:
                frame = replace(self._queue.popleft(), missed=self._missed)
                self._missed, self._is_sending = 0, True
                payload = wire.pixels(frame.image)
                self.writer.write(wire.encoded_prefix(wire.frame_header(frame), len(payload)))
                self.writer.write(payload)
                await drained(self.writer)
                self._is_sending = False
                self._changed.set()
            self._has_frame.clear()


class Viewer:
    """A connection that receives the stream of JPEG pictures; the newest one replaces one that waits."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self.writer = writer
        self._picture: bytes | None = None
        self._has_picture = asyncio.Event()

    def offer(self, picture: bytes) -> None:
        """Show a picture."""
        self._picture = picture
        self._has_picture.set()

    async def send_pictures(self) -> None:
        """Send picture after picture."""
        self.writer.write(http_head("200 OK", "multipart/x-mixed-replace; boundary=frame"))
        while True:
            await self._has_picture.wait()
            self._has_picture.clear()
            picture = self._picture or b""
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n"
            self.writer.write(head.encode() + picture + b"\r\n")
            await drained(self.writer)


async def received(reader: asyncio.StreamReader, begun: bytes = b"") -> wire.Header:
    """Read a message from a client and return its header; `begun` are the bytes that have been read already."""
    try:
        async with asyncio.timeout(MESSAGE_S):
            prefix = begun + await reader.readexactly(wire.PREFIX.size - len(begun))
            header_bytes, _ = wire.lengths_in(prefix, max_payload=0)
            return wire.header_in(await reader.readexactly(header_bytes))
    except TimeoutError:
        raise MalformedMessage(f"a message was not complete within {MESSAGE_S:g} s") from None


async def drained(writer: asyncio.StreamWriter) -> None:
    """Wait until everything is handed to the network; raises `TimeoutError` if the client does not read."""
    async with asyncio.timeout(MAX_STALL_S):
        await writer.drain()


@dataclass(frozen=True, slots=True, kw_only=True)
class BrowserRequest:
    """The parts of an HTTP GET request that matter."""

    path: str
    token: str
    host: str
    """The name by which the server was addressed."""


async def browser_request(reader: asyncio.StreamReader) -> BrowserRequest:
    """Read an HTTP request whose first word, `GET`, has been read already."""
    try:
        async with asyncio.timeout(MESSAGE_S):
            head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
    except TimeoutError:
        raise MalformedMessage(f"the HTTP request was not complete within {MESSAGE_S:g} s") from None
    except asyncio.LimitOverrunError:
        raise MalformedMessage("the HTTP request is too long") from None
    lines = head.split("\r\n")
    hosts = [line.partition(":")[2].strip() for line in lines if line.lower().startswith("host:")]
    try:
        target = urlsplit(lines[0].partition(" ")[0])
        token = parse_qs(target.query, max_num_fields=10).get("token", [""])[0]
        host = urlsplit(f"//{hosts[0]}").hostname if len(hosts) == 1 else None
    except ValueError:
        raise MalformedMessage("the HTTP request has no valid address") from None
    return BrowserRequest(path=target.path, token=token, host=host or "")


def jpeg(frame: ServedFrame) -> bytes:
    """The frame as a picture for browsers."""
    wide = frame.image.dtype.itemsize > 1
    image = (frame.image >> 4).astype(np.uint8) if wide else frame.image  # 12 bits
    return bytes(cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes())


def http(status: str, kind: str, body: bytes) -> bytes:
    """A complete HTTP response."""
    return http_head(status, kind, f"Content-Length: {len(body)}\r\n") + body


def http_head(status: str, kind: str, more: str = "") -> bytes:
    """The head of an HTTP response that must not be cached, nor embedded by other sites."""
    head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\n{more}Cache-Control: no-store\r\nConnection: close\r\n"
    return f"{head}X-Content-Type-Options: nosniff\r\nCross-Origin-Resource-Policy: same-origin\r\n\r\n".encode()


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach the host."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
