"""The control channel of the virtual camera: write access, the effects of a write, and the heartbeat of the client.

It maps a request and its sender to an answer and does not use sockets itself.
"""

import struct
from collections.abc import Callable
from typing import Protocol, runtime_checkable

from ringpose.simulate.serve import genicam as features
from ringpose.simulate.serve.genicam import BOUNDED, Registers
from ringpose.wire import gige_registers as bootstrap
from ringpose.wire.gvcp import Answer, Command, Request, Status, resend_range, written_payload

Client = tuple[str, int]
"""Address and port."""

MIN_HEARTBEAT_MS = 500
"""Minimum heartbeat timeout, whatever the client requests."""

MAX_READ = 536
"""Maximum number of bytes in one answer."""


@runtime_checkable
class Actions(Protocol):
    """Actions of the camera that a write or request triggers."""

    def start(self) -> None:
        """Start the acquisition, triggered or free-running."""

    def stop(self) -> None:
        """Stop the acquisition."""

    def trigger(self) -> None:
        """Expose a frame."""

    def resend(self, block: int, first: int, last: int) -> None:
        """Send packets of a frame again."""

    def fire_test_packet(self, client: Client, size: int) -> None:
        """Send one packet of this size, which tests whether the network transmits it."""

    def outputs_changed(self) -> None:
        """Apply the registers of the output lines after a write."""

    def stamp_ticks(self) -> int:
        """The time stamp counter of the camera."""


