"""Shots and poses over the network and a serial line, from stand-ins that run in a process of their own."""

import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from other_client import Port
from served_scene import small_scene
from small_rig import SMALL_RIG

from ringpose.cli.main import main
from ringpose.files.images.sessions import read_session
from ringpose.files.images.shots import read_shot
from ringpose.simulate.serve import genicam as features
from ringpose.types.image import Shot
from ringpose.wire import gige_registers as bootstrap

pytestmark = pytest.mark.usefixtures("_aravis")

COMMAND = "import sys; from ringpose.cli.main import run; run()"


@pytest.fixture
def capture(run):
    """Runs `ringpose capture` with served devices into the session `s`."""
    return lambda uris, *words: run(
        "capture", "--camera", uris["camera"], "--lasers", uris["lasers"], "--output", "s", *words
    )


def shots() -> list[Shot]:
    return [read_shot(path) for path in sorted(Path("s").glob("*.npz"))]


def notes_of_log() -> list[dict]:
    """What the stand-in noted of each frame."""
    return [json.loads(line) for line in Path("log.jsonl").read_text().splitlines()]


def truly_lit(shot) -> list[list[float]]:
    """Of each frame, how much every laser shone in truth, by the stand-in's log."""
    notes = {note["frame_id"]: note for note in notes_of_log()}
    return [notes[number]["laser_shares"] for number in shot.frame_id.tolist()]


def wrong_labels(from_share: float = 0.99) -> list[str]:
    """Shots whose masks, commanded or seen, are not what truly shone, for this share of the exposure or not at all."""
    wrong = []
    for shot in shots():
        truth = [sum(1 << k for k, share in enumerate(shares) if share >= from_share) for shares in truly_lit(shot)]
        partly = [1.0 - from_share < share < from_share for shares in truly_lit(shot) for share in shares]
        if shot.lasers.tolist() != truth or shot.seen_lasers.tolist() != truth or any(partly):
            wrong.append(shot.name)
    return wrong


def test_what_went_wrong_on_the_way_is_kept_with_the_shot(serve, capture):
    uris = serve("--fault", "loss=0.01", "--fault", "no-resend")

    status = capture(uris, "--sequence", "off,1", "--count", "8").status

    attempts = [shot.meta.get("attempts", [1, 1]) for shot in shots()]
    assert status == 0
    assert max(map(max, attempts)) > 1
    assert read_session(Path("s")).captures[0].camera_name.startswith("ringpose-Stand-in-RP")


@pytest.mark.parametrize(
    "relay", ["none", "lcus", *(pytest.param(relay, marks=pytest.mark.slow) for relay in ("numato", "modbus", "ascii"))]
)
def test_every_kind_of_laser_switch_gives_frames_with_true_labels(serve, capture, relay):
    uris = serve("--relay", relay)

    status = capture(uris, "--sequence", "off,1,2,3,off", "--count", "3").status

    assert status == 0
    assert len(list(Path("s").glob("*.npz"))) == 3
    assert wrong_labels() == []


@pytest.mark.slow
def test_a_dead_camera_ends_the_capture_with_its_finished_shots(serve, capture):
    uris = serve("--relay", "lcus", "--fault", "dead-camera=7")
    uris["camera"] += "?timeout=2"

    status, out, messages = capture(uris, "--sequence", "off,1,2", "--count", "5")

    assert (status, len(out)) == (69, 2)
    assert "check its cable" in messages[-1]
    assert "state: stopped" in Path("s/session.yaml").read_text()


@pytest.mark.slow
def test_lasers_at_the_lines_of_a_camera_that_is_lost_may_be_on(serve, capture):
    uris = serve("--fault", "dead-camera=7")
    uris["camera"] += "?timeout=2"

    status, _, messages = capture(uris, "--sequence", "off,1,2", "--count", "5")

    assert status == 70
    assert "cut the power" in messages[-1]


def test_a_laser_that_follows_too_late_is_noticed(serve, capture):
    uris = serve("--relay", "lcus", "--fault", "late:2=0.3")

    status = capture(uris, "--sequence", "off,1,2,3,off", "--settle", "0.02", "--count", "1").status

    # a late command of an attempt that failed may switch the laser during its frame of the next one: a dimmer stripe
    assert status != 0 or wrong_labels(from_share=0.5) == []


def test_a_laser_that_sticks_is_a_safety_fault(serve, capture):
    uris = serve("--relay", "modbus", "--fault", "stuck:2")

    status, _, messages = capture(uris, "--sequence", "off,1,2,3,off", "--count", "3")

    assert status == 70
    assert "laser 2" in messages[-1]


def test_a_pulled_cable_is_a_safety_fault(serve, capture):
    uris = serve("--relay", "lcus", "--fault", "unplug=7")

    status = capture(uris, "--sequence", "off,1,2,3,off", "--count", "3").status

    assert status == 70
    assert len(list(Path("s").glob("*.npz"))) == 1


def test_poses_come_straight_from_devices(serve, example_folder, run):
    uris = serve("--move", "never", scene=str(example_folder / "scene.yaml"))

    devices = ["--camera", uris["camera"], "--lasers", uris["lasers"]]
    rig = example_folder / "scene-rig.yaml"
    found = run("pose", "--rig", rig, *devices, "--count", 3, "--sequence", "off,1,2,3,off")

    lines = found.records
    assert found.status == 0
    assert len(lines) + sum(line["shots_dropped"] for line in lines) == 3
    assert min(line["latency_s"] for line in lines) > 0.0
    assert {line["status"] for line in lines} <= {"ok", "degraded"}


