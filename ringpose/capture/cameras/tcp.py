"""`tcp://HOST:PORT`: the images of `ringpose simulate serve --images`.

The server exposes shot after shot with its own sequence of lasers; a trigger waits for the next frame with the lasers
that it names. The parameter `timeout` (s) is the time to wait for a message.
"""

import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from ringpose.capture.cameras.driver import CameraDescription, CameraDriver
from ringpose.capture.uri import DeviceUri
from ringpose.errors import DeviceError, UsageError
from ringpose.types.image import Frame
from ringpose.types.session import steps_of, written_sequence
from ringpose.wire import images as wire
from ringpose.wire.images import Greeting, Header, MalformedMessage, ServedFrame

TIMEOUT_S = 60.0
"""Default time to wait for a message: with the clock `lockstep` other clients may hold it up."""

CONNECT_S = 5.0
"""Time to wait for a connection."""


class TcpCamera(CameraDriver):
    """A client of the image server."""

    PARAMETERS = ("timeout", "secret-file")

    def __init__(self, uri: DeviceUri, secret: bytes | None = None) -> None:
        uri.reject_unknown(self.PARAMETERS)
        self.uri = uri
        self._secret = secret
        self._timeout_s = uri.number("timeout", TIMEOUT_S, 0.01, 86400.0)
        host, _, port = uri.address.rpartition(":")
        if not host or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
            raise uri.problem("has no host and port", "write it as tcp://127.0.0.1:5005")
        self._address = host.removeprefix("[").removesuffix("]"), int(port)
        self._socket: socket.socket | None = None
        self._greeting: Greeting | None = None
        self._remaining = 0
        """Frames that were asked for and have not come."""
        self._exposure_s: float | None = None
        """Exposure that this client has set since it connected."""
        self._valid_from = 0
        """Number of the first frame with the settings of this client."""
        self._payload = b""
        self.commands_lasers = False
        """Whether each trigger sets the lasers of the next frame, for all clients, instead of following the server."""

    def open(self) -> None:
        """Connect, and prove to have the secret if the server requires one."""
        self.close()
        self._remaining, self._exposure_s, self._valid_from = 0, None, 0
        try:
            self._socket = socket.create_connection(self._address, CONNECT_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            finding = f"cannot be connected: {(error.strerror or str(error)).lower()}"
            raise DeviceError(self.uri.text, finding, "start ringpose simulate serve --images") from error
        self._socket.settimeout(CONNECT_S)
        self._send({"type": "hello", "protocol": wire.PROTOCOL})
        answer = self._received()
        if answer.type == "challenge":
            if self._secret is None:
                raise DeviceError(self.uri.text, "requires its shared secret", "add ?secret-file=FILE")
            with self._malformed_messages():
                proof = wire.challenge_answer(self._secret, answer.text("nonce"))
            self._send({"type": "proof", "proof": proof})
            answer = self._received()
        with self._malformed_messages():
            self._greeting = wire.greeting_in(answer)
        self._socket.settimeout(self._timeout_s)

    def close(self) -> None:
        """End the connection; the lasers follow the server's sequence again."""
        if self._socket is not None and self.commands_lasers:
            with suppress(DeviceError, OSError):
                self._socket.settimeout(CONNECT_S)
                self.request({"type": "lasers", "mask": None})
        if self._socket is not None:
            with suppress(OSError):
                self._socket.close()
            self._socket = None

    @property
    def greeting(self) -> Greeting:
        """What the server reports about itself."""
        if self._greeting is None:
            raise DeviceError(self.uri.text, "is not connected")
        return self._greeting

    def describe(self) -> CameraDescription:
        """The served camera."""
        greeting = self.greeting
        return CameraDescription(
            name=greeting.camera_name,
            image_width=greeting.image_width,
            image_height=greeting.image_height,
            saturation_dn=greeting.saturation_dn,
        )

    def bounds(self, feature: str) -> tuple[float, float] | None:
        """The exposures that the served camera takes."""
        if feature != "ExposureTime":
            return None
        return 1e6 * self.greeting.min_exposure_s, 1e6 * self.greeting.max_exposure_s

    def set(self, feature: str, value: int | float | str) -> None:
        """Set the exposure, for all clients of the server."""
        if feature != "ExposureTime" or isinstance(value, str):
            raise DeviceError(self.uri.text, f"{feature} cannot be set to {value}", "change the scene file")
        self._expose_for(1e-6 * value)

    def arm(self, exposure_s: float | None) -> None:
        """Set the exposure and ask for the next whole shot."""
        while self._remaining:  # the rest of a shot that was not used to its end
            self._next_frame()
        if exposure_s is not None:
            self._expose_for(exposure_s)
        if not self.commands_lasers:
            self._subscribe()

    def trigger(self, lasers: int, exposure_s: float | None = None) -> Frame:
        """The next frame with these lasers."""
        sequence = self.greeting.sequence
        if self.commands_lasers:
            self._valid_from = self.request({"type": "lasers", "mask": lasers})
        elif lasers not in sequence:
            steps = written_sequence(steps_of(sequence, len(self.greeting.lasers)))
            mask = written_sequence(steps_of([lasers], len(self.greeting.lasers)))
            raise UsageError("--sequence", f"no frame of {self.uri.text} has lasers {mask}", f"it sends {steps}")
        if exposure_s is not None:
            self._expose_for(exposure_s)
        missed = 0
        for _ in range(4 * len(sequence) + self._remaining):
            frame = self._next_frame()
            missed += frame.missed
            if frame.lasers == lasers and frame.frame_id >= self._valid_from:
                return Frame(
                    image=frame.image,
                    lasers=lasers,
                    stamp_s=frame.stamp_s,
                    exposure_s=frame.exposure_s,
                    frame_id=frame.frame_id,
                    dropped=missed,
                    shot="" if self.commands_lasers else frame.shot,
                )
        raise DeviceError(self.uri.text, "sends no frames of its sequence", "a client has set its lasers; reset them")

    def request(self, header: dict[str, Any]) -> int:
        """Send a request for a setting; returns the number of the first frame with it.

        Frames that arrive before the answer are lost.
        """
        self._send(header)
        while True:
            answer = self._received()
            if answer.type == "frame":
                self._remaining = max(self._remaining - 1, 0)
            elif answer.type == "refused":
                raise DeviceError(self.uri.text, f"refuses: {answer.values.get('message')}")
            elif answer.type == "done":
                with self._malformed_messages():
                    return answer.integer("from_frame")

    def _expose_for(self, exposure_s: float) -> None:
        if exposure_s != self._exposure_s:
            self._valid_from = self.request({"type": "exposure", "exposure_s": exposure_s})
            self._exposure_s = exposure_s

    def _subscribe(self) -> None:
        frames = 1 if self.commands_lasers else len(self.greeting.sequence)
        self._send({"type": "subscribe", "frames": frames, "whole_shots": not self.commands_lasers})
        self._remaining = frames

    def _next_frame(self) -> ServedFrame:
        if not self._remaining:
            self._subscribe()
        header = self._received()
        while header.type != "frame":
            header = self._received()
        greeting = self.greeting
        with self._malformed_messages():
            frame = wire.frame_in(header, self._payload)
        if frame.image.shape != (greeting.image_height, greeting.image_width):
            height, width = frame.image.shape
            raise DeviceError(self.uri.text, f"a frame has {width} x {height} pixels, other than the greeting")
        self._remaining -= 1
        return frame

    # The connection

    def _send(self, header: dict[str, Any]) -> None:
        try:
            self._connected().sendall(wire.message(header))
        except OSError as error:
            raise self._lost(error) from error

    def _received(self) -> Header:
        """The next header; its payload is kept in `_payload`. An error of the server is raised."""
        with self._malformed_messages():
            header_bytes, payload_bytes = wire.lengths_in(self._read(wire.PREFIX.size), wire.MAX_PAYLOAD)
            header = wire.header_in(self._read(header_bytes))
            self._payload = self._read(payload_bytes)
            if header.type == "error":
                raise DeviceError(self.uri.text, f"closed the connection: {header.text('message', 500)}")
        return header

    def _read(self, size: int) -> bytes:
        data = bytearray(size)
        view, filled = memoryview(data), 0
        try:
            while filled < size:
                received = self._connected().recv_into(view[filled:])
                if not received:
                    raise ConnectionResetError("the server has closed it")
                filled += received
        except TimeoutError as error:
            finding = f"sent nothing for {self._connected().gettimeout():g} s"
            raise DeviceError(
                self.uri.text, finding, "see that it runs, and that no other client holds it up"
            ) from error
        except OSError as error:
            raise self._lost(error) from error
        return bytes(data)

    @contextmanager
    def _malformed_messages(self) -> Iterator[None]:
        """A malformed message in the block is an error of the device."""
        try:
            yield
        except MalformedMessage as problem:
            raise DeviceError(self.uri.text, f"is not an image server of this version: {problem}") from problem

    def _connected(self) -> socket.socket:
        if self._socket is None:
            raise DeviceError(self.uri.text, "is not connected")
        return self._socket

    def _lost(self, error: OSError) -> DeviceError:
        return DeviceError(self.uri.text, f"the connection was lost: {(error.strerror or str(error)).lower()}")