class Control:
    """Control by one client, which alone may write and keeps its access by a heartbeat."""

    def __init__(self, registers: Registers, actions: Actions, *, keeps_lines: bool = False) -> None:
        self.registers = registers
        self._actions = actions
        self._keeps_lines = keeps_lines
        self._client: Client | None = None
        self._heard_s = 0.0
        self._answers: dict[int, Callable[[Request, Client], tuple[Status, bytes]]] = {
            Command.DISCOVERY: self._discovery,
            Command.READ_REGISTER: self._read_registers,
            Command.READ_MEMORY: self._read_memory,
            Command.WRITE_REGISTER: self._write_registers,
            Command.WRITE_MEMORY: self._write_memory,
        }

    @property
    def client(self) -> Client | None:
        """The client that has control."""
        return self._client

    def answer(self, request: Request, client: Client, now_s: float) -> Answer | None:
        """The answer to a request; None if there is none."""
        self.expire(now_s)
        if client == self._client:
            self._heard_s = now_s
        if request.command == Command.RESEND:
            self._resend(request, client)
            return None
        handler = self._answers.get(request.command)
        status, payload = (Status.NOT_IMPLEMENTED, b"") if handler is None else handler(request, client)
        if self._client == client:
            self._heard_s = now_s
        if not request.needs_answer:
            return None
        return Answer(status=status, command=request.command, number=request.number, payload=payload)

    def expire(self, now_s: float) -> None:
        """End the control of a client whose heartbeat has timed out."""
        timeout_ms = max(self.registers[bootstrap.HEARTBEAT_TIMEOUT], MIN_HEARTBEAT_MS)
        if self._client is not None and now_s - self._heard_s > 1e-3 * timeout_ms:
            self._release()

    def _release(self) -> None:
        self._client = None
        self.registers[bootstrap.CONTROL_PRIVILEGE] = 0
        self._actions.stop()
        if not self._keeps_lines:
            for output in range(features.LINES):
                self.registers[features.USER_OUTPUT_VALUE + 4 * output] = 0
            self.registers[features.USER_OUTPUT_VALUE_ALL] = 0
            self._actions.outputs_changed()

    def _discovery(self, request: Request, client: Client) -> tuple[Status, bytes]:
        return Status.SUCCESS, self.registers.read(0, bootstrap.DISCOVERY_SIZE) or b""

    def _read_registers(self, request: Request, client: Client) -> tuple[Status, bytes]:
        if not self._may_read(client):
            return Status.ACCESS_DENIED, b""
        values = [self.registers.read(address, 4) for address in request.words]
        if not values or None in values:
            return Status.INVALID_ADDRESS, b""
        return Status.SUCCESS, b"".join(value for value in values if value is not None)

    def _read_memory(self, request: Request, client: Client) -> tuple[Status, bytes]:
        if not self._may_read(client):
            return Status.ACCESS_DENIED, b""
        if len(request.words) < 2:
            return Status.INVALID_PARAMETER, b""
        address, size = request.words[0], request.words[1] & 0xFFFF
        if size > MAX_READ:
            return Status.INVALID_PARAMETER, b""
        data = self.registers.read(address, size)
        if data is None:
            return Status.INVALID_ADDRESS, b""
        return Status.SUCCESS, request.payload[:4] + data

    def _write_registers(self, request: Request, client: Client) -> tuple[Status, bytes]:
        pairs = list(zip(request.words[::2], request.words[1::2], strict=False))
        for done, (address, value) in enumerate(pairs):
            status = self._written(address, struct.pack(">I", value), client)
            if status is not Status.SUCCESS:
                return status, written_payload(done)
        return Status.SUCCESS, written_payload(len(pairs))

    def _write_memory(self, request: Request, client: Client) -> tuple[Status, bytes]:
        if len(request.payload) < 4:
            return Status.INVALID_PARAMETER, b""
        status = self._written(request.words[0], request.payload[4:], client)
        return status, written_payload(len(request.payload) - 4)

    def _may_read(self, client: Client) -> bool:
        exclusive = self.registers[bootstrap.CONTROL_PRIVILEGE] & bootstrap.EXCLUSIVE
        return self._client in (None, client) or not exclusive

    def _written(self, address: int, data: bytes, client: Client) -> Status:
        if self._client != client and (self._client is not None or address != bootstrap.CONTROL_PRIVILEGE):
            return Status.ACCESS_DENIED
        if address % 4 or len(data) % 4:
            return Status.BAD_ALIGNMENT
        words = range(address, address + len(data), 4)
        if not _READ_ONLY.isdisjoint(words):
            return Status.WRITE_PROTECT
        if not self.registers.write(address, data):
            return Status.INVALID_ADDRESS
        for word in words:
            self._act(word, client)
        return Status.SUCCESS

    def _act(self, address: int, client: Client) -> None:
        """Apply the effects of a write."""
        registers, actions = self.registers, self._actions
        if address == bootstrap.CONTROL_PRIVILEGE:
            self._client = client
            if not registers[address] & (bootstrap.CONTROL | bootstrap.EXCLUSIVE):
                self._release()
        elif address == bootstrap.TIMESTAMP_CONTROL:
            ticks = actions.stamp_ticks()
            registers[bootstrap.TIMESTAMP_HIGH], registers[bootstrap.TIMESTAMP_LOW] = ticks >> 32, ticks
        elif address == bootstrap.STREAM_PACKET_SIZE and registers[address] & bootstrap.FIRE_TEST_PACKET:
            size = registers[address] & bootstrap.PACKET_SIZE_MASK
            registers[address] = size
            actions.fire_test_packet(client, size)
        elif address in _RENEWED:
            registers.renew()
        elif address in (features.ACQUISITION_START, features.ACQUISITION_STOP, features.TRIGGER_SOFTWARE):
            {
                features.ACQUISITION_START: actions.start,
                features.ACQUISITION_STOP: actions.stop,
                features.TRIGGER_SOFTWARE: actions.trigger,
            }[address]()
        else:
            self._outputs_written(address)

    def _outputs_written(self, address: int) -> None:
        """Keep the single registers of the outputs and their mask equal."""
        registers, first = self.registers, features.USER_OUTPUT_VALUE
        outputs = range(features.LINES)
        if address == features.USER_OUTPUT_VALUE_ALL:
            for output in outputs:
                registers[first + 4 * output] = registers[address] >> output & 1
        elif first <= address < first + 4 * features.LINES:
            registers[features.USER_OUTPUT_VALUE_ALL] = sum(bool(registers[first + 4 * k]) << k for k in outputs)
        elif not features.LINE_SOURCE <= address < features.LINE_SOURCE + 4 * features.LINES:
            return
        self._actions.outputs_changed()

    def _resend(self, request: Request, client: Client) -> None:
        wanted = resend_range(request.payload)
        if wanted is not None and client[0] == (self._client or ("", 0))[0]:
            self._actions.resend(*wanted)


_RENEWED = frozenset({features.PIXEL_FORMAT, *BOUNDED, *(address + 4 for address in BOUNDED)})
"""Registers with restricted values."""

_READ_ONLY = frozenset(
    {
        features.WIDTH,
        features.HEIGHT,
        features.PAYLOAD_SIZE,
        features.MISSED_TRIGGERS,
        features.TEMPERATURE,
        *range(0, bootstrap.USER_DEFINED_NAME, 4),
        *range(bootstrap.XML_URL, bootstrap.HEARTBEAT_TIMEOUT, 4),
    }
)
"""Registers of device information and status."""
