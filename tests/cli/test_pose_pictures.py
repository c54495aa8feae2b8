"""`ringpose pose --overlay` and `--report`."""

import base64
import json
import re

import cv2
import numpy as np
import pytest

from ringpose.cli.main import main


def records(text):
    times = {"latency_s": None, "stage_s": None}
    return [json.loads(line) | times for line in text.splitlines()]


@pytest.fixture
def shots(carried_data):
    return str(carried_data / "rig_b" / "shots")


@pytest.fixture
def shots_rig(carried_data):
    return str(carried_data / "rig_b" / "rig.yaml")


def test_pictures_do_not_change_the_lines(shots, shots_rig, tmp_path, capsys):
    shot = f"{shots}/B_z0500_p01_dim.npz"
    main(["pose", shot, "--rig", shots_rig])
    plain = capsys.readouterr().out

    assert main(["pose", shot, "--rig", shots_rig, "--overlay", str(tmp_path / "drawn")]) == 0

    line = capsys.readouterr().out
    assert records(line) == records(plain)
    assert set(json.loads(line)["stage_s"]) == {"detect", "pose"}
    assert cv2.imread(str(tmp_path / "drawn" / "B_z0500_p01_dim.png")).shape == (1200, 1600, 3)


def test_a_shot_without_a_pose_is_drawn_and_reported(rig, detections, picture, tmp_path, capsys):
    dark = picture("dark.png")
    words = ["--overlay", str(tmp_path / "drawn"), "--report", str(tmp_path / "r.html"), "--method", "paper"]

    assert main(["pose", str(detections), str(dark), "--rig", str(rig), *words]) == 3

    assert {path.stem for path in (tmp_path / "drawn").iterdir()} == {"a", "b", "c", "dark"}
    html = (tmp_path / "r.html").read_text()
    counted = dict(re.findall(r"<td>([^<]*)</td><td>(\d+)</td>", html))
    assert counted["status none"] == "1"
    worst = re.findall(r"<figcaption>(\w+): ", html)
    assert worst[0] == "dark"
    assert not re.search(r"(src|href)=.(?!data:)", html)
    pictures = re.findall(r"data:image/png;base64,([^\"]+)", html)
    decoded = [cv2.imdecode(np.frombuffer(base64.b64decode(each), np.uint8), 1) for each in pictures]
    assert len(decoded) == 1 + 4 + 4
    assert all(image is not None and image.std() > 0 for image in decoded)


def test_existing_pictures_are_not_replaced_without_force(rig, detections, tmp_path, capsys):
    (tmp_path / "a.png").touch()
    (tmp_path / "r.html").touch()
    words = ["pose", str(detections), "--rig", str(rig), "--method", "paper"]

    assert main([*words, "--report", str(tmp_path / "r.html")]) == 73
    assert capsys.readouterr().out == ""
    assert main([*words, "--overlay", str(tmp_path)]) == 73
    assert main([*words, "--overlay", str(tmp_path), "--force"]) == 0
    assert (tmp_path / "a.png").stat().st_size > 0


def test_second_shot_of_a_name_is_reported_and_not_drawn_over_the_first(rig, detections, tmp_path, capsys):
    words = ["--rig", str(rig), "--method", "paper", "--overlay", str(tmp_path / "drawn")]

    assert main(["pose", str(detections), str(detections), *words]) == 65

    captured = capsys.readouterr()
    assert len(captured.out.splitlines()) == 6
    assert captured.err.count("earlier shot") == 3


def test_overlays_stay_in_their_folder(rig, detections, tmp_path, capsys):
    (tmp_path / "drawn").mkdir()
    detections.write_text(detections.read_text().replace('"shot": "a"', '"shot": "../a"'))
    words = ["--rig", str(rig), "--method", "paper", "--overlay", str(tmp_path / "drawn")]

    assert main(["pose", str(detections), *words]) == 65

    assert {path.name for path in (tmp_path / "drawn").iterdir()} == {"b.png", "c.png"}
    assert not (tmp_path / "a.png").exists()
    assert capsys.readouterr().err.count("../a") == 1
