"""`ringpose capture`, from files and from a simulated scene."""

import fcntl
import io
import os
import resource
import signal
import termios
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from small_rig import SMALL_RIG

from ringpose.cli.main import main
from ringpose.files.images import write_image
from ringpose.files.sessions import read_session
from ringpose.files.shots import read_shot, write_shot
from ringpose.types.frame import ALL_LASERS, Shot

SMALL_SCENE = """\
ringpose: scene/1
rig: rig.yaml
ring: {radius_inner_m: 0.567, radius_outer_m: 0.597, height_m: 0.06}
body: {size_m: [1.6, 1.6, 1.0]}
stripe_dn: 200
sequence: off,all
trajectory:
- generate: {count: 3, distances_m: [0.5], tilt_rad: 0.05}
"""


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "rig.yaml").write_text(SMALL_RIG)
    (tmp_path / "scene.yaml").write_text(SMALL_SCENE)
    return tmp_path / "scene.yaml"


def recorded(folder: Path, name: str, masks: tuple[int, ...] = (0, 1, 2, 4, 7)) -> Path:
    """A shot whose frame k is all k."""
    folder.mkdir(exist_ok=True)
    frames = np.arange(len(masks))
    shot = Shot(
        name=name,
        images=np.broadcast_to(frames.astype(np.uint8)[:, None, None], (len(masks), 4, 6)),
        lasers=np.array(masks, dtype=np.uint8),
        stamp_s=100.0 + frames,
        exposure_s=np.full(len(masks), 0.01),
    )
    write_shot(folder / f"{name}.npz", shot)
    return folder / f"{name}.npz"


def test_recorded_shots_keep_their_names_masks_and_stamps(capsys):
    for name in ("b", "a"):
        recorded(Path("in"), name)

    status = main(["capture", "--camera", "files:in", "--output", "s"])

    assert status == 0
    assert capsys.readouterr().out.splitlines() == ["s/a.npz", "s/b.npz"]
    shot = read_shot(Path("s/a.npz"))
    assert shot.lasers.tolist() == [0, 1, 2, 4, 7]
    assert shot.stamp_s.tolist() == [100.0, 101.0, 102.0, 103.0, 104.0]


def test_a_sequence_chooses_frames(capsys):
    recorded(Path("in"), "a")

    status = main(["capture", "--camera", "files:in", "--sequence", "all,off,2", "--output", "s"])

    assert status == 0
    shot = read_shot(Path("s/a.npz"))
    assert shot.lasers.tolist() == [7, 0, 2]
    assert shot.images[:, 0, 0].tolist() == [4, 0, 2]


def test_a_shot_without_the_frame_is_named_and_the_rest_goes_on(capsys):
    recorded(Path("in"), "a", (0, 7))
    recorded(Path("in"), "b", (0, 1, 7))

    status = main(["capture", "--camera", "files:in", "--sequence", "1", "--output", "s"])

    streams = capsys.readouterr()
    assert status == 65
    assert streams.out == "s/b.npz\n"
    assert streams.err.splitlines() == ["ringpose: a: no frame with lasers 1; its frames: off,1+2+3"]


