#!/usr/bin/env python3
"""Sends the track of `ringpose track` to a controller by UDP, at a fixed rate, with the standard library only.

    ringpose pose - --rig rig.yaml | ringpose track - --rig rig.yaml --rate 50 --newest |
        python3 examples/track_to_udp.py --to 192.168.0.10:5005 --rate 100

Each datagram is one JSON object: `do` is `follow`, with the grasp point and the normal extrapolated to the time of
sending, or `hold`. It is `hold` on anything but a track that is valid, recent and, by its protection levels, not off by
more than the alert limits, when no line has arrived for `--patience` seconds, and at the end of the stream.
"""

import argparse
import json
import math
import socket
import sys
import threading
import time


class Newest:
    """The newest line of a stream, read by a thread, so that sending never waits for a line."""

    def __init__(self, stream):
        self.record, self.heard_s, self.ended = None, time.monotonic(), False
        threading.Thread(target=self._read, args=(stream,), daemon=True).start()

    def _read(self, stream):
        for line in stream:
            try:
                record = json.loads(line)
                if record["schema"] != "ringpose/track/1":
                    raise ValueError("is not a track record")
                self.record, self.heard_s = record, time.monotonic()
            except (ValueError, KeyError, TypeError, RecursionError) as problem:
                print(f"track_to_udp: {problem}; line ignored".replace("\n", " "), file=sys.stderr, flush=True)
        self.ended = True


LEVELS = ("grasp_normal_m", "grasp_radial_m", "normal_rad")


def command(record, heard_s, limits, now_s):
    """What the controller is to do now; hold also on a line whose values are not those of a track."""
    try:
        return _command(record, heard_s, limits, now_s)
    except (TypeError, KeyError, ValueError, AttributeError) as problem:
        return {"do": "hold", "why": f"no track: its line is malformed, {type(problem).__name__} {problem}"}


def _command(record, heard_s, limits, now_s):
    silent_s = time.monotonic() - heard_s
    if record is None or silent_s > limits.patience:
        return {"do": "hold", "why": f"no track for {silent_s:.1f} s"}
    if record["validity"] != "valid":
        return {"do": "hold", "why": f"the track is {record['validity']}"}
    ahead_s = now_s - record["stamp_s"]
    if not -limits.patience <= ahead_s <= limits.patience:
        return {"do": "hold", "why": f"the track is {ahead_s:.3g} s old"}
    grasp, levels = record["grasp"], record.get("protection") or {}
    off_m, across_m, tilt_rad = (levels.get(key) for key in LEVELS)  # null where there is none: the flags explain it
    if None in (off_m, across_m, tilt_rad):
        return {"do": "hold", "why": ", ".join(record["flags"]) or "nothing states how far it may be off"}
    level_m = max(off_m, across_m)
    if not (level_m <= limits.alert_limit_m and math.degrees(tilt_rad) <= limits.alert_limit_deg):
        return {"do": "hold", "why": f"may be off by {1000 * level_m:.2f} mm, {math.degrees(tilt_rad):.2f} degrees"}
    point_m = [p + v * ahead_s for p, v in zip(grasp["point_m"], grasp["velocity_m_s"], strict=True)]
    return {
        "do": "follow",
        "stamp_s": now_s,
        "frame": record["frame"],
        "grasp_m": point_m,
        "velocity_m_s": grasp["velocity_m_s"],
        "approach": [-each for each in record["pose"]["normal"]],
        "level_m": level_m,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--to", default="127.0.0.1:5005", metavar="HOST:PORT", help="where the datagrams are sent")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="datagrams a second")
    parser.add_argument("--patience", type=float, default=0.2, metavar="S", help="hold after so long without a line")
    parser.add_argument("--alert-limit-m", type=float, default=0.005, help="how far the grasp point may be off")
    parser.add_argument("--alert-limit-deg", type=float, default=3.0, help="how far the normal may be off")
    limits = parser.parse_args()
    if not limits.rate > 0.0:
        parser.error("--rate must be above 0")
    host, _, port = limits.to.rpartition(":")
    newest, tick_s = Newest(sys.stdin), time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        while not newest.ended:
            message = command(newest.record, newest.heard_s, limits, time.time())
            out.sendto(json.dumps(message).encode(), (host, int(port)))
            tick_s = max(tick_s + 1.0 / limits.rate, time.monotonic())  # late ticks are not made up for
            time.sleep(max(tick_s - time.monotonic(), 0.0))
        out.sendto(json.dumps({"do": "hold", "why": "the stream has ended"}).encode(), (host, int(port)))


if __name__ == "__main__":
    main()
