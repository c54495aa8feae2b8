"""`ringpose simulate`: the files that it writes, its messages, the input that it rejects."""

import json
import signal
from pathlib import Path

import cv2
import pytest
import yaml
from schemas import validated
from small_rig import SERVED_RIG

from ringpose.files.boards import read_board
from ringpose.files.images.shots import read_shot
from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig

SCENE = {
    "ringpose": "scene/1",
    "rig": "rig.yaml",
    "ring": {"radius_inner_m": 0.567, "radius_outer_m": 0.597, "height_m": 0.06},
    "body": {"size_m": [2.2, 2.2, 1.0]},
    "sensor": {"pixel_m": 3.6e-5},
    "stripe_dn": 150,
    "sequence": "off,all",
    "trajectory": [{"generate": {"distances_m": [0.5], "count": 3}}],
}
MARKERS = {"dictionary": "DICT_4X4_50"}
CHARUCO = {"kind": "charuco", "squares_x": 5, "squares_y": 4, "square_m": 0.06, "marker_m": 0.045} | MARKERS
FOUR = {"kind": "four_markers", "width_m": 0.3, "height_m": 0.24, "marker_m": 0.06, "margin_m": 0.01} | MARKERS
BOARDS = {
    "camera": {"board": CHARUCO, "generate": {"count": 2}},
    "planes": {"board": FOUR, "generate": {"count": 1}, "sequence": "off,1,2"},
}


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "rig.yaml").write_text(SERVED_RIG)
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(SCENE))
    return tmp_path / "scene.yaml"


@pytest.fixture
def simulate(run, scene):
    """Simulates the scene by one process into the folder `out` beside it."""
    return lambda *words: run("simulate", scene, "--output", scene.parent / "out", "--jobs", 1, *words)


def test_shots_rig_and_truth_are_written(simulate, scene):
    status, lines, _ = simulate()

    out = scene.parent / "out"
    names = [Path(line).stem for line in lines]
    assert (status, names) == (0, ["z0500_p00_dim", "z0500_p01_dim", "z0500_p02_dim"])
    rig = read_rig(out / "rig.yaml")
    assert [read_shot(out / "shots" / f"{name}.npz", rig=rig).lasers.tolist() for name in names] == [[0, 7]] * 3
    assert [truth.shot for truth in read_truths(out / "truth.jsonl")] == names
    for line in (out / "truth.jsonl").read_text().splitlines():
        validated(json.loads(line), "truth")


def test_another_seed_gives_other_poses(simulate, scene):
    simulate("--count", 1)
    first = (scene.parent / "out" / "truth.jsonl").read_text()

    simulate("--count", 1, "--seed", 99, "--force")

    assert (scene.parent / "out" / "truth.jsonl").read_text() != first


def test_board_views_with_their_poses_are_written_for_both_calibrations(simulate, scene):
    scene.write_text(yaml.safe_dump(SCENE | {"boards": BOARDS}))

    assert simulate("--count", 2).status == 0

    calibration = scene.parent / "out" / "calibration"
    assert cv2.imread(str(calibration / "camera" / "board_01.png"), cv2.IMREAD_UNCHANGED).shape == (150, 200)
    assert read_shot(calibration / "planes" / "board_00.npz").lasers.tolist() == [0, 1, 2]
    assert read_board(calibration / "plane_board.yaml").kind == "four_markers"
    lines = (calibration / "camera_truth.jsonl").read_text().splitlines()
    assert [json.loads(line)["view"] for line in lines] == ["board_00", "board_01"]
    assert len(json.loads(lines[0])["camera_from_board_rvec"]) == 3
    rig = yaml.safe_load((scene.parent / "out" / "rig.yaml").read_text())
    assert str(scene) in rig["provenance"]["inputs"]


def test_force_removes_what_the_older_run_made_and_nothing_else(simulate, scene):
    simulate()
    own = scene.parent / "out" / "shots" / "mine.npz"
    own.write_bytes(b"my own")

    simulate("--count", 1, "--force")

    left = sorted(path.name for path in own.parent.iterdir())
    assert left == ["mine.npz", "z0500_p00_dim.npz"]


