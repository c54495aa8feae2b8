"""The control channel of the virtual camera (GVCP): access rights, the effects of a write, and the client's heartbeat.

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
"""IPv4 address and port."""

MIN_HEARTBEAT_MS = 500
"""Minimum heartbeat timeout, whatever the client requests."""

MAX_READ = 536
"""Maximum number of bytes in one answer."""


@runtime_checkable
class Actions(Protocol):
    """Actions of the camera that requests of a client trigger."""

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
    """Answers requests; one client has control, which alone may write and keeps its access by a heartbeat."""

    def __init__(self, registers: Registers, actions: Actions, *, keeps_lines: bool = False) -> None:
        self.registers = registers
        self.client: Client | None = None
        """The client that has control."""
        self._actions = actions
        self._keeps_lines = keeps_lines
        self._heard_s = 0.0
        """Time of the last request of the client that has control."""
        self._handlers: dict[int, Callable[[Request, Client], tuple[Status, bytes]]] = {
            Command.DISCOVERY: lambda request, client: (
                Status.SUCCESS,
                registers.read(0, bootstrap.DISCOVERY_SIZE) or b"",
            ),
            Command.READ_REGISTER: self._read_registers,
            Command.READ_MEMORY: self._read_memory,
            Command.WRITE_REGISTER: self._write_registers,
            Command.WRITE_MEMORY: self._write_memory,
        }
        self._commands = {
            features.ACQUISITION_START: actions.start,
            features.ACQUISITION_STOP: actions.stop,
            features.TRIGGER_SOFTWARE: actions.trigger,
        }

    def answer(self, request: Request, client: Client, now_s: float) -> Answer | None:
        """The answer to a request; None if it requires none."""
        self.expire(now_s)
        if client == self.client:
            self._heard_s = now_s
        if request.command == Command.RESEND:
            packets = resend_range(request.payload)
            if packets is not None and self.client is not None and client[0] == self.client[0]:
                self._actions.resend(*packets)
            return None
        handler = self._handlers.get(request.command)
        status, payload = (Status.NOT_IMPLEMENTED, b"") if handler is None else handler(request, client)
        if client == self.client:  # the request may have given control to the client
            self._heard_s = now_s
        if not request.needs_answer:
            return None
        return Answer(status=status, command=request.command, number=request.number, payload=payload)

    def expire(self, now_s: float) -> None:
        """End the control of a client whose heartbeat has timed out."""
        timeout_ms = max(self.registers[bootstrap.HEARTBEAT_TIMEOUT], MIN_HEARTBEAT_MS)
        if self.client is not None and now_s - self._heard_s > 1e-3 * timeout_ms:
            self._release()

    def _release(self) -> None:
        """End the control of the client: stop the acquisition and set the output lines low."""
        self.client = None
        self.registers[bootstrap.CONTROL_PRIVILEGE] = 0
        self._actions.stop()
        if not self._keeps_lines:
            for output in range(features.LINES):
                self.registers[features.USER_OUTPUT_VALUE + 4 * output] = 0
            self.registers[features.USER_OUTPUT_VALUE_ALL] = 0
            self._actions.outputs_changed()

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
        if len(request.words) < 2 or request.words[1] & 0xFFFF > MAX_READ:
            return Status.INVALID_PARAMETER, b""
        data = self.registers.read(request.words[0], request.words[1] & 0xFFFF)
        if data is None:
            return Status.INVALID_ADDRESS, b""
        return Status.SUCCESS, request.payload[:4] + data

    def _may_read(self, client: Client) -> bool:
        exclusive = self.registers[bootstrap.CONTROL_PRIVILEGE] & bootstrap.EXCLUSIVE
        return self.client in (None, client) or not exclusive

    def _write_registers(self, request: Request, client: Client) -> tuple[Status, bytes]:
        pairs = list(zip(request.words[::2], request.words[1::2], strict=False))
        for done, (address, value) in enumerate(pairs):
            status = self._write(address, struct.pack(">I", value), client)
            if status is not Status.SUCCESS:
                return status, written_payload(done)
        return Status.SUCCESS, written_payload(len(pairs))

    def _write_memory(self, request: Request, client: Client) -> tuple[Status, bytes]:
        if len(request.payload) < 4:
            return Status.INVALID_PARAMETER, b""
        status = self._write(request.words[0], request.payload[4:], client)
        return status, written_payload(len(request.payload) - 4)

    def _write(self, address: int, data: bytes, client: Client) -> Status:
        """Write registers and apply the effects, if the client may write there."""
        if self.client != client and (self.client is not None or address != bootstrap.CONTROL_PRIVILEGE):
            return Status.ACCESS_DENIED
        if address % 4 or len(data) % 4:
            return Status.BAD_ALIGNMENT
        words = range(address, address + len(data), 4)
        if not _READ_ONLY.isdisjoint(words):
            return Status.WRITE_PROTECT
        if not self.registers.write(address, data):
            return Status.INVALID_ADDRESS
        for word in words:
            self._apply(word, client)
        return Status.SUCCESS

    def _apply(self, address: int, client: Client) -> None:
        """Apply the effects of a write to one register."""
        registers, actions = self.registers, self._actions
        if address == bootstrap.CONTROL_PRIVILEGE:
            self.client = client
            if not registers[address] & (bootstrap.CONTROL | bootstrap.EXCLUSIVE):
                self._release()
        elif address == bootstrap.TIMESTAMP_CONTROL:
            ticks = actions.stamp_ticks()
            registers[bootstrap.TIMESTAMP_HIGH], registers[bootstrap.TIMESTAMP_LOW] = ticks >> 32, ticks
        elif address == bootstrap.STREAM_PACKET_SIZE and registers[address] & bootstrap.FIRE_TEST_PACKET:
            registers[address] &= bootstrap.PACKET_SIZE_MASK
            actions.fire_test_packet(client, registers[address])
        elif address in _RENEWED:
            registers.renew()
        elif address in self._commands:
            self._commands[address]()
        elif address in _OUTPUTS:
            self._apply_outputs(address)

    def _apply_outputs(self, address: int) -> None:
        """Apply a write to the output lines, after which the single user outputs and their mask agree."""
        registers = self.registers
        if address == features.USER_OUTPUT_VALUE_ALL:
            for output, word in enumerate(_USER_OUTPUTS):
                registers[word] = registers[address] >> output & 1
        elif address in _USER_OUTPUTS:
            mask = sum(bool(registers[word]) << output for output, word in enumerate(_USER_OUTPUTS))
            registers[features.USER_OUTPUT_VALUE_ALL] = mask
        self._actions.outputs_changed()


_RENEWED = frozenset({features.PIXEL_FORMAT, *BOUNDED, *(address + 4 for address in BOUNDED)})
"""Registers that accept only some values; the floating-point ones have two words."""

_USER_OUTPUTS = range(features.USER_OUTPUT_VALUE, features.USER_OUTPUT_VALUE + 4 * features.LINES, 4)

_OUTPUTS = frozenset(
    {
        features.USER_OUTPUT_VALUE_ALL,
        *_USER_OUTPUTS,
        *range(features.LINE_SOURCE, features.LINE_SOURCE + 4 * features.LINES, 4),
    }
)
"""Registers that determine the state of the output lines."""

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
