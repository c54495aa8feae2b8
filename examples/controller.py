#!/usr/bin/env python3
"""A robot's controller that reads the records of `ringpose pose` or `track`, with the standard library only.

    ringpose pose --camera URI --lasers URI --rig rig.yaml | python3 examples/controller.py
    ringpose pose --track --camera URI --lasers URI --rig rig.yaml | python3 examples/controller.py
    ringpose pose shots --rig rig.yaml | python3 examples/controller.py --replay

A thread reads the lines, so that the control loop never waits for a pose. A shot leads to a motion only if it is new
(its stamp against the clock and against the shots before), in the frame that the robot expects, and if grasp point and
normal may be off by no more than the alert limits: by their protection levels, at the risk that `--risk` of `ringpose
pose` states. A quantity that cannot be relied on has no level; the flags explain why. Any other shot leads to a hold. A
track must be `valid`, that is, neither predicted nor lost. Lines that are not whole records, and shots that arrive
after a newer one, are reported on stderr and ignored. Silence for longer than `--patience`, and the end of the stream,
lead to a hold, too.
"""

import argparse
import json
import math
import os
import sys
import threading
import time

TRACK = "ringpose/track/1"
HEALTH_KEYS = {"ringpose/pose/1": "laser_health", "ringpose/pose/2": "rig_health", TRACK: None}  # by schema
MAX_DISTANCE_M = 5.0  # largest plausible distance; a larger number is in millimetres
MAX_ROUNDING = 1e-3  # tolerance of the length of a unit vector
LEVELS = ("grasp_normal_m", "grasp_radial_m", "normal_rad")


class Lines:
    """Lines of a stream, read by a thread of their own."""

    def __init__(self, stream):
        self._lock = threading.Lock()
        self._lines = []
        self.ended = threading.Event()
        threading.Thread(target=self._read, args=(stream,), daemon=True).start()

    def take(self):
        """The lines that came since the last call, as (line number, text)."""
        with self._lock:
            lines, self._lines = self._lines, []
        return lines

    def _read(self, stream):
        try:
            for number, line in enumerate(stream, start=1):
                with self._lock:
                    self._lines.append((number, line))
        finally:
            self.ended.set()


def check(holds, message):
    if not holds:
        raise ValueError(message)


def check_keys(mapping, keys, name):
    """Check that the keys are present; additional keys are allowed."""
    check(isinstance(mapping, dict), f"{name} is not a JSON object")
    missing = ", ".join(key for key in keys if key not in mapping)
    check(not missing, f"{name} has no {missing}")


