import hashlib
import json
from importlib.metadata import version

import cv2
import numpy as np
import pytest

from ringpose.files.npz import Archive
from ringpose.files.records.detections import detection_in


def test_segments_of_any_photograph_need_no_rig(picture, run):
    found = run("detect", picture("lines.png", 20, (100, 300)), "--segments-only")

    (record,) = found.records
    assert found.status == 0
    rows = np.array(record["segments"]["start_px"])[:, 1]
    assert {row for row in (100, 300) if np.abs(rows - row).min() < 3} == {100, 300}


def test_the_papers_segments_end_on_whole_pixels_and_the_refined_ones_between(picture, run):
    file = picture("lines.png", 20, (100, 300))

    length, refined = (
        run("detect", file, "--segments-only", "--method", method).records[0]["segments"]["start_px"]
        for method in ("length", "refined")
    )

    assert not np.mod(length, 1).any()
    assert np.mod(refined, 1).any()


def test_full_record_has_the_stripes(rig, picture, run):
    (record,) = run("detect", picture("line.png", 20, (100,)), "--rig", rig, "--full").records

    assert len(record["stripes"]["sigma_px"]) > 100


def test_folder_takes_one_archive_a_shot_and_names_it(rig, picture, tmp_path, run):
    picture("a.png", 20, (100,))
    picture("b.png", 20, (200,))

    _, names, _ = run("detect", tmp_path, "--rig", rig, "--output", tmp_path / "out")

    assert names == [str(tmp_path / "out" / "a.npz"), str(tmp_path / "out" / "b.npz")]
    assert [detection_in(Archive(tmp_path / "out" / name)).shot for name in ("a.npz", "b.npz")] == ["a", "b"]


def test_archive_says_where_it_came_from(rig, picture, tmp_path, run):
    file = picture("a.png", 20, (100,))

    run("detect", file, "--rig", rig, "--output", tmp_path / "out")

    with np.load(tmp_path / "out" / "a.npz") as archive:
        provenance = json.loads(str(archive["provenance"]))
    assert provenance["version"] == version("ringpose")
    assert provenance["inputs"] == {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in (file, rig)}


def test_archive_is_not_replaced_without_force(picture, tmp_path, run):
    words = ["detect", picture("a.png"), "--segments-only", "--output", tmp_path / "out"]
    run(*words)
    before = (tmp_path / "out" / "a.npz").read_bytes()

    status, _, messages = run(*words)

    assert status == 73
    assert (tmp_path / "out" / "a.npz").read_bytes() == before
    assert "exists already; add --force to replace it" in messages[0]
    assert run(*words, "--force").status == 0


def test_two_shots_of_one_name_do_not_replace_each_other(picture, tmp_path, run):
    (tmp_path / "more").mkdir()
    first, second = picture("a.png", 20, (100,)), picture("more/a.png", 20, (200, 300))

    status, _, messages = run("detect", first, second, "--segments-only", "--output", tmp_path / "out", "--force")

    assert status == 65
    assert "an earlier shot has this name" in messages[0]
    rows = detection_in(Archive(tmp_path / "out" / "a.npz")).segments.start_px[:, 1]
    assert np.abs(rows - 100).min() < 3


def test_overlay_is_a_picture_of_each_shot(picture, tmp_path, run):
    run("detect", picture("a.png", 20, (100,)), "--segments-only", "--overlay", tmp_path / "drawn")

    drawn = cv2.imread(str(tmp_path / "drawn" / "a.png"))
    assert drawn.shape == (480, 640, 3)
    assert (drawn[95:106].max(axis=2) != drawn[95:106].min(axis=2)).any()


def test_record_is_not_a_shot(rig, run, monkeypatch, detections):
    with detections.open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        status, _, messages = run("detect", "-", "--rig", rig)

    assert status == 65
    assert "standard input:1: is a record; give the name of a shot or image" in messages[0]


@pytest.mark.parametrize("shot", ["B_z0500_p00_dim", "B_z0500_p00_normal"])
def test_rendered_shot_has_six_break_points(shared_data, run, shot):
    folder = shared_data / "rendered" / "rig_b"

    found = run("detect", folder / "shots" / f"{shot}.npz", "--rig", folder / "rig.yaml")

    assert found.status == 0
    points = found.records[0]["break_points"]["position_px"]
    assert np.isfinite(np.array(points, dtype=float)).all()


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["--rig", "rig.yaml", "--method", "length"], "--method"),
        (["--segments-only", "--stripes", "segments"], "--stripes"),
        (["--segments-only", "--track"], "--track"),
    ],
)
def test_options_that_would_be_ignored_are_wrong_usage(run, words, option):
    status, out, (message,) = run("detect", "a.png", *words)

    assert (status, out) == (2, [])
    assert option in message
