"""`ringpose view --html`."""

import base64
import json
import re
import shutil

import cv2
import numpy as np
import pytest
import yaml

from ringpose.cli.main import main


@pytest.fixture
def data_set(carried_data):
    return carried_data / "rig_b"


@pytest.fixture
def one_shot(data_set):
    return str(data_set / "shots" / "B_z0500_p01_dim.npz")


@pytest.fixture
def poses(data_set, one_shot, tmp_path, capsys):
    main(["pose", one_shot, "--rig", str(data_set / "rig.yaml")])
    file = tmp_path / "poses.jsonl"
    file.write_text(capsys.readouterr().out)
    return file


def data_of(page):
    text = page.read_text()
    assert text.count("</script>") == 2
    return json.loads(re.search(r'type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1])


def elements_of(part, kind):
    return [each for each in part["elements"] if each["kind"] == kind]


def test_a_replay_has_picture_pose_truth_and_the_errors_of_bench(data_set, one_shot, poses, tmp_path, capsys):
    page, truth, rig = tmp_path / "v.html", str(data_set / "truth.jsonl"), str(data_set / "rig.yaml")

    words = ["--poses", str(poses), "--truth", truth, "--html", str(page), "--quiet"]
    assert main(["view", one_shot, "--rig", rig, *words]) == 0

    data = data_of(page)
    (shot,) = data["shots"]
    line = json.loads(poses.read_text())
    truths = map(json.loads, (data_set / "truth.jsonl").read_text().splitlines())
    true_ring = next(each for each in truths if each["shot"] == shot["name"])
    assert (shot["name"], shot["status"]) == ("B_z0500_p01_dim", line["status"])
    (center,) = elements_of(shot, "ellipsoid")
    np.testing.assert_allclose(center["center_m"], line["pose"]["center_m"], rtol=1e-12)
    axes = np.array(center["half_axes_m"]) / 3
    np.testing.assert_allclose(axes.T @ axes, line["pose"]["covariance"]["center"], rtol=1e-6, atol=1e-15)
    lines, stripes = elements_of(shot, "lines")
    circles = [stroke for stroke in lines["strokes"] if "axes_m" in stroke]
    radii_m = [np.linalg.norm(each["axes_m"][0]) for each in circles]
    edges = ("radius_inner_m", "radius_outer_m")
    np.testing.assert_allclose(radii_m, [*(line["pose"][each] for each in edges), *(true_ring[each] for each in edges)])
    assert [each["dash"] for each in circles] == ["solid", "solid", "dashed", "dashed"]
    assert len(stripes["strokes"]) == 3
    jpeg = base64.b64decode(shot["picture"].partition(",")[2])
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), 1).shape == (600, 800, 3)
    assert len(elements_of(data, "surface")) == 3
    main(["bench", str(poses), "--truth", truth, "--rig", rig, "--json", "-"])
    scored = next(each for each in json.loads(capsys.readouterr().out)["shots"] if each["shot"] == shot["name"])
    plotted = {plot["title"]: plot["series"][0]["values"] for plot in data["plots"]}
    np.testing.assert_allclose(plotted["error: grasp (mm)"], [1e3 * scored["errors"]["grasp_m"]])
    np.testing.assert_allclose(plotted["error: normal (deg)"], [np.degrees(scored["errors"]["normal_rad"])])


def test_a_replay_has_the_track_of_each_shot(data_set, one_shot, poses, tmp_path, capsys):
    page, tracks, rig = tmp_path / "v.html", tmp_path / "tracks.jsonl", str(data_set / "rig.yaml")
    assert main(["track", str(poses), "--rig", rig]) == 0
    tracks.write_text(capsys.readouterr().out)

    assert main(["view", one_shot, "--rig", rig, "--tracks", str(tracks), "--html", str(page), "--quiet"]) == 0

    (shot,) = data_of(page)["shots"]
    line = json.loads(tracks.read_text().splitlines()[-1])
    dotted = [stroke for stroke in elements_of(shot, "lines")[0]["strokes"] if stroke["dash"] == "dotted"]
    np.testing.assert_allclose(dotted[0]["center_m"], line["pose"]["center_m"], rtol=1e-12)
    assert ["track", f"{line['validity']}, {line['fusion_status']}"] in shot["texts"]


def test_a_track_in_the_base_frame_is_shown_where_the_camera_sees_it(data_set, one_shot, tmp_path, capsys):
    page, tracks, robot, rig = (tmp_path / name for name in ("v.html", "tracks.jsonl", "robot.jsonl", "rig.yaml"))
    mounted = yaml.safe_load((data_set / "rig.yaml").read_text())
    mounted["mount"] = {"tool_from_camera": [[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0.05], [0, 0, 0, 1]]}
    rig.write_text(yaml.safe_dump(mounted))
    assert main(["pose", one_shot, "--rig", str(rig)]) == 0
    in_camera = json.loads(capsys.readouterr().out)
    turned = {"position_m": [1.0, 2.0, 3.0], "orientation_xyzw": [0.5, -0.5, 0.5, 0.5]}
    stamps_s = (in_camera["stamp_s"] + np.linspace(-1.0, 1.0, 21)).tolist()
    robot.write_text("".join(json.dumps({"stamp_s": each, "base_from_tool": turned}) + "\n" for each in stamps_s))
    assert main(["pose", "--track", one_shot, "--rig", str(rig), "--robot-poses", str(robot)]) == 0
    tracks.write_text(capsys.readouterr().out)
    words = ["view", one_shot, "--rig", str(rig), "--tracks", str(tracks), "--html", str(page), "--quiet", "--force"]

    def shown():
        (shot,) = data_of(page)["shots"]
        return [stroke for stroke in elements_of(shot, "lines")[0]["strokes"] if stroke["dash"] == "dotted"]

    assert main([*words, "--robot-poses", str(robot)]) == 0
    np.testing.assert_allclose(shown()[0]["center_m"], in_camera["pose"]["center_m"], atol=0.01)
    assert main(words) == 0
    assert shown() == []


