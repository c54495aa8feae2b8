"""Writing of session folders: normal ends, failures, replacing and appending."""

import errno
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml
from recorded_shots import make_shot
from schemas import validated

from ringpose.errors import CannotCreateError, DataError, InputOutputError, LaserSafetyError, SignalReceived
from ringpose.files.images.sessions import SessionWriter, read_session, write_session
from ringpose.files.images.shots import read_shot
from ringpose.types.image import Shot
from ringpose.types.session import Capture, Session

CAPTURE = Capture(camera="sim:scene.yaml", lasers="sim:", sequence="off,1,off", laser_count=3)


def shot(name: str, value: int = 0) -> Shot:
    return make_shot(np.full((1, 2, 3), value, dtype=np.uint8), [7], name=name)


def written(folder, *names, existing="refuse", capture=CAPTURE):
    writer = SessionWriter(folder, capture, existing)
    with writer:
        return [writer.add(shot(name)) for name in names]


def test_a_session_is_read_as_it_was_written(tmp_path):
    session = Session(
        captures=(
            replace(CAPTURE, exposure_s=0.25, rate_hz=2.0, camera_name="rig_b", state="stopped", shots=("b", "a")),
            replace(CAPTURE, provenance={"version": "1", "inputs": {"x": "y"}}, laser_names=("a", "b", "c")),
        )
    )

    write_session(tmp_path, session)

    assert read_session(tmp_path) == session
    validated(yaml.safe_load((tmp_path / "session.yaml").read_text()), "session")


def test_a_killed_capture_leaves_a_valid_session(tmp_path):
    writer = SessionWriter(tmp_path / "s", CAPTURE)
    with writer:
        writer.add(shot("a"))
        during = read_session(tmp_path / "s")

    assert during.captures[0].state == "capturing"


def test_a_signal_leaves_a_stopped_session_with_its_finished_shots(tmp_path):
    def capture_until_a_signal():
        writer = SessionWriter(tmp_path / "s", CAPTURE)
        with writer:
            writer.add(shot("a"))
            raise SignalReceived(15)

    with pytest.raises(SignalReceived):
        capture_until_a_signal()

    (capture,) = read_session(tmp_path / "s").captures
    assert (capture.state, capture.shots) == ("stopped", ("a",))


@pytest.mark.parametrize("existing", ["refuse", "append", "replace"])
def test_a_folder_that_is_not_a_session_is_rejected(tmp_path, existing):
    (tmp_path / "holiday.jpg").write_bytes(b"")

    with pytest.raises(CannotCreateError, match="exists already" if existing == "refuse" else "no session"):
        written(tmp_path, "a", existing=existing)


@pytest.mark.parametrize("state", ["finished", "capturing"])
def test_replacing_a_session_removes_its_shots_and_nothing_else(tmp_path, state):
    written(tmp_path / "s", "old", "older")
    if state == "capturing":  # the shots of an interrupted capture are not listed
        write_session(tmp_path / "s", Session(captures=(replace(CAPTURE, state="capturing"),)))
    kept = {"notes.txt"} if state == "capturing" else {"notes.txt", "mine.npz"}
    for name in kept:
        (tmp_path / "s" / name).write_text("mine")

    written(tmp_path / "s", "new", existing="replace")

    assert {path.name for path in (tmp_path / "s").iterdir()} == {"new.npz", "session.yaml", *kept}


def test_appending_keeps_the_earlier_capture_and_its_shots_without_temporary_files(tmp_path):
    paths = written(tmp_path / "s", "b", "a")
    assert [read_shot(path).name for path in paths] == ["b", "a"]
    (tmp_path / "s" / ".c.npz.x1y2.part").write_bytes(b"half")  # of a capture that was killed

    written(tmp_path / "s", "c", existing="append", capture=replace(CAPTURE, sequence="all"))

    session = read_session(tmp_path / "s")
    assert session.shots == ("b", "a", "c")
    assert [(capture.sequence, capture.state) for capture in session.captures] == [
        ("off,1,off", "finished"),
        ("all", "finished"),
    ]
    assert {path.name for path in (tmp_path / "s").iterdir()} == {"a.npz", "b.npz", "c.npz", "session.yaml"}


def test_appending_to_an_interrupted_capture_lists_its_shots(tmp_path):
    written(tmp_path / "s", "b", "a")
    cut_off = replace(CAPTURE, state="capturing")
    write_session(tmp_path / "s", Session(captures=(cut_off,)))

    written(tmp_path / "s", "c", existing="append")

    earlier, current = read_session(tmp_path / "s").captures
    assert (earlier.state, earlier.shots) == ("stopped", ("a", "b"))
    assert current.shots == ("c",)


def test_two_shots_of_one_name_are_bad_data_and_the_first_stays(tmp_path):
    writer = SessionWriter(tmp_path / "s", CAPTURE)
    with writer:
        writer.add(shot("a", value=1))
        with pytest.raises(DataError, match="a shot of this name already"):
            writer.add(shot("a", value=2))

    assert read_shot(tmp_path / "s" / "a.npz").images.max() == 1


