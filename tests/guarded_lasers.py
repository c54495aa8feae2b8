"""Relay lasers with a watchdog, created from a URI as the command does."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ringpose.capture.lasers.driver import LaserContext
from ringpose.capture.lasers.watchdog import WatchdogLasers
from ringpose.capture.uri import LASERS, device_uri, driver
from ringpose.simulate.serve.relays import ServedRelays
from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec
from ringpose.wire.numato import NumatoCodec
from ringpose.wire.relay_codec import RelayCodec

ARDUINO = AsciiCodec(on="R{n} ON", off="R{n} OFF", read="R?", acknowledged_by="OK")

PATIENT = "&heartbeat=600&longest_on=600"
"""Limits of the watchdog that no test reaches, so that whatever else it notices is why the lasers go off."""

BOARDS: dict[str, tuple[Any, str]] = {
    "lcus": (LcusCodec(), "lcus:{port}?ch={channels}"),
    "numato": (NumatoCodec(), "numato:{port}?ch={channels}"),
    "modbus": (ModbusCodec(), "modbus:{port}?ch={channels}"),
    "ascii": (ARDUINO, "ascii:{port}?ch={channels}&on=R{{n}}%20ON&off=R{{n}}%20OFF&read=R?&ok=OK&opening=0"),
}


class LinkedRelays(ServedRelays):
    """A virtual board at a link of its own, as the numbers of pseudo-terminals are used again by other tests."""

    def __init__(self, folder: Path, codec: RelayCodec, **options: Any) -> None:
        super().__init__(codec, **options)
        self._link = folder / "port"

    def __enter__(self) -> "LinkedRelays":
        super().__enter__()
        self._link.symlink_to(self.port)
        self.port = str(self._link)
        return self

    def unplug(self) -> None:
        self._link.unlink(missing_ok=True)
        super().unplug()


def lasers_at(uri: str) -> WatchdogLasers:
    """The driver of a URI of relay lasers."""
    parts = device_uri(uri, "--lasers", LASERS)
    lasers = driver(LASERS, parts.scheme)(parts, LaserContext())
    assert isinstance(lasers, WatchdogLasers)
    return lasers


def on_mask(relays: ServedRelays) -> int:
    """Mask of the lasers that are on now."""
    return relays.contacts.mask_at(time.monotonic())


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait for what must come, however busy the machine is; an error if it does not come at all."""
    ends_s = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < ends_s, "what was waited for has not come"
        time.sleep(0.0002)


def wait_until_off(relays: ServedRelays) -> None:
    """Wait until all lasers are off."""
    wait_for(lambda: not on_mask(relays))
