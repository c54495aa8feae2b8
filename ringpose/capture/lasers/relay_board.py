"""Lasers as relays of a board: laser i is the relay `settings.relays[i]`. Runs in the guard; nothing heavy here.

How a relay board is spoken to and guarded: what the URI says, handed to the guard as one line of JSON.
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
"""Attempts to switch, or to be understood at all."""

PAUSE_S = 0.02
"""Between two attempts."""


class _Silent(DeviceError):
    """Not one byte."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RelaySettings:
    """One board: its port, its bytes, which of its relays (from 0) feed the lasers, and when the guard steps in."""

    scheme: str
    port: str
    relays: tuple[int, ...]
    baud: int = 9600
    codec_parameters: Mapping[str, str | int] = field(default_factory=dict)
    read_back: str = "yes"
    """`yes`; `no`; or `try`: unless the board is silent when it is first asked."""
    pulse_s: float | None = None
    """Light by the board's own timed pulse of this length."""
    repeat_s: float | None = None
    """Say again what is on, for a board that switches off when it hears nothing."""
    opening_s: float = 0.0
    """Wait after opening: an Arduino starts anew."""
    heartbeat_s: float = 1.0
    """Off if nothing was heard for this long while a laser is on."""
    longest_on_s: float = 5.0
    """Off if a laser is on for longer than this."""
    interlock: str = ""
    """The input that must be closed: `cts`, `dsr`, or none."""

    @property
    def codec(self) -> RelayCodec:
        """The bytes of the board."""
        codec: RelayCodec = CODECS[self.scheme](**self.codec_parameters)
        return codec

    @property
    def on_limit_s(self) -> float:
        """How long a laser stays on at most: the guard's limit, or the board's own pulse if nothing prolongs it."""
        pulse_ends = self.pulse_s is not None and self.repeat_s is None
        return min(self.longest_on_s, self.pulse_s) if pulse_ends and self.pulse_s else self.longest_on_s

    def line(self) -> str:
        """All of it in one line."""
        return json.dumps(asdict(self))


class RelayBoard:
    """A board on a port that is open already."""

    def __init__(self, settings: RelaySettings, port: SerialPort) -> None:
        self.lit = 0
        """Commanded last: bit i is laser i."""
        self._settings = settings
        self._codec = settings.codec
        self._port = port
        self._reads = settings.read_back if self._codec.reports else "no"

    def set_mask(self, lasers: int) -> None:
        """Light exactly these: what has to go off goes off before what has to come on."""
        _insisted(lambda: self._off(self.lit & ~lasers))
        self.lit &= lasers
        for laser in _members(lasers & ~self.lit):
            self.lit |= 1 << laser
            _insisted(partial(self._on, laser))

    def repeat(self) -> None:
        """Say again what is on."""
        for laser in _members(self.lit):
            self._on(laser)

    def all_off(self) -> None:
        """Every laser off, whatever was commanded before, in up to three attempts.

        A board that cannot say whether it has understood is told twice.
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
                self.lit = 0
                return
            problems.append(DeviceError(self._port.name, f"reports lasers on (mask {left_on}) after switching off"))
        raise problems[-1]

    def read_mask(self) -> int | None:
        """What the board reports to be on; None if it cannot say."""
        return _insisted(lambda: self._read_mask(self.lit))

    def _read_mask(self, expected: int) -> int | None:
        """An answer that is not as expected is asked for again: the first one can be stale."""
        if self._reads == "no":
            return None
        reported = self._reported()
        return self._reported() if reported not in (expected, None) else reported

    def _reported(self) -> int | None:
        try:
            relays = self._exchange(Read(max(self._settings.relays) + 1))
        except _Silent:
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
        """Each is tried, even if another fails."""
        problems = []
        for command in self._off_commands(lasers):
            try:
                self._exchange(command)
            except DeviceError as error:
                problems.append(error)
        if problems:
            raise problems[0]

    def _off_commands(self, lasers: int) -> list[Command]:
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
                raise _Silent(self._port.name, "does not answer", remedy)
            raise DeviceError(self._port.name, f"gives no whole answer ({received!r})", remedy)
        try:
            return self._codec.lit(command, received)
        except WireError as error:
            raise DeviceError(self._port.name, str(error), "check that --lasers names the right board") from error


def _insisted(act: Callable[[], Answer]) -> Answer:
    """What an act gives that may fail for a byte that was lost on a long line, and does no harm if it is repeated."""
    for _ in range(TRIES - 1):
        with suppress(DeviceError):  # no pause: somebody's end may be why no answer was waited for
            return act()
    return act()


def _members(lasers: int) -> list[int]:
    return [laser for laser in range(lasers.bit_length()) if lasers >> laser & 1]


CODECS = {"lcus": LcusCodec, "numato": NumatoCodec, "modbus": ModbusCodec, "ascii": AsciiCodec}


def settings_of_line(line: str) -> RelaySettings:
    """What `line` wrote."""
    values = json.loads(line)
    return RelaySettings(**{**values, "relays": tuple(values["relays"])})