def test_provenance_has_the_hashes_of_the_inputs(tmp_path):
    (tmp_path / "input").write_bytes(b"abc")
    writer = SessionWriter(tmp_path / "s", CAPTURE)
    with writer:
        writer.read_from(tmp_path / "input")
        writer.add(shot("a"))

    inputs = read_session(tmp_path / "s").captures[0].provenance["inputs"]
    assert inputs == {str(tmp_path / "input"): "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"}


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"state": "done"}, "must be one of capturing, finished, stopped"),
        ({"shots": [1]}, "must be a list of texts"),
        ({"laser_count": 9}, "at most 8"),
        ({"speed": 1}, "unknown key 'speed'"),
    ],
)
def test_an_invalid_session_is_bad_data_with_its_location(tmp_path, change, complaint):
    capture = {"camera": "files:x", "lasers": "none:", "state": "finished", "shots": [], **change}
    (tmp_path / "session.yaml").write_text(yaml.safe_dump({"ringpose": "session/1", "captures": [capture]}))

    with pytest.raises(DataError, match=rf"captures\[0\].*{complaint}"):
        read_session(tmp_path)


def test_a_capture_that_fails_before_its_first_shot_leaves_nothing(tmp_path):
    with pytest.raises(SignalReceived), SessionWriter(tmp_path / "s", CAPTURE):
        raise SignalReceived(15)

    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize("existing", ["append", "replace"])
def test_a_capture_that_fails_before_its_first_shot_keeps_the_earlier_session(tmp_path, existing):
    written(tmp_path / "s", "a")
    before = {path: path.read_bytes() for path in (tmp_path / "s").iterdir()}

    with pytest.raises(SignalReceived), SessionWriter(tmp_path / "s", CAPTURE, existing):
        raise SignalReceived(15)

    assert {path: path.read_bytes() for path in (tmp_path / "s").iterdir()} == before


@pytest.mark.parametrize("existing", ["refuse", "append", "replace"])
def test_a_first_shot_that_cannot_be_written_leaves_the_folder_as_it_was(tmp_path, monkeypatch, existing):
    if existing != "refuse":
        written(tmp_path / "s", "a")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}

    def full(*_, **__):
        raise InputOutputError("a.npz", "no space left on device")

    monkeypatch.setattr("ringpose.files.images.sessions.write_shot", full)
    with pytest.raises(InputOutputError):
        written(tmp_path / "s", "b", existing=existing)

    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == before
    assert (tmp_path / "s").exists() is (existing != "refuse")


@pytest.mark.parametrize("existing", ["refuse", "append", "replace"])
def test_a_capture_without_any_shot_leaves_the_folder_as_it_was(tmp_path, existing):
    if existing != "refuse":
        written(tmp_path / "s", "a")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}

    written(tmp_path / "s", existing=existing)

    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == before
    assert (tmp_path / "s").exists() is (existing != "refuse")


def test_a_folder_that_a_capture_killed_before_its_first_shot_left_is_used_again(tmp_path):
    write_session(tmp_path, Session(captures=(replace(CAPTURE, state="capturing"),)))
    (tmp_path / ".a.npz.x.part").touch()

    written(tmp_path, "a")

    assert read_session(tmp_path).shots == ("a",)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "session.yaml"]


def test_replacing_a_session_by_a_shot_of_the_same_name_keeps_the_new_one(tmp_path):
    written(tmp_path / "s", "a", "b")
    writer = SessionWriter(tmp_path / "s", CAPTURE, "replace")
    with writer:
        writer.add(shot("a", 9))

    assert read_shot(tmp_path / "s/a.npz").images.max() == 9
    assert sorted(path.name for path in (tmp_path / "s").iterdir()) == ["a.npz", "session.yaml"]


@pytest.mark.parametrize("existing", ["append", "replace"])
def test_a_second_capture_into_the_same_folder_is_rejected(tmp_path, existing):
    with SessionWriter(tmp_path / "s", CAPTURE) as _:
        writer = SessionWriter(tmp_path / "s", CAPTURE, existing)
        (tmp_path / "s" / "session.yaml").touch()
        with pytest.raises(CannotCreateError, match="another capture is writing into it"):
            writer.__enter__()


def test_a_killed_capture_leaves_no_lock(tmp_path):
    killed = """
import os, signal
from pathlib import Path
from ringpose.files.images.sessions import SessionWriter
from ringpose.types.session import Capture
SessionWriter(Path("s"), Capture(camera="files:x", lasers="none:")).__enter__()
os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", killed], cwd=tmp_path).returncode == -signal.SIGKILL

    written(tmp_path / "s", "a")

    assert sorted(path.name for path in (tmp_path / "s").iterdir()) == ["a.npz", "session.yaml"]


def test_a_file_system_without_locks_is_accepted(tmp_path, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", no_locks)

    written(tmp_path / "s", "a")

    assert read_session(tmp_path / "s").shots == ("a",)


def test_the_error_that_ended_a_capture_is_reported_although_the_disk_is_full(tmp_path, monkeypatch):
    def full(*_):
        raise InputOutputError("session.yaml", "no space left on device")

    def welded():
        writer = SessionWriter(tmp_path / "s", CAPTURE)
        with writer:
            writer.add(shot("a"))
            monkeypatch.setattr("ringpose.files.images.sessions.write_session", full)
            raise LaserSafetyError("lasers", "laser 2 was seen while all are off")

    with pytest.raises(LaserSafetyError):
        welded()
