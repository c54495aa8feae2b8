#!/usr/bin/env python3
"""Sends the track of `ringpose track` to a controller by CAN, at a fixed rate; ringpose.dbc describes the frames.

    ringpose pose - --rig rig.yaml | ringpose track - --rig rig.yaml --rate 50 --newest |
        python3 examples/track_to_can.py --interface socketcan --channel can0 --rate 100

It needs python-can (pip install 'ringpose[can]'). In each round it sends grasp point, approach and velocity at the time
of sending, then the status, all with the same counter: the status completes the round. A round that must not be
followed has the command `hold` with its reason, and no numbers (the most negative value of each signal). The
controller has to hold, too, when no status arrives for three rounds: a bus or a program that is down is silent.
"""

import argparse
import sys
import time

from track_to_udp import Newest, command

try:
    import can
except ModuleNotFoundError:
    sys.exit("track_to_can: python-can is missing: pip install 'ringpose[can]'")

STATUS, GRASP, APPROACH, VELOCITY = range(4)
"""Frames by the offset of their identifier from --id."""

LAST_ID = 0x7FF
"""Identifiers have 11 bits."""

POINT_M, UNIT, SPEED_M_S, LEVEL_M, AGE_S = 1e-5, 1 / 32767, 1e-4, 1e-5, 1e-3
"""Value of one bit: positions, directions, velocities, protection level and age."""

FRAMES = {"camera": 0, "tool": 1, "base": 2, None: 15}

REASONS = {
    "": 0,
    "no track": 1,
    "the track is": 2,
    "may be off": 4,
    "nothing states": 4,
    "the stream": 5,
    "out of range": 6,
}
"""Why it is a hold, by the beginning of what track_to_udp says; other holds are for a flag of the track."""

FLAGGED = 3

UNKNOWN = 0xFFFF
"""Age and protection level that are not known or too large."""


def packed(fields):
    """Eight bytes with whole numbers from the lowest bit on; each field is a number and its width in bits."""
    bits, at = 0, 0
    for number, width in fields:
        bits |= (number & ((1 << width) - 1)) << at
        at += width
    return bits.to_bytes(8, "little")


def vector(values, scale, width):
    """Three signed numbers in units of `scale`; the most negative value stands for none. None if one is too large."""
    if values is None:
        return [(-(1 << (width - 1)), width)] * 3
    numbers = [round(value / scale) for value in values]
    return None if any(abs(number) >= 1 << (width - 1) for number in numbers) else [(each, width) for each in numbers]


def unsigned(value, scale):
    """A number of 16 bits; `UNKNOWN` if it is None or too large."""
    return UNKNOWN if value is None else min(round(max(value, 0.0) / scale), UNKNOWN)


def reason_of(said):
    """The number of the reason of a hold."""
    why = said.get("why", "")
    return next((number for begin, number in REASONS.items() if begin and why.startswith(begin)), FLAGGED if why else 0)


def frames_of(said, age_s, counter):
    """The data of a round's frames by their offsets, in the order of sending."""
    follows = said["do"] == "follow"
    parts = [
        vector(said[key] if follows else None, scale, width)
        for key, scale, width in (("grasp_m", POINT_M, 20), ("approach", UNIT, 16), ("velocity_m_s", SPEED_M_S, 16))
    ]
    if None in parts:
        return frames_of({"do": "hold", "why": "out of range of its signals"}, age_s, counter)
    grasp, approach, velocity = parts
    frame, count = (FRAMES[said.get("frame")], 4), (counter & 0xF, 4)
    status = [
        (int(follows), 8),
        (reason_of(said), 8),
        (unsigned(age_s, AGE_S), 16),
        (unsigned(said.get("level_m"), LEVEL_M), 16),
    ]
    return {
        GRASP: packed([*grasp, count]),
        APPROACH: packed([*approach, (0, 8), frame, count]),
        VELOCITY: packed([*velocity, (0, 8), frame, count]),
        STATUS: packed([*status, (0, 8), frame, count]),
    }


def age_of(record, now_s):
    """Time since the newest measurement in the track; None without one."""
    stamp_s = None if record is None else record.get("measurement_stamp_s")
    return now_s - stamp_s if isinstance(stamp_s, int | float) else None


def send(bus, first_id, frames):
    """Send a round; a bus that does not take it is reported, and the controller hears nothing."""
    try:
        for offset, data in frames.items():
            bus.send(can.Message(arbitration_id=first_id + offset, data=data, is_extended_id=False))
    except can.CanError as problem:
        print(f"track_to_can: {problem}; this round is lost".replace("\n", " "), file=sys.stderr, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--interface", default="socketcan", help="of python-can: socketcan, virtual, ...")
    parser.add_argument("--channel", default="can0", help="the bus, whose bit rate is set by the system")
    parser.add_argument(
        "--id", type=lambda text: int(text, 0), default=0x510, metavar="ID", help="identifier of the status"
    )
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="rounds of four frames a second")
    parser.add_argument("--patience", type=float, default=0.2, metavar="S", help="hold after so long without a line")
    parser.add_argument("--alert-limit-m", type=float, default=0.005, help="how far the grasp point may be off")
    parser.add_argument("--alert-limit-deg", type=float, default=3.0, help="how far the normal may be off")
    limits = parser.parse_args()
    if not limits.rate > 0.0:
        parser.error("--rate must be above 0")
    if not 0 <= limits.id <= LAST_ID - VELOCITY:
        parser.error(f"--id must leave room for four identifiers up to {LAST_ID:#x}")
    try:
        opened = can.Bus(interface=limits.interface, channel=limits.channel)
    except (can.CanError, OSError) as problem:
        sys.exit(f"track_to_can: {limits.interface} {limits.channel}: {problem}")
    newest, tick_s, counter = Newest(sys.stdin), time.monotonic(), 0
    with opened as bus:
        while not newest.ended:
            record, now_s = newest.record, time.time()
            said = command(record, newest.heard_s, limits, now_s)
            send(bus, limits.id, frames_of(said, age_of(record, now_s), counter))
            counter += 1
            tick_s = max(tick_s + 1.0 / limits.rate, time.monotonic())  # late ticks are not made up for
            time.sleep(max(tick_s - time.monotonic(), 0.0))
        send(bus, limits.id, frames_of({"do": "hold", "why": "the stream has ended"}, None, counter))


if __name__ == "__main__":
    main()
