"""Each kind of bad input is one line on stderr and its status, and does not stop the rest of a batch."""

import io
import json

import numpy as np
import pytest
import yaml

from ringpose.cli.main import main

SIZE = (480, 640)


def npz(path, **changes):
    values = {
        "images": np.full((2, *SIZE), 20, np.uint8),
        "lasers": np.array([0, 7], np.uint8),
        "stamp_s": np.array([1.0, 1.1]),
        "exposure_s": np.array([0.005, 0.005]),
    }
    np.savez(path, **{key: value for key, value in (values | changes).items() if value is not None})
    return path


def broken_image(folder, picture):
    path = folder / "bad.png"
    path.write_bytes(picture("whole.png", 90).read_bytes()[:-40])
    return path


def wrong_format(folder, picture):
    (folder / "bad.tif").write_text("I am a text")
    return folder / "bad.tif"


def empty_file(folder, picture):
    (folder / "bad.npz").touch()
    return folder / "bad.npz"


def empty_folder(folder, picture):
    (folder / "empty").mkdir()
    return folder / "empty"


BAD = {
    "truncated image": (broken_image, 65, "cut short"),
    "wrong format": (wrong_format, 65, "is not an image"),
    "empty file": (empty_file, 65, "is not an NPZ archive"),
    "missing file": (lambda folder, picture: folder / "bad.npz", 66, "does not exist"),
    "empty folder": (empty_folder, 66, "holds no file that ends with"),
    "NPZ without a key": (lambda folder, picture: npz(folder / "bad.npz", lasers=None), 65, "has no key 'lasers'"),
    "NaN": (
        lambda folder, picture: npz(folder / "bad.npz", stamp_s=np.array([1, np.nan])),
        65,
        "stamp_s: has a number that is not finite",
    ),
    "stamps in milliseconds": (
        lambda folder, picture: npz(folder / "bad.npz", stamp_s=np.array([1.7e12, 1.7e12 + 100.0])),
        65,
        "stamp_s: is 1.7e+12, which is after the year 2100; give seconds",
    ),
    "no frame": (
        lambda folder, picture: npz(folder / "bad.npz", images=np.zeros((0, *SIZE), np.uint8)),
        65,
        "images: has 0 frames",
    ),
    "fourth laser": (
        lambda folder, picture: npz(folder / "bad.npz", lasers=np.array([0, 8], np.uint8)),
        65,
        "lasers: frame 1 names laser 4, the rig has 3",
    ),
    "another size": (
        lambda folder, picture: picture("bad.png", size=(300, 400)),
        65,
        "400 x 300 pixels, the rig's camera has 640 x 480",
    ),
}


@pytest.mark.parametrize("command", [pytest.param("detect", marks=pytest.mark.slow), "pose"])
@pytest.mark.parametrize("case", BAD)
def test_bad_shot_is_one_line_and_the_good_ones_come_out(rig, picture, tmp_path, capfd, command, case):
    make, status, finding = BAD[case]
    first, last = picture("first.png"), picture("last.png")
    bad = make(tmp_path, picture)

    assert main([command, str(first), str(bad), str(last), "--rig", str(rig)]) == status

    captured = capfd.readouterr()
    assert [json.loads(line)["shot"] for line in captured.out.splitlines()] == ["first", "last"]
    assert captured.err.startswith(f"ringpose {command}: ")
    assert finding in captured.err
    assert captured.err.count("\n") == 1


@pytest.mark.parametrize("command", ["detect", "pose"])
@pytest.mark.parametrize(
    ("grey", "rows", "reason"),
    [(0, (), "the image is dark"), (255, (), "the image is saturated"), (20, (200,), "stripe")],
    ids=["black", "white", "single stripe"],
)
def test_image_that_shows_no_ring_is_a_record_with_a_reason(rig, picture, run, command, grey, rows, reason):
    found = run(command, picture("a.png", grey, rows), "--rig", rig)

    assert (found.status, found.messages) == (3, [])
    assert reason in found.records[0]["reason"]


