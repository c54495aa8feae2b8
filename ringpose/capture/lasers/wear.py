"""How often the relays of each port have switched: contacts wear out."""

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

WORN = 0.8
"""Share of the rated life from which on the user is warned."""


_UNREADABLE = (OSError, RuntimeError)
"""A user who has no home folder gets the latter."""

NOTED_EVERY = 100
"""Operations after which they are noted: a computer that loses its power in a long run forgets no more."""


def wear_file(port: str) -> Path:
    """Where the operations of the relays at a port are counted."""
    state = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(state) / "ringpose" / "relays" / (port.strip("/").replace("/", "-") + ".json")


class Wear:
    """The count of the relays at a port while a guard works with them."""

    def __init__(self, port: str, relays: Sequence[int]) -> None:
        self._port = port
        self._relays = relays
        self._noted = [0] * len(relays)
        counts = _read(port)
        self.earlier = [counts.get(str(relay), 0) for relay in relays]
        """Operations of each of the relays before this guard; 0 where nothing is known."""

    def note(self, operations: Sequence[int], at_least: int = NOTED_EVERY) -> None:
        """Add this guard's operations to the count, if so many are new; a disk that cannot take it must not disturb."""
        more = [now - then for now, then in zip(operations, self._noted, strict=True)]
        if sum(more) < at_least:
            return
        self._noted = list(operations)
        counts = _read(self._port)
        for relay, number in zip(self._relays, more, strict=True):
            counts[str(relay)] = counts.get(str(relay), 0) + number
        with suppress(*_UNREADABLE):
            file = wear_file(self._port)
            file.parent.mkdir(parents=True, exist_ok=True)
            aside = file.with_suffix(f".{os.getpid()}")
            aside.write_text(json.dumps({"port": self._port, "operations": counts}))
            aside.replace(file)


def _read(port: str) -> dict[str, int]:
    """A file that cannot be read counts as none."""
    try:
        counts = json.loads(wear_file(port).read_text())["operations"]
        return {str(relay): int(number) for relay, number in counts.items()}
    except (*_UNREADABLE, ValueError, KeyError, TypeError, AttributeError):
        return {}
