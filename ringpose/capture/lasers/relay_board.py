"""A relay board that switches the lasers: laser i is the relay `settings.relays[i]`.

The settings come from the URI and are passed to the watchdog process as one line of JSON. The board is driven in that
process, so this module imports no heavy package.
"""

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import TypeVar

from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError
from ringpose.wire import relay_codec
from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec
from ringpose.wire.numato import NumatoCodec

Answer = TypeVar("Answer")

ANSWER_LIMIT_S = 0.25

QUIET_S = 0.05
"""Pause that ends what belongs to one command: longer than an adapter buffers bytes (16 ms) and a board thinks."""

TRIES = 3
"""Attempts at one command."""

PAUSE_S = 0.02
"""Pause between two attempts to switch everything off."""


NO_ANSWER = "does not answer"

REMEDY = "check the board, its scheme in --lasers, its power"

WRONG_BOARD = "check that --lasers names the right board"

OTHER_CHANNELS = "give channels that the board has"


class _NoAnswer(DeviceError):
    """Not a single byte has come."""


class _Refusal(DeviceError):
    """The board has answered that it rejects a command."""


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
    def codec(self) -> relay_codec.RelayCodec:
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
    """A board at a port that is open already.

    Some adapters, as of RS-485 with two wires, echo what is sent. As an echo can look like the acknowledgement of a
    switch, `all_off` finds out whether there is one, by the answer to a read, before any laser is switched on.
    """

    def __init__(self, settings: RelaySettings, port: SerialPort, *, echoes: bool | None = None) -> None:
        self.on_mask = 0
        """The mask commanded last: bit i is laser i."""
        self.echoes = echoes
        """Whether each request comes back in front of the answer; None while that is not known."""
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
        raise problems[0].followed_by(*problems[1:])

    def read_mask(self) -> int | None:
        """The mask that the board reports; None if it cannot report."""
        return _retried(lambda: self._read_mask(self.on_mask))

    def _read_mask(self, expected: int) -> int | None:
        """The reported mask; read again if it is not as expected, because the first answer may be stale."""
        if self._reads == "no":
            self._find_echo()
            return None
        reported = self._reported()
        return self._reported() if reported not in (expected, None) else reported

    def _reported(self) -> int | None:
        """The reported mask; with `read_back=try`, the first read decides whether later ones are made."""
        try:
            relays = self._exchange(self._read)
        except _NoAnswer:
            if self._reads != "try":
                raise
            self._reads, self.echoes = "no", False
            return None
        self._reads = "yes"
        return sum(1 << laser for laser, relay in enumerate(self._settings.relays) if relays >> relay & 1)

    def _find_echo(self) -> None:
        """Find out whether requests are echoed, though the relays are not to be read; raises if nothing else comes."""
        if self.echoes is not None:
            return
        if not self._codec.reports:  # lines of text are told from their echo by the codec
            self.echoes = False
            return
        try:
            self._exchange(self._read)
        except _NoAnswer:
            self.echoes = False
        except _Refusal:
            pass

    @property
    def _read(self) -> relay_codec.Read:
        return relay_codec.Read(max(self._settings.relays) + 1)

    def _on(self, laser: int) -> None:
        relay, pulse_s = self._settings.relays[laser], self._settings.pulse_s
        self._exchange(relay_codec.Switch(relay, True) if pulse_s is None else relay_codec.Pulse(relay, pulse_s))

    def _off(self, lasers: int) -> None:
        """Switch lasers off; each relay is commanded even if another one fails."""
        problems = []
        for command in self._off_commands(lasers):
            try:
                self._exchange(command)
            except DeviceError as error:
                problems.append(error)
        if problems:
            raise problems[0].followed_by(*problems[1:])

    def _off_commands(self, lasers: int) -> list[relay_codec.Command]:
        """One command for adjacent relays if the board can switch them together; otherwise one for each."""
        relays = sorted(self._settings.relays[laser] for laser in _members(lasers))
        is_row = len(relays) > 1 and relays[-1] - relays[0] == len(relays) - 1
        if is_row and self._codec.switches_rows:
            return [relay_codec.SwitchRow(relays[0], len(relays), 0)]
        return [relay_codec.Switch(relay, False) for relay in relays]

    def _exchange(self, command: relay_codec.Command) -> int:
        """Send a command; returns the mask of the relays that are on by its answer, 0 if that is not a mask."""
        request = self._codec.request(command)
        if self._codec.is_whole(command, b"") and not self.echoes:  # a command without an answer
            self._port.exchange(request, lambda _: True, 0.0)
            return 0
        if self.echoes is None:
            return self._first_answer(command, request)
        length = len(request) if self.echoes else 0
        received = self._port.exchange(
            request,
            lambda received: len(received) >= length and self._codec.is_whole(command, received[length:]),
            ANSWER_LIMIT_S,
        )
        if received[:length] != request[:length]:
            finding = f"echoes {received[:length].hex(' ')} instead of {request.hex(' ')}" if received else NO_ANSWER
            raise DeviceError(self._port.name, finding, "check the cable, its termination, and that nothing else sends")
        return self._mask(command, received[length:])

    def _first_answer(self, command: relay_codec.Command, request: bytes) -> int:
        """The answer while it is not known whether requests are echoed; it may show that."""

        def with_echo(received: bytes) -> bool:
            return received.startswith(request) and self._is_answer(command, received[len(request) :])

        received = self._port.exchange(
            request, lambda received: with_echo(received) or self._is_answer(command, received), ANSWER_LIMIT_S, QUIET_S
        )
        if with_echo(received):
            self.echoes = True
            return self._mask(command, received[len(request) :])
        if self._is_answer(command, received):
            self.echoes = None if received == request else False  # a Modbus board repeats the request
            return self._mask(command, received)
        if received.startswith(request):
            finding = f"the adapter echoes what is sent ({request.hex(' ')}), and no board answers"
            raise DeviceError(self._port.name, finding, REMEDY)
        return self._mask(command, received)

    def _is_answer(self, command: relay_codec.Command, received: bytes) -> bool:
        """Whether these bytes are a complete answer, even if it is a rejection."""
        try:
            self._codec.on_mask(command, received)
        except relay_codec.Refused:
            return True
        except relay_codec.WireError:
            return False
        return self._codec.is_whole(command, received)

    def _mask(self, command: relay_codec.Command, answer: bytes) -> int:
        """The mask in a checked answer."""
        is_whole = self._codec.is_whole(command, answer)
        if not answer and not is_whole:
            raise _NoAnswer(self._port.name, NO_ANSWER, REMEDY)
        try:
            return self._codec.on_mask(command, answer)
        except relay_codec.Refused as error:
            raise _Refusal(self._port.name, str(error), WRONG_BOARD) from error
        except relay_codec.TooFewRelays as error:
            raise DeviceError(self._port.name, str(error), OTHER_CHANNELS) from error
        except relay_codec.WireError as error:
            if not is_whole:
                raise DeviceError(self._port.name, f"sends an incomplete answer ({answer!r})", REMEDY) from error
            raise DeviceError(self._port.name, str(error), WRONG_BOARD) from error


def _retried(act: Callable[[], Answer]) -> Answer:
    """The result of an act, repeated if it fails, for example because a byte was lost on a long line."""
    problems: list[DeviceError] = []
    for _ in range(TRIES):
        try:
            return act()
        except DeviceError as error:  # no pause: the wait for an answer may have ended because a process ends
            problems.append(error)
    raise problems[0].followed_by(*problems[1:])


def _members(lasers: int) -> list[int]:
    return [laser for laser in range(lasers.bit_length()) if lasers >> laser & 1]


CODECS = {"lcus": LcusCodec, "numato": NumatoCodec, "modbus": ModbusCodec, "ascii": AsciiCodec}


def settings_of_line(line: str) -> RelaySettings:
    """The settings that `RelaySettings.line` has written."""
    values = json.loads(line)
    return RelaySettings(**{**values, "relays": tuple(values["relays"])})