def is_number(value):
    """Whether this is a finite number below 1e12, which all stamps and lengths are."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e12 < value < 1e12


def is_vector(value):
    return isinstance(value, list) and len(value) == 3 and all(map(is_number, value))


def rig_health(record):
    """The normalized error of each light plane, by laser."""
    return record.get(HEALTH_KEYS[record["schema"]]) or {}


def record_in(line):
    """The pose or track record on a line; raises ValueError if its keys or types are wrong."""
    try:
        record = json.loads(line)
    except RecursionError:
        raise ValueError("nested too deep") from None
    check_keys(record, ["schema"], "the line")
    schemas = " or ".join(HEALTH_KEYS)
    check(record["schema"] in list(HEALTH_KEYS), f"schema is {record['schema']!r:.40}, not {schemas}")
    check_keys(record, ["shot", "stamp_s", "frame", "status", "reason", "flags", "pose"], "the record")
    check(is_number(record["stamp_s"]), f"stamp_s is {record['stamp_s']!r:.20}, not a number")
    is_track = record["schema"] == TRACK
    check(isinstance(record["shot"], str) or (is_track and record["shot"] is None), "shot is not a text")
    check(not is_track or isinstance(record.get("validity"), str), "validity is not a text")
    flags, health = record["flags"], rig_health(record)
    check(isinstance(flags, list) and all(isinstance(flag, str) for flag in flags), "flags is not a list of texts")
    check(isinstance(health, dict), "the rig's health is not a JSON object")
    check(all(figure is None or is_number(figure) for figure in health.values()), "the rig's health has no numbers")
    pose = record["pose"]
    if pose is not None:
        check_keys(pose, ["grasp_m", "normal"], "pose")
        for key in ("grasp_m", "normal"):
            check(pose[key] is None or is_vector(pose[key]), f"{key} is not a vector of three numbers")
        if pose["normal"] is not None:
            check(abs(math.hypot(*pose["normal"]) - 1) < MAX_ROUNDING, "normal has not length 1")
        if pose["grasp_m"] is not None and record["frame"] == "camera":
            check(math.hypot(*pose["grasp_m"]) < MAX_DISTANCE_M, f"grasp_m is not within {MAX_DISTANCE_M} m")
    levels = record.get("protection")
    if levels is not None:
        check_keys(levels, ["risk", *LEVELS], "protection")
        known = [levels[key] for key in LEVELS if levels[key] is not None]
        check(all(is_number(level) and level >= 0 for level in known), "protection has no numbers")
    return record


def obstacle(record, limits, now_s):
    """Why the robot must not move by this record; None if it may."""
    pose, age_s = record["pose"], now_s - record["stamp_s"]
    if not limits.replay and not -limits.max_age <= age_s <= limits.max_age:
        return f"the shot is {age_s:.3g} s old"
    if record["frame"] != limits.frame:
        return f"the pose is in the frame {record['frame']!r:.20}, not {limits.frame}"
    if record["schema"] == TRACK and record["validity"] != "valid":
        return f"the track is {record['validity']:.20}"
    if pose is None or record["status"] not in ("ok", "degraded"):
        return record["reason"] or f"status is {record['status']!r:.20}"
    if any(figure is not None and figure > limits.health for figure in rig_health(record).values()):
        return "a light plane or the camera has moved"
    levels = record.get("protection") or {}
    off_m, across_m, tilt_rad = (levels.get(key) for key in LEVELS)
    if None in (off_m, across_m, tilt_rad, pose["grasp_m"], pose["normal"]):
        return record["reason"] or ", ".join(record["flags"]) or "nothing states how far it may be off"
    tilt_deg = math.degrees(tilt_rad)
    if not (max(off_m, across_m) <= limits.alert_limit_m and tilt_deg <= limits.alert_limit_deg):
        figures = f"{1000 * off_m:.2f} mm along the normal, {1000 * across_m:.2f} mm across the face"
        return f"not accurate enough: it may be off by {figures}, {tilt_deg:.2f} degrees"
    return None


def command(record, limits, now_s):
    """What the robot is to do after one record."""
    why = obstacle(record, limits, now_s)
    if why is not None:
        return {"do": "hold", "why": why}
    to_m = [round(part, 5) for part in record["pose"]["grasp_m"]]
    approach = [round(-part, 5) for part in record["pose"]["normal"]]
    level_m = max(record["protection"][key] for key in LEVELS[:2])
    return {"do": "move", "to_m": to_m, "along": approach, "frame": record["frame"], "level_m": round(level_m, 6)}


def newest_in(lines, newest_s, limits):
    """The newest whole record among lines (None without one), its stamp, and how many older ones it replaces."""
    record, skipped = None, 0
    for number, line in lines:
        try:
            candidate = record_in(line)
            stamp_s = candidate["stamp_s"]
            if not limits.replay and stamp_s < newest_s:
                raise ValueError(f"shot {candidate['shot']!r:.40} is {newest_s - stamp_s:.3g} s older than one before")
        except ValueError as problem:
            print(f"controller: line {number}: {problem}; ignored".replace("\n", " "), file=sys.stderr, flush=True)
            continue
        skipped += record is not None
        record = candidate
        if stamp_s <= time.time() + limits.max_age:  # one in the future must not outdate all that follow
            newest_s = stamp_s
    return record, newest_s, skipped


def control(stream, limits):
    """Print one command for each round of the loop in which there is something new."""
    lines, newest_s = Lines(stream), -math.inf
    heard_s, silent = time.monotonic(), False
    while True:
        last_round = lines.ended.is_set()
        record, newest_s, skipped = newest_in(lines.take(), newest_s, limits)
        if record is not None:
            said = {"shot": record["shot"], "skipped": skipped, **command(record, limits, time.time())}
            print(json.dumps(said), flush=True)
            heard_s, silent = time.monotonic(), False
        elif not silent and time.monotonic() - heard_s > limits.patience:
            print(json.dumps({"do": "hold", "why": f"no pose for {limits.patience} s"}), flush=True)
            silent = True
        if last_round:
            print(json.dumps({"do": "hold", "why": "the stream has ended"}), flush=True)
            return
        time.sleep(limits.period)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frame", choices=["camera", "tool", "base"], default="camera", help="of the robot's target")
    parser.add_argument("--max-age", type=float, default=1.0, help="seconds between a shot and its use, at most")
    parser.add_argument("--replay", action="store_true", help="recorded shots: obey them as they come, however old")
    parser.add_argument("--period", type=float, default=0.02, help="of the control loop, in seconds")
    parser.add_argument(
        "--patience", type=float, default=0.5, help="hold after this number of seconds without a pose record"
    )
    parser.add_argument("--alert-limit-m", type=float, default=0.005, help="how far the grasp point may be off")
    parser.add_argument("--alert-limit-deg", type=float, default=3.0, help="how far the normal may be off")
    parser.add_argument("--health", type=float, default=3.0, help="rig_health from which the rig is not trusted")
    limits = parser.parse_args()
    if sys.stdin is None or sys.stdout is None:  # started with <&- or >&-
        print("controller: standard input or output is closed; give both", file=sys.stderr)
        sys.exit(66 if sys.stdin is None else 74)
    sys.stdin.reconfigure(encoding="utf-8", errors="replace")
    try:
        control(sys.stdin, limits)
        status = 0
    except BrokenPipeError:  # the reader of the commands has ended
        status = 141
    except KeyboardInterrupt:
        status = 130
    os._exit(status)  # the thread may still wait for a line; every command has been flushed


if __name__ == "__main__":
    main()