@pytest.mark.parametrize(("key", "degrees"), [("pitch_rad", 5.0), ("yaw_rad", -8.0), ("roll_rad", 90.0)])
def test_an_angle_in_degrees_is_rejected_with_its_place(simulate, scene, key, degrees):
    view = {"name": "a", "center_m": [-0.58, 0.0, 0.5], "pitch_rad": 0.0, "yaw_rad": 0.0}
    scene.write_text(yaml.safe_dump(SCENE | {"trajectory": [view | {key: degrees}]}))

    status, _, (message,) = simulate()

    assert status == 65
    assert f"trajectory[0].{key}" in message
    assert "radians" in message


def test_existing_output_is_kept(simulate, scene):
    out = scene.parent / "out"
    out.write_text("in the way")
    assert simulate("--count", 1).status == 73
    out.unlink()

    assert [simulate("--count", 1).status for _ in range(2)] == [0, 73]


@pytest.mark.parametrize(
    ("change", "status", "message"),
    [
        ({"rig": "none.yaml"}, 66, "none.yaml"),
        ({"lihgts": {}}, 65, "unknown key 'lihgts'"),
        ({"ring": {"radius_inner_m": 567, "radius_outer_m": 597, "height_m": 60}}, 65, "if it is in millimetres"),
        ({"trajectory": [{"generate": {}}, {"generate": {}}]}, 65, "two views are called 'z0500_p00_dim'"),
    ],
)
def test_a_wrong_scene_is_one_line_and_its_status(simulate, scene, change, status, message):
    scene.write_text(yaml.safe_dump(SCENE | change))

    found, _, (line,) = simulate()

    assert found == status
    assert message in line


def test_a_camera_inside_a_part_is_rejected_before_anything_is_written(simulate, scene):
    inside = {"name": "inside", "center_m": [0.0, 0.0, 0.05], "normal": [0, 0, -1]}
    outside = {"name": "outside", "center_m": [-0.58, 0.0, 0.5], "normal": [0, 0, -1]}
    block = {"name": "block", "shape": "box", "size_m": [0.4, 0.4, 0.4], "material": "black"}
    scene.write_text(
        yaml.safe_dump(SCENE | {"target": {"parts": [block]}, "trajectory": [outside, inside]}), encoding="utf-8"
    )

    status, _, (message,) = simulate()

    assert status == 65
    assert "view inside" in message
    assert "'block'" in message
    assert not (scene.parent / "out").exists()


def test_the_first_shot_is_named_before_the_last_is_made(scene, forked):
    """A thousand shots would take minutes; the process is stopped after the first and leaves whole files."""
    endless = SCENE | {"trajectory": [{"generate": {"distances_m": [0.5], "count": 1000}}]}
    scene.write_text(yaml.safe_dump(endless))

    with forked(["simulate", scene, "--output", scene.parent / "out", "--jobs", "1"]) as process:
        first = process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        _, error = process.communicate(timeout=300)

    assert process.returncode == 143
    assert error == ""
    assert Path(first.strip()).is_file()
    shots = [read_shot(path) for path in (scene.parent / "out" / "shots").glob("*.npz")]
    assert {truth.shot for truth in read_truths(scene.parent / "out" / "truth.jsonl")} <= {shot.name for shot in shots}


@pytest.mark.slow
def test_an_interrupt_with_several_processes_is_quiet(scene, started):
    endless = SCENE | {"trajectory": [{"generate": {"distances_m": [0.5], "count": 1000}}]}
    scene.write_text(yaml.safe_dump(endless))

    process = started("simulate", scene, "--output", scene.parent / "out", "--jobs", "2")
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=600)

    assert (process.returncode, error) == (130, "")


def cut_off(truth: Path, lines: int) -> None:
    """Leave the first lines of a truth file, as an interrupted run does."""
    kept = truth.read_text().splitlines(keepends=True)
    truth.write_text("".join(kept[:lines]) + kept[lines][:20])


def test_an_interrupted_run_is_continued_and_another_seed_is_not(simulate, scene):
    scene.write_text(yaml.safe_dump(SCENE | {"boards": BOARDS}))
    whole = simulate()
    out = scene.parent / "out"
    truths = [out / "truth.jsonl", out / "calibration" / "camera_truth.jsonl"]
    written = [truth.read_bytes() for truth in truths]
    for truth in truths:
        cut_off(truth, 1)
    last = sorted((out / "shots").iterdir())[-1]
    last.unlink()

    other_seed = simulate("--seed", 9, "--resume")
    found = simulate("--resume")

    assert (other_seed.status, "has another shot" in other_seed.messages[0]) == (65, True)
    assert (found.status, found.out) == (0, whole.out)
    assert [truth.read_bytes() for truth in truths] == written
    assert last.exists()
