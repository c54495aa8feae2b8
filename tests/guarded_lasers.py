"""Relays behind a watchdog, as the command makes them of a URI."""

import time

from ringpose.capture.lasers.driver import LaserContext
from ringpose.capture.lasers.watchdog import WatchdogLasers
from ringpose.capture.uri import LASERS, device_uri, driver


def lasers_at(uri: str) -> WatchdogLasers:
    """As the command makes them."""
    parts = device_uri(uri, "--lasers", LASERS)
    made = driver(LASERS, parts.scheme)(parts, LaserContext())
    assert isinstance(made, WatchdogLasers)
    return made


def lit(relays) -> int:
    return relays.mask_at(time.monotonic())
