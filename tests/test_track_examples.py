"""The bridges from a track to controllers."""

import argparse
import json
import runpy
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def track_record(**changes) -> dict:
    record = {
        "schema": "ringpose/track/1",
        "stamp_s": time.time(),
        "validity": "valid",
        "flags": [],
        "frame": "base",
        "pose": {"normal": [0.0, 0.0, -1.0]},
        "grasp": {
            "point_m": [0.1, 0.2, 0.5],
            "velocity_m_s": [0.01, 0.0, 0.0],
        },
        "protection": {"risk": 1e-5, "grasp_normal_m": 1e-3, "grasp_radial_m": 1e-3, "normal_rad": 0.02},
    }
    return {**record, **changes}


@pytest.fixture(scope="module")
def bridge() -> dict:
    return runpy.run_path(str(EXAMPLES / "track_to_udp.py"))


LIMITS = argparse.Namespace(patience=60.0, alert_limit_m=0.005, alert_limit_deg=3.0)


def test_a_valid_track_is_followed_to_where_the_grasp_point_is_now(bridge):
    record = track_record()

    command = bridge["command"](record, time.monotonic(), LIMITS, record["stamp_s"] + 0.1)

    assert command["do"] == "follow"
    assert command["grasp_m"] == pytest.approx([0.101, 0.2, 0.5])
    assert command["approach"] == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    "changes",
    [
        {"validity": "predicted"},
        {"validity": "stale"},
        {"validity": "lost", "pose": None, "grasp": None},
        {"protection": None},
        {"protection": {**track_record()["protection"], "grasp_radial_m": None}, "flags": ["inconsistent"]},
        {"stamp_s": 1.0},
        {"protection": {**track_record()["protection"], "grasp_normal_m": 0.01}},
        {"protection": {**track_record()["protection"], "normal_rad": 0.1}},
        {"stamp_s": None},
        {"grasp": "x"},
    ],
    ids=["predicted", "stale", "lost", "unknown", "pushed", "old", "inaccurate", "tilted", "no stamp", "no point"],
)
def test_anything_else_is_a_hold(bridge, changes):
    record = track_record(**changes)

    assert bridge["command"](record, time.monotonic(), LIMITS, time.time())["do"] == "hold"


def test_silence_is_a_hold(bridge):
    assert bridge["command"](track_record(), time.monotonic() - 100.0, LIMITS, time.time())["do"] == "hold"
    assert bridge["command"](None, time.monotonic(), LIMITS, time.time())["do"] == "hold"


@pytest.mark.slow
def test_datagrams_go_on_while_no_lines_arrive_and_end_with_a_hold():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(300.0)
        to = f"127.0.0.1:{receiver.getsockname()[1]}"

        def awaited(words):
            while words not in (datagram := receiver.recv(1 << 16).decode()):
                pass
            return json.loads(datagram)

        program = [sys.executable, EXAMPLES / "track_to_udp.py", "--to", to, "--rate", "50", "--patience", "10"]
        with subprocess.Popen(program, stdin=subprocess.PIPE, text=True) as process:
            receiver.recv(1 << 16)
            process.stdin.write("junk\n" + json.dumps(track_record()) + "\n")
            process.stdin.flush()
            awaited("follow")
            assert awaited("no track for")["do"] == "hold"
            process.stdin.close()
            assert awaited("ended")["do"] == "hold"