def test_a_damaged_shot_is_named_and_the_rest_goes_on(capsys):
    whole = recorded(Path("in"), "b").read_bytes()
    Path("in/a.npz").write_bytes(whole[: len(whole) // 2])

    status = main(["capture", "--camera", "files:in", "--output", "s"])

    streams = capsys.readouterr()
    assert status == 65
    assert streams.out == "s/b.npz\n"
    assert len(streams.err.splitlines()) == 1
    assert "in/a.npz" in streams.err
    assert read_session(Path("s")).shots == ("b",)


def test_a_pattern_chooses_files(capsys):
    for name in ("a_dim", "a_sun", "b_dim"):
        recorded(Path("in"), name)

    main(["capture", "--camera", "files:in/*_dim.npz", "--output", "s"])

    assert capsys.readouterr().out.splitlines() == ["s/a_dim.npz", "s/b_dim.npz"]


def test_names_may_come_on_standard_input(capsys, monkeypatch):
    recorded(Path("in"), "a")
    recorded(Path("in"), "b")
    monkeypatch.setattr("sys.stdin", io.StringIO("in/b.npz\nin/a.npz\n"))

    main(["capture", "--camera", "files:-", "--output", "s"])

    assert capsys.readouterr().out.splitlines() == ["s/b.npz", "s/a.npz"]


def test_images_are_shots_of_one_frame_with_all_lasers_on():
    Path("in").mkdir()
    write_image(Path("in/x.png"), np.full((4, 6), 9, np.uint8))

    status = main(["capture", "--camera", "files:in", "--output", "s"])

    shot = read_shot(Path("s/x.npz"))
    assert status == 0
    assert (shot.lasers.tolist(), shot.images[0, 0, 0]) == ([ALL_LASERS], 9)


def test_consecutive_images_make_shots_and_the_odd_one_is_named(capsys):
    Path("in").mkdir()
    for number in range(5):
        write_image(Path(f"in/{number}.png"), np.full((4, 6), number, np.uint8))

    status = main(["capture", "--camera", "files:in", "--sequence", "off,all", "--output", "s"])

    streams = capsys.readouterr()
    assert status == 65
    assert streams.out.splitlines() == ["s/0.npz", "s/2.npz"]
    assert streams.err == "ringpose: 4: 1 of 2 images for a last shot; check --sequence\n"


def test_count_ends_a_recording_early(capsys):
    for name in "abc":
        recorded(Path("in"), name)

    status = main(["capture", "--camera", "files:in", "--count", "2", "--output", "s"])

    assert status == 0
    assert capsys.readouterr().out.splitlines() == ["s/a.npz", "s/b.npz"]


def test_the_session_file_says_what_was_done():
    recorded(Path("in"), "a")

    main(["capture", "--camera", "files:in", "--sequence", "off,all", "--rate", "50", "--output", "s"])

    (capture,) = yaml.safe_load(Path("s/session.yaml").read_text())["captures"]
    provenance = capture.pop("provenance")
    assert capture == {
        "camera": "files:in",
        "lasers": "none:",
        "sequence": "off,all",
        "rate_hz": 50.0,
        "state": "finished",
        "shots": ["a"],
    }
    assert list(provenance["inputs"]) == ["in/a.npz"]


def test_without_an_output_the_folder_is_named_by_the_time(capsys):
    recorded(Path("in"), "a")

    main(["capture", "--camera", "files:in"])

    (session,) = Path().glob("session-*Z")
    assert capsys.readouterr().out == f"{session}/a.npz\n"


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (["--camera", "files:nowhere"], 66, "nowhere: does not exist"),
        (["--camera", "files:no*where"], 66, "no*where: does not exist"),
        (["--camera", "files:empty"], 66, "empty: holds no file"),
        (["--camera", "files:" + 300 * "a"], 66, "file name too long"),
        (["--camera", "usb:0"], 2, 'names no device; it begins with one of '),
        (["--camera", "files:in", "--lasers", "sim:"], 2, '"sim:" cannot light what is recorded'),
        (["--camera", "files:in", "--lasers", "none:3"], 2, '"none:3" cannot light what is recorded'),
        (["--camera", "files:in", "--exposure", "0.1"], 2, "what is recorded has been exposed"),
        (["--camera", "files:in", "--sequence", "on"], 2, 'step 1 is "on"'),
        (["--camera", "files:in", "--force", "--append"], 2, "contradict"),
        (["--camera", "files:in", "--count", "0"], 2, "--count"),
        (["--camera", "files:in", "--count", 20 * "9"], 2, "--count"),
        (["--camera", "files:in", "--lasers", ""], 2, '"" names no device'),
        (["--camera", "files:in", "--sequence", 5000 * "9"], 2, "a step is off, all, or laser numbers"),
        (["--camera", "files:in", "--sequence", "1@" + 5000 * "9" + "s"], 2, "has no exposure after its @"),
        (["--camera", "files:in", "--settle", "soon"], 2, '"soon"; it is auto, or seconds from 0 to 10'),
        (["--camera", "files:in", "--settle", "-1"], 2, '"-1"; it is auto, or seconds from 0 to 10'),
        (["--camera", "files:in", "--settle", "nan"], 2, '"nan"; it is auto, or seconds from 0 to 10'),
        (["--camera", "files:in", "--sequence", "1@4ms"], 2, "what is recorded has been exposed"),
        (["--camera", "sim:nowhere.yaml"], 66, "nowhere.yaml: does not exist"),
        ([], 2, "--camera"),
    ],
)  # fmt: skip
def test_what_cannot_be_captured_leaves_nothing_behind(capsys, words, status, complaint):
    recorded(Path("in"), "a")
    Path("empty").mkdir()

    ended = main(["capture", *words, "--output", "s"])

    streams = capsys.readouterr()
    assert (ended, streams.out) == (status, "")
    assert len(streams.err.splitlines()) == 1
    assert complaint in streams.err
    assert not Path("s").exists()


def test_a_session_is_not_overwritten_unasked(capsys):
    recorded(Path("in"), "a")
    main(["capture", "--camera", "files:in", "--output", "s"])
    before = Path("s/session.yaml").read_text()

    status = main(["capture", "--camera", "files:in", "--output", "s"])

    assert status == 73
    assert "add --append to go on with it, or --force" in capsys.readouterr().err
    assert Path("s/session.yaml").read_text() == before


