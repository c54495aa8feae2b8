"""Modbus-RTU relay boards (Waveshare, LC-tech): coils by functions 01, 05 and 0F, and the timed pulse of Waveshare.

The pulse is function 05 at address 0200h + relay with the time in tenths of a second: the board switches off by itself.
"""

from dataclasses import dataclass

from ringpose.wire.relay_codec import Command, Pulse, Read, Refused, Switch, SwitchRow, WireError

READ_COILS, WRITE_COIL, WRITE_COILS = 0x01, 0x05, 0x0F

FLASH_ON = 0x0200
"""Address of the timed pulse of relay 0."""

PULSE_STEP_S = 0.1

_EXCEPTION = 0x80
"""Bit set in the function code of an exception response."""

_REASONS = {1: "illegal function", 2: "illegal address: the board has no such relay", 3: "illegal value"}


@dataclass(frozen=True, slots=True)
class ModbusCodec:
    """A board with a unit number; clones may count relays from another base, or use another value for on."""

    unit: int = 1
    first: int = 0
    on_value: int = 0xFF00
    reports: bool = True
    switches_rows: bool = True

    def request(self, command: Command) -> bytes:
        """The bytes of a command: one Modbus frame."""
        if isinstance(command, Read):
            return self._frame(READ_COILS, _words(self.first, command.count))
        if isinstance(command, SwitchRow):
            values = command.on_mask.to_bytes(_value_bytes(command.count), "little")
            head = _words(self.first + command.first, command.count)
            return self._frame(WRITE_COILS, head + bytes([len(values)]) + values)
        if isinstance(command, Pulse):
            steps = round(command.duration_s / PULSE_STEP_S)
            return self._frame(WRITE_COIL, _words(FLASH_ON + self.first + command.relay, steps))
        return self._frame(WRITE_COIL, _words(self.first + command.relay, self.on_value if command.on else 0))

    def is_whole(self, command: Command, received: bytes) -> bool:
        """Whether the response has the length that its function code requires; an exception response has five bytes."""
        if len(received) < 5:
            return False
        return bool(received[1] & _EXCEPTION) or len(received) >= _response_length(command)

    def on_mask(self, command: Command, received: bytes) -> int:
        """The mask of the coils that are on according to a response; 0 for a write, which is repeated."""
        if len(received) < 5 or crc(received[:-2]) != received[-2:]:
            raise WireError(f"answered {received.hex(' ')}, which is not a valid frame")
        request = self.request(command)
        if len(received) == 5 and received[:2] == bytes([self.unit, request[1] | _EXCEPTION]):
            reason = _REASONS.get(received[2], f"exception {received[2]}")
            raise Refused(f"refused {request.hex(' ')}: {reason}")
        head = request[:2] + bytes([_value_bytes(command.count)]) if isinstance(command, Read) else request[:6]
        if len(received) != _response_length(command) or not received.startswith(head):
            raise WireError(f"answered {received.hex(' ')} to {request.hex(' ')}")
        if not isinstance(command, Read):
            return 0
        return int.from_bytes(received[3:-2], "little") & ((1 << command.count) - 1)

    def commands(self, received: bytes) -> tuple[list[Command], bytes]:
        """The complete frames for this unit, and the bytes of an unfinished one; other bytes are skipped one by one."""
        commands: list[Command] = []
        position = 0
        while len(received) - position >= 8:
            length = 9 + received[position + 6] if received[position + 1] == WRITE_COILS else 8
            frame = received[position : position + length]
            if frame[0] == self.unit and len(frame) < length and length < 16:
                break
            command = self._command(frame)
            if command is not None:
                commands.append(command)
            position += length if command is not None else 1
        return commands, received[position:]

    def answer(self, command: Command, on_mask: int, relays: int) -> bytes:
        """The response of a board: the echo of a write, or the states of the coils that are read."""
        if isinstance(command, Read):
            values = (on_mask & ((1 << command.count) - 1)).to_bytes(_value_bytes(command.count), "little")
            return self._frame(READ_COILS, bytes([len(values)]) + values)
        request = self.request(command)
        return self._frame(request[1], request[2:6])

    def _command(self, frame: bytes) -> Command | None:
        if frame[0] != self.unit or crc(frame[:-2]) != frame[-2:]:
            return None
        address, value = int.from_bytes(frame[2:4]), int.from_bytes(frame[4:6])
        if frame[1] == READ_COILS:
            return Read(value)
        if frame[1] == WRITE_COILS:
            return SwitchRow(address - self.first, value, int.from_bytes(frame[7:-2], "little"))
        if frame[1] != WRITE_COIL:
            return None
        if address >= FLASH_ON:
            return Pulse(address - FLASH_ON - self.first, value * PULSE_STEP_S)
        return Switch(address - self.first, value == self.on_value)

    def _frame(self, function: int, content: bytes) -> bytes:
        body = bytes([self.unit, function]) + content
        return body + crc(body)


def _response_length(command: Command) -> int:
    """Bytes of a response that is not an exception: the states of the coils, or the first six bytes of a write."""
    return 5 + _value_bytes(command.count) if isinstance(command, Read) else 8


def _value_bytes(coils: int) -> int:
    return (coils + 7) // 8


def crc(body: bytes) -> bytes:
    """The Modbus checksum: CRC-16 with the reflected polynomial A001h, low byte first."""
    value = 0xFFFF
    for byte in body:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
    return value.to_bytes(2, "little")


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2) for value in values)
