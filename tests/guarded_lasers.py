"""Relay lasers with a watchdog, created from a URI as the command does."""

import time
from collections.abc import Callable

from ringpose.capture.lasers.driver import LaserContext
from ringpose.capture.lasers.watchdog import WatchdogLasers
from ringpose.capture.uri import LASERS, device_uri, driver
from ringpose.simulate.serve.relays import ServedRelays


def lasers_at(uri: str) -> WatchdogLasers:
    """The driver of a URI of relay lasers."""
    parts = device_uri(uri, "--lasers", LASERS)
    lasers = driver(LASERS, parts.scheme)(parts, LaserContext())
    assert isinstance(lasers, WatchdogLasers)
    return lasers


def on_mask(relays: ServedRelays) -> int:
    """Mask of the lasers that are on now."""
    return relays.mask_at(time.monotonic())


def fastest(measured: Callable[[], float], limit_s: float, tries: int = 20) -> float:
    """The first time within the limit, or the shortest one: the delay of a busy machine varies.

    However busy it is, the lasers must have gone off in every try: a time that is not finite fails.
    """
    times_s: list[float] = []
    while len(times_s) < tries and min(times_s, default=limit_s) >= limit_s:
        times_s.append(measured())
        assert times_s[-1] < float("inf"), f"the lasers stayed on in try {len(times_s)}"
    return min(times_s)
