"""How often the relays of each port have switched: contacts wear out."""

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

WORN = 0.8
"""Share of the rated life from which on the user is warned."""


def wear_file(port: str) -> Path:
    """Where the operations of the relays at a port are counted."""
    state = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(state) / "ringpose" / "relays" / (port.strip("/").replace("/", "-") + ".json")


def counted_operations(port: str, relays: Sequence[int]) -> list[int]:
    """Operations so far of each of the relays; 0 where nothing is known."""
    counts = _read(port)
    return [counts.get(str(relay), 0) for relay in relays]


def remember_operations(port: str, relays: Sequence[int], more: Sequence[int]) -> None:
    """Add to the count; a disk that cannot take it must not disturb the guard."""
    if not any(more):
        return
    counts = _read(port)
    for relay, number in zip(relays, more, strict=True):
        counts[str(relay)] = counts.get(str(relay), 0) + number
    file = wear_file(port)
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        aside = file.with_suffix(f".{os.getpid()}")
        aside.write_text(json.dumps({"port": port, "operations": counts}))
        aside.replace(file)


def _read(port: str) -> dict[str, int]:
    """A file that cannot be read counts as none."""
    try:
        counts = json.loads(wear_file(port).read_text())["operations"]
        return {str(relay): int(number) for relay, number in counts.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
