#!/usr/bin/env python3
"""A robot's controller that listens to `ringpose pose`, in the standard library alone.

    ringpose pose shots --rig rig.yaml | python3 examples/controller.py

It never waits for a pose: a thread keeps the newest line, the control loop goes on at its own pace and takes what
is there. Of a pose it trusts what the covariance says is good: the grasp point and the normal may be well known
where the ring's centre is not. A line without a pose, one that is not good enough, or none for too long: hold.
"""

import argparse
import json
import math
import sys
import threading
import time


class NewestLine:
    """The last line of a stream, and how many were never looked at."""

    def __init__(self, stream):
        self._lock = threading.Lock()
        self._line = None
        self._skipped = 0
        self.ended = threading.Event()
        threading.Thread(target=self._read, args=(stream,), daemon=True).start()

    def take(self):
        """The newest line that was not taken yet (None if there is none), and the number of those before it."""
        with self._lock:
            line, skipped = self._line, self._skipped
            self._line, self._skipped = None, 0
        return line, skipped

    def _read(self, stream):
        for line in stream:
            with self._lock:
                self._skipped += self._line is not None
                self._line = line
        self.ended.set()


def standard_deviations(covariance):
    """Of the grasp point in metres and of the normal in radians, each in its worst direction at most."""
    grasp_m = math.sqrt(sum(covariance["grasp"][i][i] for i in range(3)))
    tilt_rad = math.sqrt(sum(covariance["full"][i][i] for i in range(2)))
    return grasp_m, tilt_rad


def record_in(line):
    """The record on a line; None if it is none that this controller knows, or half of one."""
    try:
        record = json.loads(line)
    except ValueError:
        return None
    return record if isinstance(record, dict) and record.get("schema") == "ringpose/pose/1" else None


def command(record, limits):
    """What the robot is told after one pose line."""
    pose = record["pose"]
    if pose is None:
        return {"do": "hold", "why": record["reason"]}
    if pose["grasp_m"] is None or pose["normal"] is None:
        return {"do": "hold", "why": ", ".join(record["flags"])}
    if any(figure is not None and figure > limits.health for figure in record.get("laser_health", {}).values()):
        return {"do": "hold", "why": "a light plane or the camera has moved"}
    if "inconsistent" in record["flags"]:
        return {"do": "hold", "why": record["reason"]}
    if pose["covariance"] is None:
        return {"do": "hold", "why": "nothing is known of the errors"}
    grasp_m, tilt_rad = standard_deviations(pose["covariance"])
    if grasp_m > limits.grasp_m or tilt_rad > limits.tilt_rad:
        return {"do": "hold", "why": f"not sure enough: {1000 * grasp_m:.2f} mm, {math.degrees(tilt_rad):.2f} degrees"}
    to_m = [round(part, 5) for part in pose["grasp_m"]]
    approach = [round(-part, 5) for part in pose["normal"]]
    return {"do": "move", "to_m": to_m, "along": approach, "sd_m": round(grasp_m, 6)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--period", type=float, default=0.02, help="of the control loop, in seconds")
    parser.add_argument("--patience", type=float, default=0.5, help="hold after so many seconds without a line")
    parser.add_argument("--grasp-m", type=float, default=0.002, help="standard deviation that is good enough")
    parser.add_argument("--tilt-rad", type=float, default=0.05, help="standard deviation that is good enough")
    parser.add_argument("--health", type=float, default=3.0, help="laser_health from which the rig is not trusted")
    limits = parser.parse_args()

    newest, heard_s, told_of_silence = NewestLine(sys.stdin), time.monotonic(), False
    while True:
        last_round = newest.ended.is_set()
        line, skipped = newest.take()
        if line is not None:
            record = record_in(line)
            told = {"shot": None, "skipped": skipped, "do": "hold", "why": "a line that is no pose line"}
            if record is not None:
                told = {"shot": record["shot"], "skipped": skipped, **command(record, limits)}
            print(json.dumps(told), flush=True)
            heard_s, told_of_silence = time.monotonic(), False
        elif not told_of_silence and time.monotonic() - heard_s > limits.patience:
            print(json.dumps({"do": "hold", "why": f"no pose for {limits.patience} s"}), flush=True)
            told_of_silence = True
        if last_round:
            return
        time.sleep(limits.period)


if __name__ == "__main__":
    main()
