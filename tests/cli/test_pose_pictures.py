"""`ringpose pose --overlay` and `--report`."""

import base64
import re

import cv2
import numpy as np
import pytest


def test_pictures_do_not_change_the_lines(carried_data, tmp_path, run):
    shot, rig = carried_data / "rig_b/shots/B_z0500_p01_dim.npz", carried_data / "rig_b/rig.yaml"
    (plain,) = run("pose", shot, "--rig", rig).records

    (record,) = run("pose", shot, "--rig", rig, "--overlay", tmp_path / "drawn").records

    times = {"latency_s": None, "stage_s": None}
    assert record | times == plain | times
    assert set(record["stage_s"]) == {"detect", "pose"}
    assert cv2.imread(str(tmp_path / "drawn" / "B_z0500_p01_dim.png")).shape == (1200, 1600, 3)


@pytest.mark.slow
def test_a_shot_without_a_pose_is_drawn_and_reported(rig, detections, picture, tmp_path, run):
    dark = picture("dark.png")
    words = ["--overlay", tmp_path / "drawn", "--report", tmp_path / "r.html", "--method", "paper"]

    assert run("pose", detections, dark, "--rig", rig, *words).status == 3

    assert {path.stem for path in (tmp_path / "drawn").iterdir()} == {"a", "b", "c", "dark"}
    html = (tmp_path / "r.html").read_text()
    assert re.search(r"Rig: .*rig\.yaml, SHA-256 [0-9a-f]{64}", html)
    assert "Command: ringpose" in html
    assert all(f"<td>{shot}</td><td>" in html for shot in ("a", "b", "c", "dark"))
    counted = dict(re.findall(r"<td>([^<]*)</td><td>(\d+)</td>", html))
    assert counted["status none"] == "1"
    worst = re.findall(r"<figcaption>(\w+): ", html)
    assert worst[0] == "dark"
    assert not re.search(r"(src|href)=.(?!data:)", html)
    pictures = re.findall(r"data:image/png;base64,([^\"]+)", html)
    decoded = [cv2.imdecode(np.frombuffer(base64.b64decode(each), np.uint8), 1) for each in pictures]
    assert len(decoded) == 1 + 4 + 4
    assert all(image is not None and image.std() > 0 for image in decoded)


def test_pictures_by_several_processes_are_those_of_one(rig, detections, tmp_path, run):
    words = ["pose", detections, "--rig", rig, "--method", "paper", "--no-times"]

    lines = [run(*words, "--jobs", jobs, "--overlay", tmp_path / str(jobs)).out for jobs in (1, 2)]

    assert lines[0] == lines[1]
    assert sorted(path.name for path in (tmp_path / "2").iterdir()) == ["a.png", "b.png", "c.png"]
    for picture in (tmp_path / "1").iterdir():
        assert picture.read_bytes() == (tmp_path / "2" / picture.name).read_bytes()


def test_existing_pictures_are_not_replaced_without_force(rig, detections, tmp_path, run):
    (tmp_path / "a.png").touch()
    (tmp_path / "r.html").touch()
    words = ["pose", detections, "--rig", rig, "--method", "paper"]

    assert run(*words, "--report", tmp_path / "r.html")[:2] == (73, [])
    assert run(*words, "--overlay", tmp_path).status == 73
    assert run(*words, "--overlay", tmp_path, "--force").status == 0
    assert (tmp_path / "a.png").stat().st_size > 0


def test_second_shot_of_a_name_is_reported_and_not_drawn_over_the_first(rig, detections, tmp_path, run):
    words = ["--rig", rig, "--method", "paper", "--overlay", tmp_path / "drawn"]

    again = tmp_path / "again.jsonl"  # other detections of these shots
    again.write_text(detections.read_text() + "\n")

    status, out, messages = run("pose", detections, again, *words)

    assert (status, len(out)) == (65, 6)
    assert ["earlier shot" in message for message in messages] == [True] * 3


def test_overlays_stay_in_their_folder(rig, detections, tmp_path, run):
    (tmp_path / "drawn").mkdir()
    detections.write_text(detections.read_text().replace('"shot": "a"', '"shot": "../a"'))

    status, _, messages = run("pose", detections, "--rig", rig, "--method", "paper", "--overlay", tmp_path / "drawn")

    assert status == 65
    assert {path.name for path in (tmp_path / "drawn").iterdir()} == {"b.png", "c.png"}
    assert not (tmp_path / "a.png").exists()
    assert ["../a" in message for message in messages] == [True]
