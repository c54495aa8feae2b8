"""`ringpose capture` from files."""

import io
from pathlib import Path

import numpy as np
import pytest
import yaml
from recorded_shots import recorded

from ringpose.files.images.codecs import write_image
from ringpose.files.images.sessions import read_session
from ringpose.files.images.shots import read_shot
from ringpose.types.image import ALL_LASERS

pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.fixture
def capture(run):
    """Runs `ringpose capture` into the session `s`."""
    return lambda *words, camera="files:in", output="s": run("capture", "--camera", camera, "--output", output, *words)


@pytest.mark.parametrize("options", [["--still"], []])
def test_a_target_that_is_held_still_is_stated_in_the_shot(capture, options):
    recorded(Path("in"), "a")

    capture(*options)

    assert read_shot(Path("s/a.npz")).still == bool(options)


def test_recorded_shots_keep_their_names_masks_and_stamps(capture):
    for name in ("b", "a"):
        recorded(Path("in"), name)

    status, out, _ = capture()

    assert (status, out) == (0, ["s/a.npz", "s/b.npz"])
    shot = read_shot(Path("s/a.npz"))
    assert shot.lasers.tolist() == [0, 1, 2, 4, 7]
    assert shot.stamp_s.tolist() == [100.0, 101.0, 102.0, 103.0, 104.0]


def test_a_sequence_chooses_frames(capture):
    recorded(Path("in"), "a")

    assert capture("--sequence", "all,off,2").status == 0

    shot = read_shot(Path("s/a.npz"))
    assert shot.lasers.tolist() == [7, 0, 2]
    assert shot.images[:, 0, 0].tolist() == [4, 0, 2]


def test_a_shot_without_the_frame_is_named_and_the_rest_goes_on(capture):
    recorded(Path("in"), "a", (0, 7))
    recorded(Path("in"), "b", (0, 1, 7))

    status, out, messages = capture("--sequence", "1")

    assert (status, out) == (65, ["s/b.npz"])
    assert messages == ["ringpose capture: a: no frame with lasers 1; its frames: off,1+2+3"]


def test_a_sequence_that_the_recording_lacks_leaves_the_folder_free_for_the_corrected_command(capture):
    recorded(Path("in"), "a", (0, 7))

    lacking = capture("--sequence", "off,1")
    left = Path("s").exists()
    corrected = capture("--sequence", "off,all")

    assert (lacking.status, left) == (65, False)
    assert (corrected.status, corrected.out) == (0, ["s/a.npz"])


