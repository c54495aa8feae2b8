"""A relay board that switches the lasers: laser i is the relay `settings.relays[i]`.

The settings come from the URI and are passed to the watchdog process as one line of JSON. The board is driven in that
process, so this module imports no heavy package.
"""

import json
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import TypeVar

from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError
from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec
from ringpose.wire.numato import NumatoCodec
from ringpose.wire.relay_codec import Command, Pulse, Read, RelayCodec, Switch, SwitchRow, WireError

Answer = TypeVar("Answer")

ANSWER_LIMIT_S = 0.25

TRIES = 3
"""Attempts at one command."""

PAUSE_S = 0.02
"""Pause between two attempts to switch everything off."""


class _NoAnswer(DeviceError):
    """The board has not sent a single byte."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RelaySettings:
    """One board: its port, its protocol, its relays (from 0) that feed the lasers, and the limits of the watchdog."""

    scheme: str
    port: str
    relays: tuple[int, ...]
    baud: int = 9600
    codec_parameters: Mapping[str, str | int] = field(default_factory=dict)
    read_back: str = "yes"
    """Whether to read the state of the relays: `yes`, `no`, or `try`: no longer if the board does not answer once."""
    pulse_s: float | None = None
    """Switch on by the board's timed pulse of this length; None to switch on until switched off."""
    repeat_s: float | None = None
    """Interval of repeating what is on, for a board with its own watchdog."""
    opening_s: float = 0.0
    """Wait after opening the port: an Arduino restarts."""
    heartbeat_s: float = 1.0
    """Switch off after this long without a command while a laser is on."""
    longest_on_s: float = 5.0
    """Switch off if a laser is on for this long."""
    interlock: str = ""
    """The input that must be asserted: `cts`, `dsr`, or empty for none."""

    @property
    def codec(self) -> RelayCodec:
        """The protocol of the board."""
        return CODECS[self.scheme](**self.codec_parameters)

    @property
    def on_limit_s(self) -> float:
        """Maximum time on: the limit of the watchdog, or the board's pulse unless it is repeated."""
        pulse_ends = self.pulse_s is not None and self.repeat_s is None
        return min(self.longest_on_s, self.pulse_s) if pulse_ends and self.pulse_s else self.longest_on_s

    def line(self) -> str:
        """The settings as one line of JSON."""
        return json.dumps(asdict(self))


class RelayBoard:
    """A board at a port that is open already."""

    def __init__(self, settings: RelaySettings, port: SerialPort) -> None:
        self.on_mask = 0
        """The mask commanded last: bit i is laser i."""
        self._settings = settings
        self._codec = settings.codec
        self._port = port
        self._reads = settings.read_back if self._codec.reports else "no"

    def set_mask(self, lasers: int) -> None:
        """Switch on exactly these lasers; those that go off are switched before those that come on."""
        _retried(lambda: self._off(self.on_mask & ~lasers))
        self.on_mask &= lasers
        for laser in _members(lasers & ~self.on_mask):
            self.on_mask |= 1 << laser
            _retried(partial(self._on, laser))

    def repeat(self) -> None:
        """Repeat the commands for the lasers that are on."""
        for laser in _members(self.on_mask):
            self._on(laser)

    def all_off(self) -> None:
        """Switch every laser off, whatever was commanded before, in up to three attempts.

        A board that cannot report its state receives the command twice.
        """
        problems: list[DeviceError] = []
        for attempt in range(TRIES):
            time.sleep(PAUSE_S * min(attempt, 1))
            try:
                self._off((1 << len(self._settings.relays)) - 1)
                left_on = self._read_mask(0)
            except DeviceError as error:
                problems.append(error)
                continue
            if left_on is None and attempt == 0:
                continue
            if not left_on:
                self.on_mask = 0
                return
            problems.append(DeviceError(self._port.name, f"reports lasers on (mask {left_on}) after switching off"))
        raise problems[-1]

    def read_mask(self) -> int | None:
        """The mask that the board reports; None if it cannot report."""
        return _retried(lambda: self._read_mask(self.on_mask))

    def _read_mask(self, expected: int) -> int | None:
        """The reported mask; read again if it is not as expected, because the first answer may be stale."""
        if self._reads == "no":
            return None
        reported = self._reported()
        return self._reported() if reported not in (expected, None) else reported

    def _reported(self) -> int | None:
        """The reported mask; with `read_back=try`, the first read decides whether later ones are made."""
        try:
            relays = self._exchange(Read(max(self._settings.relays) + 1))
        except _NoAnswer:
            if self._reads != "try":
                raise
            self._reads = "no"
            return None
        self._reads = "yes"
        return sum(1 << laser for laser, relay in enumerate(self._settings.relays) if relays >> relay & 1)

    def _on(self, laser: int) -> None:
        relay, pulse_s = self._settings.relays[laser], self._settings.pulse_s
        self._exchange(Switch(relay, True) if pulse_s is None else Pulse(relay, pulse_s))

    def _off(self, lasers: int) -> None:
        """Switch lasers off; each relay is commanded even if another one fails."""
        problems = []
        for command in self._off_commands(lasers):
            try:
                self._exchange(command)
            except DeviceError as error:
                problems.append(error)
        if problems:
            raise problems[0]

    def _off_commands(self, lasers: int) -> list[Command]:
        """One command for adjacent relays if the board can switch them together; otherwise one for each."""
        relays = sorted(self._settings.relays[laser] for laser in _members(lasers))
        is_row = len(relays) > 1 and relays[-1] - relays[0] == len(relays) - 1
        if is_row and self._codec.switches_rows:
            return [SwitchRow(relays[0], len(relays), 0)]
        return [Switch(relay, False) for relay in relays]

    def _exchange(self, command: Command) -> int:
        received = self._port.exchange(
            self._codec.request(command), lambda received: self._codec.is_whole(command, received), ANSWER_LIMIT_S
        )
        if not self._codec.is_whole(command, received):
            remedy = "check the board, its scheme in --lasers, its power"
            if not received:
                raise _NoAnswer(self._port.name, "does not answer", remedy)
            raise DeviceError(self._port.name, f"sends an incomplete answer ({received!r})", remedy)
        try:
            return self._codec.on_mask(command, received)
        except WireError as error:
            raise DeviceError(self._port.name, str(error), "check that --lasers names the right board") from error


def _retried(act: Callable[[], Answer]) -> Answer:
    """The result of an act, repeated if it fails, for example because a byte was lost on a long line."""
    for _ in range(TRIES - 1):
        with suppress(DeviceError):  # no pause: the wait for an answer may have ended because a process ends
            return act()
    return act()


def _members(lasers: int) -> list[int]:
    return [laser for laser in range(lasers.bit_length()) if lasers >> laser & 1]


CODECS = {"lcus": LcusCodec, "numato": NumatoCodec, "modbus": ModbusCodec, "ascii": AsciiCodec}


def settings_of_line(line: str) -> RelaySettings:
    """The settings that `RelaySettings.line` has written."""
    values = json.loads(line)
    return RelaySettings(**{**values, "relays": tuple(values["relays"])})
