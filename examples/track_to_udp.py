#!/usr/bin/env python3
"""Sends the track of `ringpose track` to a controller by UDP, at a fixed rate, with the standard library only.

    ringpose pose - --rig rig.yaml | ringpose track - --rig rig.yaml --rate 50 --newest |
        python3 examples/track_to_udp.py --to 192.168.0.10:5005 --rate 100

Each datagram is one JSON object: `do` is `follow`, with the grasp point and the normal extrapolated to the time of
sending, or `hold`. It is `hold` on anything but a track that is valid, recent and accurate enough, when no line has
arrived for `--patience` seconds, and at the end of the stream.
"""

import argparse
import json
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


HOLD_ON = {
    "assignment_ambiguous",
    "grasp_weak",
    "inconsistent",
    "normal_weak",
    "rig_bent",
    "rig_drift",
    "side_unknown",
    "velocity_weak",
}
"""Flags of a track with which the controller does not move; a velocity just after a push is weak."""


def command(record, heard_s, limits, now_s):
    """What the controller is to do now."""
    silent_s = time.monotonic() - heard_s
    if record is None or silent_s > limits.patience:
        return {"do": "hold", "why": f"no track for {silent_s:.1f} s"}
    if record["validity"] != "valid":
        return {"do": "hold", "why": f"the track is {record['validity']}"}
    if set(record["flags"]) & HOLD_ON:
        return {"do": "hold", "why": ", ".join(record["flags"])}
    ahead_s = now_s - record["stamp_s"]
    if not -limits.patience <= ahead_s <= limits.patience:
        return {"do": "hold", "why": f"the track is {ahead_s:.3g} s old"}
    grasp = record["grasp"]
    sd_m = sum(grasp["covariance"][i][i] for i in range(3)) ** 0.5
    if not sd_m <= limits.grasp_m:
        return {"do": "hold", "why": f"not accurate enough: {1000 * sd_m:.2f} mm"}
    point_m = [p + v * ahead_s for p, v in zip(grasp["point_m"], grasp["velocity_m_s"], strict=True)]
    return {
        "do": "follow",
        "stamp_s": now_s,
        "frame": record["frame"],
        "grasp_m": point_m,
        "velocity_m_s": grasp["velocity_m_s"],
        "approach": [-each for each in record["pose"]["normal"]],
        "sd_m": sd_m,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--to", default="127.0.0.1:5005", metavar="HOST:PORT", help="where the datagrams are sent")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="datagrams a second")
    parser.add_argument("--patience", type=float, default=0.2, metavar="S", help="hold after so long without a line")
    parser.add_argument("--grasp-m", type=float, default=0.003, help="standard deviation that is good enough")
    limits = parser.parse_args()
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