@pytest.mark.parametrize("words", ["", "a.npz --camera sim:scene.yaml", "--camera files:shots", "a.npz --lasers none:"])
def test_shots_come_either_from_inputs_or_from_a_live_camera(run, words):
    status, _, messages = run("pose", "--rig", "rig.yaml", *words.split())

    assert (status, len(messages)) == (2, 1)


def test_a_camera_is_served_to_this_machine_alone(run, tmp_path):
    small_scene(tmp_path)

    status, _, messages = run("simulate", "serve", "--scene", tmp_path / "scene.yaml", "--camera", "192.168.0.1")

    assert status == 2
    assert "loopback address" in messages[0]


def test_two_cameras_need_two_addresses(serve, loopback_address, run):
    serve()

    status, _, messages = run("simulate", "serve", "--scene", "scene.yaml", "--camera", loopback_address)

    assert status == 69
    assert "choose another address" in messages[0]


def no_room_for_much() -> None:
    """Files end after a few lines, as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300))


@pytest.mark.slow
def test_a_camera_that_cannot_write_its_log_ends_loudly(tmp_path, loopback_address):
    small_scene(tmp_path)
    command = [sys.executable, "-c", COMMAND, "simulate", "serve", "--scene", "scene.yaml"]
    words = [*command, "--camera", loopback_address, "--log", "log.jsonl"]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, cwd=tmp_path, preexec_fn=no_room_for_much, text=True, **streams) as serving:
        serving.stdout.readline()
        port = Port(loopback_address)
        port.write(bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL.to_bytes(4, "big"))
        port.write(features.ACQUISITION_START, (1).to_bytes(4, "big"))
        status = serving.wait(300)
        port.close()
        said = serving.stderr.read()

    assert status == 74
    assert said.startswith("ringpose simulate: log.jsonl: writing broke off: file too large")
    assert len(said.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("relay", "faults"),
    [("none", ()), ("lcus", ("operate=0.008", "release=0.004")), ("none", ("loss=0.002",))],
    ids=["lines", "relays", "loss"],
)
def test_two_hundred_shots_have_no_wrong_label(serve, capture, relay, faults):
    uris = serve("--relay", relay, *(word for fault in faults for word in ("--fault", fault)))

    status = capture(uris, "--sequence", "off,1,2,3,off", "--count", "200", "--quiet").status

    assert status == 0
    assert len(list(Path("s").glob("*.npz"))) == 200
    assert wrong_labels() == []


def test_stamps_are_the_hosts_clock_and_the_cameras(serve, capture):
    uris = serve()
    before_s = time.time()

    capture(uris, "--sequence", "off,1,off", "--count", "2")

    stamps_s = np.concatenate([shot.stamp_s for shot in shots()])
    device_s = np.concatenate([shot.device_stamp_s for shot in shots()])
    assert before_s < stamps_s[0] < stamps_s[-1] < time.time()
    assert np.all(np.diff(stamps_s) > 0)
    assert np.all(np.diff(device_s) > 0)


def test_no_frame_is_lost(serve, example_folder):
    """Frames come through the kernel's buffer, which holds less than half of one unless a greater one is asked for."""
    uris = serve("--move", "never", scene=str(example_folder / "scene.yaml"))
    devices = ["--camera", uris["camera"], "--lasers", uris["lasers"]]
    words = ["capture", *devices, "--sequence", "off,1,2,3,off", "--count", "6", "--output", "s", "--quiet"]

    status = main(words)

    frames = len(Path("log.jsonl").read_text().splitlines())
    assert status == 0
    assert len(list(Path("s").glob("*.npz"))) == 6
    assert frames < 2 * 30  # a few may have to be taken again


@pytest.mark.slow
@pytest.mark.parametrize(("faults", "goes_dark"), [((), True), (("--fault", "keeps-lines"), False)])
def test_a_killed_capture_leaves_lasers_at_lines_to_the_cameras_heartbeat(serve, faults, goes_dark):
    uris = serve("--move", "never", *faults)
    devices = ["--camera", uris["camera"], "--lasers", uris["lasers"]]
    words = ["capture", *devices, "--sequence", "off" + 60 * ",1", "--output", "killed", "--quiet"]
    running = subprocess.Popen([sys.executable, "-c", COMMAND, *words], stdout=subprocess.PIPE)
    running.stdout.readline()
    shot_before = notes_of_log()
    while not any(note["laser_shares"][0] for note in notes_of_log()[len(shot_before) :]):
        time.sleep(0.01)
    running.kill()
    running.wait()
    running.stdout.close()

    words = ["capture", "--camera", uris["camera"], "--lasers", "none:", "--sequence", "all", "--count", "1"]
    while (status := main([*words, "--output", "after", "--force"])) == 69:  # the killed one is still in control
        time.sleep(0.5)

    last = notes_of_log()[-1]
    assert status == 0
    assert (last["laser_shares"] == [0.0, 0.0, 0.0]) is goes_dark


def test_live_shots_that_the_rig_does_not_fit_end_the_measurement(serve, run):
    uris = serve()
    devices = ["--camera", uris["camera"], "--lasers", uris["lasers"]]
    Path("other.yaml").write_text(SMALL_RIG)

    status, out, messages = run("pose", "--rig", "other.yaml", *devices, "--count", 3)

    assert status == 65
    assert out == []
    assert "200 x 150 pixels, the rig's camera has 160 x 120; give the rig that took the shot" in messages[-1]