def test_a_replay_without_poses_shows_the_detection(data_set, one_shot, tmp_path):
    page = tmp_path / "v.html"

    assert main(["view", one_shot, "--rig", str(data_set / "rig.yaml"), "--html", str(page)]) == 0

    data = data_of(page)
    (shot,) = data["shots"]
    assert data["plots"] == []
    assert [entry["text"] for entry in data["legend"]] == ["laser left", "laser middle", "laser right"]
    assert (shot["status"], shot["elements"]) == (
        "unmeasured",
        [{"kind": "lines", "name": "rings", "strokes": [], "width_px": 2.0}],
    )


def test_names_in_a_replay_are_not_taken_for_markup(rig, picture, tmp_path):
    dark = picture("</script><b>.png".replace("/", "_"))
    page = tmp_path / "v.html"
    poses = tmp_path / "p.jsonl"
    reason = {"reason": "</script><script>alert(1)</script>"}
    record = {"schema": "ringpose/pose/2", "shot": dark.stem, "stamp_s": 0.0, "frame": "camera", "flags": []}
    poses.write_text(json.dumps(record | reason | {"status": "none", "pose": None}))

    assert main(["view", str(dark), "--rig", str(rig), "--html", str(page), "--poses", str(poses)]) == 0

    assert reason["reason"] in str(data_of(page)["shots"][0]["texts"])
    assert "<b>" not in page.read_text()


@pytest.mark.parametrize(
    ("words", "status", "key_word"),
    [
        (["--html", "v.html", "--poses", "missing"], 66, "missing"),
        (["--html", "v.html", "--tracks", "missing"], 66, "missing"),
        (["--html", "v.html", "--poses", "empty.jsonl"], 65, "empty.jsonl: holds no record"),
        (["--html", "v.html", "--poses", "dark.jsonl", "--poses", "empty.jsonl"], 65, "empty.jsonl: holds no record"),
        (["--html", "v.html", "--tracks", "empty.jsonl"], 65, "empty.jsonl: holds no record"),
        (["--html", "v.html", "--tracks", "poses.jsonl"], 65, "schema"),
        (["--html", "v.html", "--poses", "rig.jsonl"], 65, "another rig"),
        (["--html", "v.html", "--tracks", "tracks.jsonl"], 65, "--tracks"),
        (["--html", "v.html", "--truth", "other.jsonl"], 65, "--truth"),
        (["--html", "there.html"], 73, "there.html"),
    ],
)
def test_what_cannot_be_shown_is_reported(rig, picture, tmp_path, monkeypatch, capsys, words, status, key_word):
    monkeypatch.chdir(tmp_path)
    dark = picture("dark.png")
    (tmp_path / "there.html").touch()
    (tmp_path / "empty.jsonl").touch()
    pose = {"schema": "ringpose/pose/2", "shot": "dark", "stamp_s": 0.0, "frame": "camera", "flags": []}
    (tmp_path / "dark.jsonl").write_text(json.dumps(pose | {"reason": "dark", "status": "none", "pose": None}))
    record = pose | {"reason": "dark", "status": "none", "pose": None, "rig": "5b" * 32}
    (tmp_path / "rig.jsonl").write_text(json.dumps(record))
    (tmp_path / "poses.jsonl").write_text('{"schema": "ringpose/pose/2", "shot": "dark"}\n')
    track = {"schema": "ringpose/track/1", "shot": "other", "stamp_s": 0.0, "validity": "lost", "fusion_status": "none"}
    (tmp_path / "tracks.jsonl").write_text(json.dumps(track | {"frame": "camera", "camera": "inertial_assumed"}))
    (tmp_path / "other.jsonl").write_text('{"shot": "other", "expect": "no_target"}\n')

    assert main(["view", str(dark), "--rig", str(rig), *words]) == status

    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert key_word in error


def test_a_folder_whose_name_is_not_utf8_has_a_replay(data_set, one_shot, tmp_path):
    folder, page = tmp_path / "shots\udcff", tmp_path / "v.html"
    folder.mkdir()
    shutil.copy(one_shot, folder)

    assert main(["view", str(folder), "--rig", str(data_set / "rig.yaml"), "--html", str(page), "--quiet"]) == 0

    assert "shots?" in page.read_text(encoding="utf-8")