def test_force_replaces_a_session_and_append_goes_on_with_it():
    recorded(Path("one"), "a")
    recorded(Path("two"), "b")
    recorded(Path("three"), "c")
    main(["capture", "--camera", "files:one", "--output", "s"])

    replaced = main(["capture", "--camera", "files:two", "--output", "s", "--force"])
    appended = main(["capture", "--camera", "files:three", "--output", "s", "--append"])

    assert (replaced, appended) == (0, 0)
    assert sorted(path.name for path in Path("s").iterdir()) == ["b.npz", "c.npz", "session.yaml"]
    assert read_session(Path("s")).shots == ("b", "c")


@pytest.mark.parametrize("camera", ["files:s", "files:s/*.npz", "files:*/*.npz", "files:-"])
@pytest.mark.parametrize("existing", ["--force", "--append"])
def test_a_session_is_not_captured_from_itself(capsys, monkeypatch, camera, existing):
    recorded(Path("in"), "a")
    main(["capture", "--camera", "files:in", "--output", "s"])
    before = {path: path.read_bytes() for path in Path("s").iterdir()}
    monkeypatch.setattr("sys.stdin", io.StringIO("s/a.npz\n"))

    status = main(["capture", "--camera", camera, "--output", "../" + Path.cwd().name + "/s", existing])

    assert status == 2
    assert "is where the shots are read from" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in Path("s").iterdir()} == before


def test_a_session_is_no_stream(capsys):
    recorded(Path("in"), "a")

    status = main(["capture", "--camera", "files:in", "--output", "-"])

    assert (status, capsys.readouterr().err.count("\n")) == (2, 1)
    assert not Path("-").exists()


def test_an_output_whose_name_no_folder_can_have_is_one_line(capsys):
    recorded(Path("in"), "a")

    status = main(["capture", "--camera", "files:in", "--output", 300 * "a"])

    assert (status, capsys.readouterr().err.count("\n")) == (73, 1)


def test_an_output_that_cannot_be_made_is_one_line(capsys):
    recorded(Path("in"), "a")
    Path("file").write_text("")

    status = main(["capture", "--camera", "files:in", "--output", "file/s"])

    assert status == 73
    assert "file/s" in capsys.readouterr().err


def test_a_scene_is_captured_under_the_names_of_its_views(scene, capsys):
    status = main(["capture", "--camera", f"sim:{scene}", "--count", "2", "--output", "s"])

    names = [Path(line).stem for line in capsys.readouterr().out.splitlines()]
    assert status == 0
    assert names == ["z0500_p00_dim", "z0500_p01_dim"]
    shot = read_shot(Path("s") / f"{names[0]}.npz")
    assert shot.lasers.tolist() == [0, 7]
    assert shot.read_lasers is not None
    assert shot.read_lasers.tolist() == [0, 7]
    assert shot.images[0].max() < 50 < shot.images[1].max()


def test_a_simulated_shot_lights_one_laser_after_the_other(scene):
    main(["capture", "--camera", f"sim:{scene}", "--sequence", "1,2,3", "--count", "1", "--output", "s"])

    shot = read_shot(Path("s/z0500_p00_dim.npz"))
    rows = [int(np.argmax((image > 60).sum(axis=1))) for image in shot.images]
    assert shot.lasers.tolist() == [1, 2, 4]
    assert len(set(rows)) == 3


def test_the_exposure_that_is_asked_for_is_taken(scene):
    main(["capture", "--camera", f"sim:{scene}", "--exposure", "0.002", "--count", "1", "--output", "s"])

    assert read_shot(Path("s/z0500_p00_dim.npz")).exposure_s.tolist() == [0.002, 0.002]


def test_the_session_of_a_scene_names_camera_lasers_and_sequence(scene):
    main(["capture", "--camera", f"sim:{scene}", "--count", "1", "--output", "s"])

    (capture,) = read_session(Path("s")).captures
    assert (capture.camera_name, capture.laser_count, capture.lasers) == ("small", 3, "sim:")
    assert capture.sequence == "off,all"
    assert list(capture.provenance["inputs"]) == [str(scene)]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--sequence", "off,4"], 'step "4" names laser 4 of a rig with 3 lasers'),
        (["--lasers", "none:", "--sequence", "off,all"], 'nothing switches the lasers for step "off"'),
    ],
)
def test_lasers_that_cannot_do_a_step_are_wrong_usage(scene, capsys, words, complaint):
    status = main(["capture", "--camera", f"sim:{scene}", *words, "--output", "s"])

    assert status == 2
    assert complaint in capsys.readouterr().err
    assert not Path("s").exists()