def test_a_damaged_shot_is_named_and_the_rest_goes_on(capture):
    whole = recorded(Path("in"), "b").read_bytes()
    Path("in/a.npz").write_bytes(whole[: len(whole) // 2])

    status, out, (message,) = capture()

    assert (status, out) == (65, ["s/b.npz"])
    assert "in/a.npz" in message
    assert read_session(Path("s")).shots == ("b",)


@pytest.mark.parametrize(
    ("camera", "words", "chosen"),
    [
        ("files:in/*_dim.npz", [], ["a_dim", "b_dim"]),
        ("files:-", [], ["b_dim", "a_dim"]),
        ("files:in", ["--count", 2], ["a_dim", "a_sun"]),
    ],
)
def test_shots_are_chosen_by_a_pattern_by_names_on_standard_input_or_a_count(
    capture, monkeypatch, camera, words, chosen
):
    for name in ("a_dim", "a_sun", "b_dim"):
        recorded(Path("in"), name)
    monkeypatch.setattr("sys.stdin", io.StringIO("in/b_dim.npz\nin/a_dim.npz\n"))

    status, out, _ = capture(*words, camera=camera)

    assert (status, out) == (0, [f"s/{name}.npz" for name in chosen])


def test_photographs_with_the_lasers_off_and_on_in_two_folders_are_shots_of_two_frames(capture, monkeypatch):
    for folder, grey in (("off", 9), ("on", 90)):
        Path(folder).mkdir()
        for name in ("x.png", "y.png"):
            write_image(Path(folder, name), np.full((4, 6), grey, np.uint8))
    monkeypatch.setattr("sys.stdin", io.StringIO("off/x.png\non/x.png\noff/y.png\non/y.png\n"))

    status, out, _ = capture("--sequence", "off,1", camera="files:-")

    assert (status, out) == (0, ["s/x.npz", "s/y.npz"])
    shot = read_shot(Path("s/y.npz"))
    assert (shot.lasers.tolist(), shot.images[:, 0, 0].tolist()) == ([0, 1], [9, 90])


def test_images_are_shots_of_one_frame_with_all_lasers_on(capture):
    Path("in").mkdir()
    write_image(Path("in/x.png"), np.full((4, 6), 9, np.uint8))

    assert capture().status == 0

    shot = read_shot(Path("s/x.npz"))
    assert (shot.lasers.tolist(), shot.images[0, 0, 0]) == ([ALL_LASERS], 9)


def test_consecutive_images_make_shots_and_the_odd_one_is_named(capture):
    Path("in").mkdir()
    for number in range(5):
        write_image(Path(f"in/{number}.png"), np.full((4, 6), number, np.uint8))

    status, out, messages = capture("--sequence", "off,all")

    assert (status, out) == (65, ["s/0.npz", "s/2.npz"])
    assert messages == ["ringpose capture: 4: 1 of 2 images for a last shot; check --sequence"]
    shot = read_shot(Path("s/2.npz"))
    assert shot.lasers.tolist() == [0, ALL_LASERS]
    assert shot.images[:, 0, 0].tolist() == [2, 3]


def test_the_session_file_states_what_was_done(capture):
    recorded(Path("in"), "a")

    capture("--sequence", "off,all", "--rate", "50")

    (session,) = yaml.safe_load(Path("s/session.yaml").read_text())["captures"]
    provenance = session.pop("provenance")
    assert session == {
        "camera": "files:in",
        "lasers": "none:",
        "sequence": "off,all",
        "rate_hz": 50.0,
        "state": "finished",
        "shots": ["a"],
    }
    assert list(provenance["inputs"]) == ["in/a.npz"]


def test_without_an_output_the_folder_is_named_by_the_time(run):
    recorded(Path("in"), "a")

    _, out, _ = run("capture", "--camera", "files:in")

    (session,) = Path().glob("session-*Z")
    assert out == [f"{session}/a.npz"]


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
        (["--camera", "files:in", "--settle", "0.1"], 2, "--settle"),
        (["--camera", "files:in", "--allow-unseen"], 2, "--allow-unseen"),
        (["--camera", "files:in", "--settle", "soon"], 2, '"soon"; give auto, or seconds from 0 to 10'),
        (["--camera", "files:in", "--settle", "-1"], 2, '"-1"; give auto, or seconds from 0 to 10'),
        (["--camera", "files:in", "--settle", "nan"], 2, '"nan"; give auto, or seconds from 0 to 10'),
        (["--camera", "files:in", "--sequence", "1@4ms"], 2, "what is recorded has been exposed"),
        (["--camera", "sim:nowhere.yaml"], 66, "nowhere.yaml: does not exist"),
        ([], 2, "--camera"),
    ],
)  # fmt: skip
def test_what_cannot_be_captured_leaves_nothing_behind(run, words, status, complaint):
    recorded(Path("in"), "a")
    Path("empty").mkdir()

    ended, out, (message,) = run("capture", *words, "--output", "s")

    assert (ended, out) == (status, [])
    assert complaint in message
    assert not Path("s").exists()


def test_a_session_is_not_overwritten_unasked(capture):
    recorded(Path("in"), "a")
    capture()
    before = Path("s/session.yaml").read_text()

    status, _, (message,) = capture()

    assert status == 73
    assert "add --append to go on with it, or --force" in message
    assert Path("s/session.yaml").read_text() == before


def test_force_replaces_a_session_and_append_goes_on_with_it(capture):
    for name in "abc":
        recorded(Path(name), name)
    capture(camera="files:a")

    replaced = capture("--force", camera="files:b")
    appended = capture("--append", camera="files:c")

    assert (replaced.status, appended.status) == (0, 0)
    assert sorted(path.name for path in Path("s").iterdir()) == ["b.npz", "c.npz", "session.yaml"]
    assert read_session(Path("s")).shots == ("b", "c")


@pytest.mark.parametrize("camera", ["files:s", "files:s/*.npz", "files:*/*.npz", "files:-"])
@pytest.mark.parametrize("existing", ["--force", "--append"])
def test_a_session_is_not_captured_from_itself(capture, monkeypatch, camera, existing):
    recorded(Path("in"), "a")
    capture()
    before = {path: path.read_bytes() for path in Path("s").iterdir()}
    monkeypatch.setattr("sys.stdin", io.StringIO("s/a.npz\n"))

    status, _, messages = capture(existing, camera=camera, output=f"../{Path.cwd().name}/s")

    assert status == 2
    assert "is where the shots are read from" in messages[0]
    assert {path: path.read_bytes() for path in Path("s").iterdir()} == before


@pytest.mark.parametrize(
    ("output", "status", "word"), [("-", 2, "--output"), (300 * "a", 73, "too long"), ("file/s", 73, "file/s")]
)
def test_an_output_that_cannot_be_a_folder_is_one_line(capture, output, status, word):
    recorded(Path("in"), "a")
    Path("file").write_text("")

    ended, _, (message,) = capture(output=output)

    assert ended == status
    assert word in message
    assert not Path("-").exists()


def test_a_shot_whose_name_has_a_line_break_is_kept_and_named_on_standard_error(capture):
    for name in ("a\nb", "c"):
        recorded(Path("in"), name)

    status, out, messages = capture()

    assert (status, out) == (65, ["s/c.npz"])
    assert "line break; rename it" in "".join(messages)
    assert read_session(Path("s")).shots == ("a\nb", "c")
