"""When lasers go off although nobody has said so."""

import time
from collections.abc import Callable, Sequence
from typing import TypeAlias

from ringpose.capture.lasers.relay_board import RelayBoard
from ringpose.capture.lasers.relay_settings import RelaySettings
from ringpose.errors import DeviceError

LOOK_S = 0.01
"""How often dangers are looked for while a laser is on."""

Danger: TypeAlias = Callable[[], str]
"""Says why no laser may be on now; nothing if there is no reason."""


class GuardRules:
    """Obeys one line at a time, and between them watches heartbeat, on-time and other dangers.

    Lines are `NUMBER set MASK`, `NUMBER read` and `NUMBER off`; answers are `NUMBER ok MASK`, `NUMBER ok -` where the
    board cannot say, `NUMBER err TEXT`, and `NUMBER off TEXT` if the lasers went off by themselves meanwhile. What was
    switched off so stays off until the owner has said `set 0` or `off`.
    """

    def __init__(
        self,
        board: RelayBoard,
        settings: RelaySettings,
        dangers: Sequence[Danger] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._board = board
        self._settings = settings
        self._dangers = dangers
        self._clock = clock
        self._heard_s = self._on_since_s = self._said_s = clock()
        self._went_off = ""

    def obey(self, line: str) -> str:
        """Carry out a line and answer it."""
        number, _, order = line.strip().partition(" ")
        self._heard_s = self._clock()
        try:
            return f"{number} {self._obeyed(order.split())}\n"
        except DeviceError as error:
            text = f"{error.found}; {error.remedy}" if error.remedy else error.found
            return f"{number} err {text}\n"

    def wait_s(self) -> float | None:
        """How long nothing has to be watched; None for ever."""
        if not self._board.lit:
            return None
        ends_s = [self._heard_s + self._settings.heartbeat_s, self._on_since_s + self._settings.on_limit_s]
        if self._settings.repeat_s is not None:
            ends_s.append(self._said_s + self._settings.repeat_s)
        if self._dangers:
            ends_s.append(self._clock() + LOOK_S)
        return max(0.0, min(ends_s) - self._clock())

    def watch(self) -> None:
        """Switch off what may not be on any longer."""
        if not self._board.lit:
            return
        reason = self._reason_to_switch_off()
        if reason:
            self._went_off = reason
            self._board.all_off()
        elif self._settings.repeat_s is not None and self._clock() >= self._said_s + self._settings.repeat_s:
            self._said_s = self._clock()
            self._board.repeat()

    def _obeyed(self, order: list[str]) -> str:
        if order[:1] == ["off"] or order == ["set", "0"]:
            self._went_off = ""
            self._board.set_mask(0) if order[0] == "set" else self._board.all_off()
            return "ok 0"
        self.watch()
        if self._went_off:
            return f"off {self._went_off}"
        if order[:1] == ["set"]:
            return self._set(int(order[1]))
        reported = self._board.read_mask()
        return "ok -" if reported is None else f"ok {reported}"

    def _set(self, lasers: int) -> str:
        danger = self._danger() if lasers else ""
        if danger:
            raise DeviceError("lasers", f"stay off: {danger}")
        self._said_s = self._clock()
        if not lasers & self._board.lit:
            self._on_since_s = self._clock()
        self._board.set_mask(lasers)
        return f"ok {lasers}"

    def _reason_to_switch_off(self) -> str:
        now_s, settings = self._clock(), self._settings
        danger = self._danger()
        if danger:
            return danger
        if now_s >= self._heard_s + settings.heartbeat_s:
            return f"nothing was heard for {settings.heartbeat_s:g} s; raise heartbeat= if a frame takes longer"
        if now_s >= self._on_since_s + settings.on_limit_s:
            return f"a laser was on for {settings.on_limit_s:g} s; raise longest_on= (and pulse=) if it has to be"
        return ""

    def _danger(self) -> str:
        return next((reason for danger in self._dangers if (reason := danger())), "")