def test_lasers_that_nothing_switches_are_on(scene):
    status = main(["capture", "--camera", f"sim:{scene}", "--lasers", "none:", "--count", "1", "--output", "s"])

    shot = read_shot(Path("s/z0500_p00_dim.npz"))
    assert status == 0
    assert shot.lasers.tolist() == [7]
    assert shot.images.max() > 100


A_MINUTE_EACH = ("capture", "--camera", "files:in", "--rate", "0.016", "--output", "s")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_leaves_finished_shots_and_a_valid_session(number, started):
    for name in "abc":
        recorded(Path("in"), name)
    with started(*A_MINUTE_EACH) as process:
        first = process.stdout.readline()

        process.send_signal(number)
        out, err = process.communicate(timeout=30)

    assert process.returncode == 128 + number
    assert (first, out, err) == ("s/a.npz\n", "", "")
    (capture,) = read_session(Path("s")).captures
    assert (capture.state, capture.shots) == ("stopped", ("a",))
    assert sorted(path.name for path in Path("s").iterdir()) == ["a.npz", "session.yaml"]


def test_the_first_name_is_out_before_the_second_shot_is_taken(started):
    for name in "ab":
        recorded(Path("in"), name)
    began_s = time.monotonic()
    with started(*A_MINUTE_EACH) as process:
        first = process.stdout.readline()
        process.terminate()

    assert first == "s/a.npz\n"
    assert time.monotonic() - began_s < 30


def test_a_reader_that_goes_away_ends_the_capture_with_a_valid_session(started):
    for name in "abcdef":
        recorded(Path("in"), name)
    with started("capture", "--camera", "files:in", "--rate", "5", "--output", "s") as process:
        process.stdout.readline()
        process.stdout.close()
        said = process.stderr.read()
        status = process.wait(timeout=30)

    assert (status, said) == (141, "")
    assert read_session(Path("s")).captures[0].state == "stopped"


def test_a_full_disk_keeps_what_was_finished(started, rng):
    """No file may grow beyond 5 kB here; noise does not compress."""
    for name in "ab":
        recorded(Path("in"), name)
    noise = rng.integers(0, 256, (1, 120, 160), dtype=np.uint8)
    write_shot(
        Path("in/z.npz"),
        Shot(name="z", images=noise, lasers=np.zeros(1, np.uint8), stamp_s=np.zeros(1), exposure_s=np.zeros(1)),
    )
    words = ["capture", "--camera", "files:in", "--output", "s"]

    with started(*words, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (5_000, 5_000))) as process:
        out, said = process.communicate(timeout=60)

    assert (process.returncode, out) == (74, "s/a.npz\ns/b.npz\n")
    assert said.startswith("ringpose: s/z.npz: writing broke off: ")
    (capture,) = read_session(Path("s")).captures
    assert (capture.state, capture.shots) == ("stopped", ("a", "b"))


def test_progress_is_shown_on_a_terminal_and_names_alone_go_out(started):
    for name in "ab":
        recorded(Path("in"), name)
    screen, terminal = os.openpty()

    with started("capture", "--camera", "files:in", "--output", "s", stderr=terminal) as process:
        out, _ = process.communicate(timeout=60)
    shown = os.read(screen, 65536).decode()
    os.close(screen)
    os.close(terminal)

    assert out == "s/a.npz\ns/b.npz\n"
    assert "2 shots" in shown


@pytest.mark.parametrize(("ignored", "status"), [(True, 0), (False, 129)])
def test_a_terminal_that_goes_away_takes_no_shot_with_it(started, ignored, status):
    for name in "abcdef":
        recorded(Path("in"), name)
    screen, terminal = os.openpty()

    def belongs_to_the_terminal():
        os.setsid()
        fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)
        signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)

    words = ["capture", "--camera", "files:in", "--rate", "5", "--output", "s"]
    with started(*words, stderr=terminal, preexec_fn=belongs_to_the_terminal) as process:
        process.stdout.readline()
        os.close(terminal)
        os.close(screen)
        process.stdout.read()

    assert process.returncode == status
    assert (len(read_session(Path("s")).shots) == 6) is ignored


def test_a_shot_whose_name_is_no_line_is_kept_and_named_on_standard_error(capsys):
    for name in ("a\nb", "c"):
        recorded(Path("in"), name)

    status = main(["capture", "--camera", "files:in", "--output", "s"])

    streams = capsys.readouterr()
    assert (status, streams.out) == (65, "s/c.npz\n")
    assert "it has a line break; rename it" in streams.err
    assert read_session(Path("s")).shots == ("a\nb", "c")
