"""A relay board on a pseudo-terminal, spoken to by the driver that speaks to the real one."""

import os
import select
import threading
import time
import tty
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType

from ringpose.simulate.serve.contacts import ContactFaults, Contacts
from ringpose.wire.relay_codec import Command, Pulse, Read, RelayCodec, SwitchRow, row_of

ALL_RELAYS = 8
"""Of the boards that are stood in for."""

_LONGEST_COMMAND = 64
"""Bytes; what goes on for longer without a command's end is noise."""


class ServedRelays:
    """A board whose relays switch lasers: relay `relays[i]` of the board (from 0) feeds laser i of the rig.

    `mask_at` and `contacts` tell what truly shines, which a camera's stand-in renders; the board itself reports its
    coils. A thread serves until the block ends or `unplug` pulls the cable.
    """

    def __init__(
        self,
        codec: RelayCodec,
        relays: Sequence[int] = (0, 1, 2),
        faults: ContactFaults | None = None,
        changed: Callable[[int], None] | None = None,
    ) -> None:
        self.relays = tuple(relays)
        self.contacts = Contacts(len(self.relays), faults)
        self.port = ""
        """The terminal to open, once served."""
        self._codec = codec
        self._changed = changed
        self._coils_until_s = [0.0] * ALL_RELAYS
        self._master = self._slave = -1
        self._stop_read, self._stop_write = -1, -1
        self._thread: threading.Thread | None = None

    @property
    def channels(self) -> str:
        """The relays by the board's own numbers, as the driver's URI has them after `ch=`."""
        return ",".join(str(relay + self._codec.first) for relay in self.relays)

    def mask_at(self, time_s: float) -> int:
        """The lasers that truly shine at a time (monotonic clock): bit i is laser i of the rig."""
        return self.contacts.mask_at(time_s)

    def __enter__(self) -> "ServedRelays":
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name=self.port, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Pull the cable: the terminal hangs up. The contacts stay as they are."""
        if self._thread is None:
            return
        os.write(self._stop_write, b"x")
        self._thread.join()
        self._thread = None
        for number in (self._master, self._slave, self._stop_read, self._stop_write):
            os.close(number)

    def _serve(self) -> None:
        pending = b""
        while True:
            ready, _, _ = select.select([self._master, self._stop_read], [], [])
            if self._stop_read in ready:
                return
            commands, pending = self._codec.commands(pending + os.read(self._master, 4096))
            pending = pending[-_LONGEST_COMMAND:]
            for command in filter(_is_for_the_board, commands):
                self._carry_out(command)

    def _carry_out(self, command: Command) -> None:
        now_s = time.monotonic()
        before = self._coils(now_s)
        on, off = row_of(command)
        until_s = now_s + command.duration_s if isinstance(command, Pulse) else None
        for relay in range(ALL_RELAYS):
            if (on | off) >> relay & 1:
                self._switch(relay, bool(on >> relay & 1), now_s, until_s)
        coils = self._coils(now_s)
        with suppress(BlockingIOError):  # nobody reads what the board says
            os.write(self._master, self._codec.answer(command, coils, ALL_RELAYS))
        if self._changed is not None and not isinstance(command, Read) and coils != before:
            self._changed(coils)

    def _switch(self, relay: int, on: bool, now_s: float, until_s: float | None) -> None:
        self._coils_until_s[relay] = 0.0 if not on else float("inf") if until_s is None else until_s
        if relay in self.relays:
            self.contacts.command(self.relays.index(relay), on, now_s, until_s)

    def _coils(self, now_s: float) -> int:
        return sum(1 << relay for relay, until_s in enumerate(self._coils_until_s) if until_s > now_s)


def _is_for_the_board(command: Command) -> bool:
    """Whether it has the relays that are named; a command to others is not answered."""
    if isinstance(command, Read):
        return command.count <= ALL_RELAYS
    if isinstance(command, SwitchRow):
        row = range(command.first, command.first + command.count)
        return row.start >= 0 and row.stop <= ALL_RELAYS and command.lit < 1 << command.count
    return 0 <= command.relay < ALL_RELAYS
