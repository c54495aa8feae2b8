"""`lcus:`, `numato:`, `modbus:`, `ascii:`: URIs of relay boards at a serial port -> lasers behind a watchdog.

No port is ever probed to detect its board: bytes that one board ignores switch lasers on at another.
"""

import re
from collections.abc import Mapping
from dataclasses import replace

from ringpose.capture.lasers.driver import LaserContext, channels
from ringpose.capture.lasers.relay_board import CODECS, RelaySettings
from ringpose.capture.lasers.watchdog import WatchdogLasers
from ringpose.capture.uri import DeviceUri

COMMON = ("ch", "baud", "read_back", "heartbeat", "longest_on", "repeat", "interlock", "opening")

INTERLOCKS = ("", "cts", "dsr")

MAX_RELAYS = 32

_NUMBER = re.compile(r"[0-9]{1,4}")

_HEXADECIMAL = re.compile(r"[0-9a-fA-F]{1,4}")

READ_BACK = ("yes", "no", "try")

WAITS_S = (0.01, 3600.0)
"""Minimum and maximum of the times that a URI may set."""

PULSES_S = (0.1, 3276.7)
"""Range of the timed pulse of a Modbus relay, which counts tenths of a second."""


def lcus(uri: DeviceUri, context: LaserContext) -> WatchdogLasers:
    """Lasers at an LCUS board: `lcus:/dev/ttyUSB0?ch=1,2,3`; a board that does not answer is not read again."""
    return WatchdogLasers(_settings(uri, context, {}, read_back="try"))


def numato(uri: DeviceUri, context: LaserContext) -> WatchdogLasers:
    """Lasers at a Numato board: `numato:/dev/ttyACM0?ch=0,1,2`."""
    return WatchdogLasers(_settings(uri, context, {}))


def modbus(uri: DeviceUri, context: LaserContext) -> WatchdogLasers:
    """Lasers at a Modbus-RTU board: `modbus:/dev/ttyUSB0?ch=0,1,2&unit=1&pulse=2`.

    Clones may need `base=1` or `on=0100`.
    """
    on = uri.parameters.get("on", "ff00")
    parameters: dict[str, str | int] = {
        "unit": uri.whole("unit", 1, maximum=255, minimum=1),
        "first": uri.whole("base", 0, maximum=1),
    }
    if not _HEXADECIMAL.fullmatch(on) or not int(on, 16):
        raise uri.problem(f'on is "{on}", must be four hexadecimal digits and not 0, such as FF00')
    parameters["on_value"] = int(on, 16)
    settings = _settings(uri, context, parameters, ("unit", "base", "on", "pulse"))
    if "pulse" not in uri.parameters:
        return WatchdogLasers(settings)
    return WatchdogLasers(replace(settings, pulse_s=uri.number("pulse", 0.0, *PULSES_S)))


def ascii_lines(uri: DeviceUri, context: LaserContext) -> WatchdogLasers:
    """Lasers at a board that reads lines of text, such as an Arduino.

    `ascii:/dev/ttyACM0?ch=1,2,3&on=R{n}%20ON&off=R{n}%20OFF&read=R?&ok=OK`.
    """
    templates = {"on": uri.parameters.get("on", ""), "off": uri.parameters.get("off", "")}
    for key, template in templates.items():
        if "{n}" not in template:
            raise uri.problem(f"{key}= must be a line with {{n}} for the number of the relay", f"such as {key}=R{{n}}")
    if templates["on"] == templates["off"]:
        raise uri.problem("has the same line for on= and off=", "off= must be the line that switches a relay off")
    more = {"read": uri.parameters.get("read", ""), "acknowledged_by": uri.parameters.get("ok", "")}
    return WatchdogLasers(_settings(uri, context, {**templates, **more}, ("on", "off", "read", "ok")))


def _settings(
    uri: DeviceUri,
    context: LaserContext,
    codec_parameters: Mapping[str, str | int],
    more: tuple[str, ...] = (),
    read_back: str = "yes",
) -> RelaySettings:
    uri.reject_unknown((*COMMON, *more))
    if not uri.address:
        raise uri.problem("names no port", f"write it as {uri.scheme}:/dev/serial/by-id/...?ch=1,2,3")
    return RelaySettings(
        scheme=uri.scheme,
        port=uri.address,
        relays=_relays(uri, context, codec_parameters),
        baud=uri.whole("baud", 9600, maximum=4_000_000, minimum=1),
        codec_parameters=codec_parameters,
        read_back=_choice(uri, "read_back", READ_BACK, read_back),
        repeat_s=uri.number("repeat", 0.0, *WAITS_S) if "repeat" in uri.parameters else None,
        opening_s=uri.number("opening", 2.0 if uri.scheme == "ascii" else 0.0, 0.0, WAITS_S[1]),
        heartbeat_s=uri.number("heartbeat", 1.0, *WAITS_S),
        longest_on_s=uri.number("longest_on", 5.0, *WAITS_S),
        interlock=_choice(uri, "interlock", INTERLOCKS, ""),
    )


def _relays(uri: DeviceUri, context: LaserContext, codec_parameters: Mapping[str, str | int]) -> tuple[int, ...]:
    """Relay numbers from 0; the URI uses the numbers of the board."""
    first = CODECS[uri.scheme](**codec_parameters).first
    chosen = []
    for number in channels(uri, context):
        if not _NUMBER.fullmatch(number) or not first <= int(number) < first + MAX_RELAYS:
            raise uri.problem(f'ch= has "{number}"', f"relays have numbers from {first} to {first + MAX_RELAYS - 1}")
        chosen.append(int(number) - first)
    return tuple(chosen)


def _choice(uri: DeviceUri, key: str, choices: tuple[str, ...], default: str) -> str:
    value = uri.parameters.get(key, default)
    if value not in choices:
        raise uri.problem(f'{key} is "{value}"', f"it is one of {', '.join(filter(None, choices))}")
    return value
