"""`ringpose capture` from files."""

import io
from pathlib import Path

import numpy as np
import pytest
import yaml
from recorded_shots import recorded

from ringpose.cli.main import main
from ringpose.files.images.codecs import write_image
from ringpose.files.images.sessions import read_session
from ringpose.files.images.shots import read_shot
from ringpose.types.image import ALL_LASERS


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("options", [["--still"], []])
def test_a_target_that_is_held_still_is_stated_in_the_shot(options):
    recorded(Path("in"), "a")

    main(["capture", "--camera", "files:in", "--output", "s", *options])

    assert read_shot(Path("s/a.npz")).still == bool(options)


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


def test_a_shot_whose_name_is_no_line_is_kept_and_named_on_standard_error(capsys):
    for name in ("a\nb", "c"):
        recorded(Path("in"), name)

    status = main(["capture", "--camera", "files:in", "--output", "s"])

    streams = capsys.readouterr()
    assert (status, streams.out) == (65, "s/c.npz\n")
    assert "line break; rename it" in streams.err
    assert read_session(Path("s")).shots == ("a\nb", "c")