@pytest.mark.parametrize("command", ["detect", "pose"])
@pytest.mark.parametrize(
    ("is_there", "status", "finding"),
    [(True, 65, "lasers[0].distance_m: is -100, must be -5 to 5; give metres"), (False, 66, "does not exist")],
    ids=["bad", "missing"],
)
def test_bad_rig_is_one_line_before_anything_is_read(rig, run, command, is_there, status, finding):
    values = yaml.safe_load(rig.read_text())
    values["lasers"][0]["distance_m"] = -100.0
    rig.write_text(yaml.safe_dump(values)) if is_there else rig.unlink()

    ended, out, (message,) = run(command, "never-read.png", "--rig", rig)

    assert (ended, out) == (status, [])
    assert message.startswith(f"ringpose {command}: {rig}: {finding}")


@pytest.mark.parametrize("folder", ["/proc", "/dev/null"])
def test_unwritable_output_is_one_line(picture, run, folder):
    status, out, (message,) = run("detect", picture("a.png"), "--segments-only", "--output", f"{folder}/ringpose")

    assert (status, out) == (73, [])
    assert message.startswith(f"ringpose detect: {folder}/ringpose: cannot be written: ")


@pytest.mark.parametrize("words", [["detect"], ["pose"], ["pose", "--jobs", 2]])
def test_an_empty_standard_input_is_no_input(rig, run, monkeypatch, words):
    monkeypatch.setattr("sys.stdin", io.StringIO("\n"))

    status, out, (message,) = run(*words, "-", "--rig", rig)

    assert (status, out) == (66, [])
    assert message.startswith(f"ringpose {words[0]}: standard input: is empty")


@pytest.mark.parametrize("command", ["pose", "track"])
def test_a_file_without_a_record_is_one_line(rig, run, tmp_path, command):
    (tmp_path / "empty.jsonl").touch()

    status, out, (message,) = run(command, tmp_path / "empty.jsonl", "--rig", rig)

    assert (status, out) == (65, [])
    assert "empty.jsonl: holds no record" in message


def test_records_of_another_kind_are_reported_once_and_counted(rig, detections, run):
    status, out, (first, counted) = run("track", detections, "--rig", rig)

    assert (status, out) == (65, [])
    assert first.startswith(f"ringpose track: {detections}:1: schema: ")
    assert counted.startswith(f"ringpose track: {detections}: the same in 2 further records: schema: ")


def test_findings_that_differ_are_reported_each(rig, detections, run):
    first, second, third = map(json.loads, detections.read_text().splitlines())
    changes = {"labelled": 1}, {"labelled": 1}, {"flags": 1}
    records = [
        each | {"break_points": each["break_points"] | change}
        for each, change in zip((first, second, third), changes, strict=True)
    ]
    detections.write_text("".join(json.dumps(each) + "\n" for each in records))

    messages = run("pose", detections, "--rig", rig).messages

    assert [message.removeprefix(f"ringpose pose: {detections}").split(": ")[:2] for message in messages] == [
        [":1", "break_points.labelled"],
        [":3", "break_points.flags"],
        ["", "the same in 1 further record"],
    ]


def test_findings_that_differ_in_a_number_are_reported_once_and_counted(rig, run, tmp_path):
    broken = tmp_path / "broken.jsonl"
    broken.write_text("".join(f'{{"shot": {" " * spaces}?}}\n' for spaces in range(3)))

    first, counted = run("pose", broken, "--rig", rig).messages

    assert first.startswith(f"ringpose pose: {broken}:1: is not valid JSON")
    assert "2 further records" in counted


def test_a_file_of_records_is_no_shot(rig, detections, run):
    status, _, (message,) = run("detect", detections, "--rig", rig)

    assert status == 65
    assert "is a file of records" in message


@pytest.mark.parametrize("option", ["--output", "--overlay"])
def test_a_file_where_a_folder_is_needed_is_named_as_such(picture, run, tmp_path, option):
    (tmp_path / "file").touch()

    status, _, (message,) = run("detect", picture("a.png"), "--segments-only", option, tmp_path / "file")

    assert status == 73
    assert "file: is not a folder" in message


def test_a_session_in_place_of_a_file_is_refused(picture, run, tmp_path):
    (tmp_path / "file").touch()

    status, _, (message,) = run("capture", "--camera", f"files:{picture('a.png')}", "--output", tmp_path / "file")

    assert status == 73
    assert "file: is not a folder" in message
