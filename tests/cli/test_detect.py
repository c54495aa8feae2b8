import hashlib
import json
from importlib.metadata import version

import cv2
import numpy as np
import pytest
from schemas import validated

from ringpose.cli.main import main
from ringpose.files.npz import Archive
from ringpose.files.records.detections import detection_in
from ringpose.types.detection import NoBreakPoints


def test_segments_of_any_photograph_need_no_rig(picture, capsys):
    file = picture("lines.png", 20, (100, 300))

    assert main(["detect", str(file), "--segments-only"]) == 0

    record = validated(json.loads(capsys.readouterr().out))
    rows = np.array(record["segments"]["start_px"])[:, 1]
    assert {row for row in (100, 300) if np.abs(rows - row).min() < 3} == {100, 300}


def test_the_papers_segments_end_on_whole_pixels_and_the_refined_ones_between(picture, capsys):
    file = picture("lines.png", 20, (100, 300))

    for method in ("length", "refined"):
        main(["detect", str(file), "--segments-only", "--method", method])
    length, refined = map(json.loads, capsys.readouterr().out.splitlines())

    assert not np.mod(length["segments"]["start_px"], 1).any()
    assert np.mod(refined["segments"]["start_px"], 1).any()


def test_image_without_a_stripe_is_a_record_with_its_reason(rig, picture, capsys):
    assert main(["detect", str(picture("black.png")), "--rig", str(rig)]) == 3

    record = validated(json.loads(capsys.readouterr().out))
    assert (record["break_points"], record["reason"]) == (None, NoBreakPoints.IMAGE_DARK.value)
    assert "stripes" not in record


def test_full_record_has_the_stripes(rig, picture, capsys):
    main(["detect", str(picture("line.png", 20, (100,))), "--rig", str(rig), "--full"])

    assert len(validated(json.loads(capsys.readouterr().out))["stripes"]["sigma_px"]) > 100


def test_folder_takes_one_archive_a_shot_and_names_it(rig, picture, tmp_path, capsys):
    picture("a.png", 20, (100,))
    picture("b.png", 20, (200,))
    words = ["detect", str(tmp_path), "--rig", str(rig), "--output", str(tmp_path / "out")]

    main(words)

    names = capsys.readouterr().out.splitlines()
    assert names == [str(tmp_path / "out" / "a.npz"), str(tmp_path / "out" / "b.npz")]
    assert [detection_in(Archive(tmp_path / "out" / name)).shot for name in ("a.npz", "b.npz")] == ["a", "b"]


def test_archive_says_where_it_came_from(rig, picture, tmp_path):
    file = picture("a.png", 20, (100,))

    main(["detect", str(file), "--rig", str(rig), "--output", str(tmp_path / "out")])

    with np.load(tmp_path / "out" / "a.npz") as archive:
        provenance = json.loads(str(archive["provenance"]))
    assert provenance["version"] == version("ringpose")
    assert provenance["inputs"] == {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in (file, rig)}


def test_archive_is_not_replaced_without_force(picture, tmp_path, capsys):
    words = ["detect", str(picture("a.png")), "--segments-only", "--output", str(tmp_path / "out")]
    main(words)
    before = (tmp_path / "out" / "a.npz").read_bytes()

    assert main(words) == 73

    assert (tmp_path / "out" / "a.npz").read_bytes() == before
    assert "exists already; add --force to replace it" in capsys.readouterr().err
    assert main([*words, "--force"]) == 0


def test_two_shots_of_one_name_do_not_replace_each_other(picture, tmp_path, capsys):
    (tmp_path / "more").mkdir()
    first, second = picture("a.png", 20, (100,)), picture("more/a.png", 20, (200, 300))
    words = ["detect", str(first), str(second), "--segments-only", "--output", str(tmp_path / "out"), "--force"]

    assert main(words) == 65

    assert "an earlier shot has this name" in capsys.readouterr().err
    rows = detection_in(Archive(tmp_path / "out" / "a.npz")).segments.start_px[:, 1]
    assert np.abs(rows - 100).min() < 3


def test_overlay_is_a_picture_of_each_shot(picture, tmp_path):
    words = ["detect", str(picture("a.png", 20, (100,))), "--segments-only", "--overlay", str(tmp_path / "drawn")]

    main(words)

    drawn = cv2.imread(str(tmp_path / "drawn" / "a.png"))
    assert drawn.shape == (480, 640, 3)
    assert (drawn[95:106].max(axis=2) != drawn[95:106].min(axis=2)).any()


def test_output_below_a_file_cannot_be_created(picture, tmp_path, capsys):
    file = picture("a.png")

    assert main(["detect", str(file), "--segments-only", "--output", str(file / "out")]) == 73

    captured = capsys.readouterr()
    assert (captured.out, captured.err.count("\n")) == ("", 1)


def test_record_is_no_shot(rig, capsys, monkeypatch, detections):
    with detections.open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        assert main(["detect", "-", "--rig", str(rig)]) == 65

    assert "standard input:1: is a record; give the name of a shot or image" in capsys.readouterr().err


@pytest.mark.parametrize("shot", ["B_z0500_p00_dim", "B_z0500_p00_normal"])
def test_rendered_shot_has_six_break_points(shared_data, capsys, shot):
    folder = shared_data / "rendered" / "rig_b"

    assert main(["detect", str(folder / "shots" / f"{shot}.npz"), "--rig", str(folder / "rig.yaml")]) == 0

    points = json.loads(capsys.readouterr().out)["break_points"]["position_px"]
    assert np.isfinite(np.array(points, dtype=float)).all()
