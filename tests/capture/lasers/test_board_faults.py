"""`ringpose capture` when its watchdog, the cable of the board or the disk fails."""

import os
import signal
from pathlib import Path

import pytest
from guarded_lasers import on_mask, wait_for, wait_until_off

from ringpose.cli.main import main
from ringpose.files.images.sessions import read_session
from ringpose.files.images.shots import read_shot

SLOW = ("--settle", "0.3", "--sequence", "all,off")

FULL_AFTER_A_SHOT = """
import pathlib, resource, threading, time
def fill():
    while not list(pathlib.Path("s").glob("*.npz")):
        time.sleep(0.001)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
threading.Thread(target=fill, daemon=True).start()
"""
"""Code to run before the command: after the first shot, no file may grow beyond 3 kB."""


def watchdog_of(process) -> int:
    (child,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return int(child)


@pytest.mark.parametrize(
    ("scheme", "number"),
    [
        ("lcus", signal.SIGKILL),
        ("lcus", signal.SIGSTOP),
        *(pytest.param(scheme, signal.SIGKILL, marks=pytest.mark.slow) for scheme in ("numato", "modbus", "ascii")),
    ],
)
def test_a_capture_whose_watchdog_is_killed_switches_off_and_ends(board, capturing, tmp_path, scheme, number):
    with board(scheme) as (relays, uri), capturing(uri, *SLOW) as process:
        first = process.stdout.readline().strip()
        wait_for(lambda: on_mask(relays))
        os.kill(watchdog_of(process), number)
        wait_until_off(relays)
        _, message = process.communicate(timeout=300)
        assert not on_mask(relays)

    assert process.returncode == 69
    assert message.endswith("the watchdog of the lasers ended; they were switched off without it\n")
    capture = read_session(tmp_path / "s").captures[0]
    assert (capture.state, f"s/{capture.shots[0]}.npz") == ("stopped", first)


@pytest.mark.parametrize("words", [SLOW, ("--rate", "0.001")], ids=["while a laser is on", "between two shots"])
def test_an_unplugged_board_ends_the_capture_and_keeps_finished_shots(board, capturing, tmp_path, words):
    """The second case ends long before the second shot is due."""
    with board("lcus") as (relays, uri), capturing(uri, *words) as process:
        first = process.stdout.readline().strip()
        if words is SLOW:
            wait_for(lambda: on_mask(relays))
        relays.unplug()
        _, message = process.communicate(timeout=300)

    assert process.returncode == 70
    assert message.count("\n") == 1
    assert "watchdog and port are lost, the lasers may be on" in message
    capture = read_session(tmp_path / "s").captures[0]
    assert (capture.state, f"s/{capture.shots[0]}.npz") == ("stopped", first)
    assert read_shot(tmp_path / first).seen_lasers is not None


def test_a_full_disk_ends_the_capture_with_lasers_off_and_keeps_finished_shots(board, capturing, tmp_path):
    with board("lcus") as (relays, uri), capturing(uri, "--settle", "0.05", before=FULL_AFTER_A_SHOT) as process:
        names, message = process.communicate(timeout=600)

    assert process.returncode == 74
    assert "writing broke off" in message
    assert not on_mask(relays)
    finished = read_session(tmp_path / "s").shots
    assert len(finished) >= 1
    assert names == "".join(f"s/{name}.npz\n" for name in finished)
    assert [read_shot(tmp_path / f"s/{name}.npz").name for name in finished] == list(finished)


@pytest.mark.parametrize(
    ("lasers", "status", "complaint"),
    [
        ("lcus:/dev/ttyNone?ch=1,2,3", 69, "/dev/ttyNone: cannot be used: no such file or directory; see ls"),
        ("lcus:/dev/ttyNone", 2, "lacks the channels of the lasers"),
        ("lcus:?ch=1", 2, "names no port"),
        ("lcus:/dev/ttyNone?ch=0,1,2", 2, 'ch= has "0"; relays have numbers from 1'),
        ("lcus:/dev/ttyNone?ch=1,1,2", 2, "names a channel twice"),
        ("lcus:/dev/ttyNone?ch=1,2", 2, "has 2 channels for the 3 lasers of the rig"),
        ("lcus:/dev/ttyNone?ch=1,2,3,4,5,6,7,8,9", 2, "has 9 channels; at most 8 lasers are possible"),
        (
            "lcus:/dev/ttyNone?ch=left:1,right:2,top:3",
            2,
            "must name each of the rig's lasers once: left, middle, right",
        ),
        ("lcus:/dev/ttyNone?ch=1,2,3&heartbeat=0", 2, 'heartbeat is "0"; it takes 0.01 to 3600'),
        ("lcus:/dev/ttyNone?ch=1,2,3&hartbeat=1", 2, "did you mean heartbeat?"),
        ("lcus:/dev/ttyNone?ch=1,2,3&pulse=1", 2, 'has no parameter "pulse"'),
        ("modbus:/dev/ttyNone?ch=0,1,2&on=x", 2, "must be four hexadecimal digits"),
        ("lcus:/dev/ttyNone?ch=1,2,3&baud=inf", 2, "baud "),
        ("ascii:/dev/ttyNone?ch=1,2,3&on=R1&off=R{n}", 2, "on= must be a line with {n}"),
        ("ascii:/dev/ttyNone?ch=1,2,3&on=R{n}&off=R{n}", 2, "has the same line for on= and off="),
        ("lcus:/dev/ttyNone?ch=1,2,3&ch=3,2,1", 2, "gives ch= twice"),
        ("", 2, '"" names no device'),
        ("line:Line1,Line2,Line3", 2, "needs a camera that has output lines"),
        ("relay:/dev/ttyNone", 2, "names no device; it begins with one of ascii:, lcus:"),
    ],
)
def test_unavailable_lasers_give_one_line_on_stderr(scene_folder, capsys, lasers, status, complaint):
    ended = main(["capture", "--camera", f"sim:{scene_folder}/scene.yaml", "--lasers", lasers, "--output", "s"])

    message = capsys.readouterr().err
    assert ended == status
    assert message.count("\n") == 1
    assert complaint in message
    assert not Path("s").exists()


@pytest.mark.parametrize("words", [("--exposure", "1"), ("--sequence", "off,1@960ms"), ("--settle", "1")])
def test_a_frame_longer_than_the_heartbeat_is_a_usage_error(scene_folder, capsys, words):
    lasers = "lcus:/dev/ttyNone?ch=1,2,3"

    ended = main(["capture", "--camera", f"sim:{scene_folder}/scene.yaml", "--lasers", lasers, *words])

    assert ended == 2
    assert "the watchdog of the lasers allows 1 s; raise heartbeat= and longest_on=" in capsys.readouterr().err
