"""End-to-end tests on externally rendered shots: from files to errors against the ground truth."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from ringpose.cli.main import main

FORMATS = (".bmp", ".jpg", ".pgm", ".png", ".tif")

SETS = ("rig_a", "rig_b", "variants_a", "variants_b")


pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.fixture(scope="module")
def carried_report(carried_data, tmp_path_factory):
    """Errors of both methods on the carried shots."""
    return report_of(tmp_path_factory.mktemp("carried"), [carried_data / "rig_b"])


@pytest.fixture(scope="module")
def shared_report(shared_data, tmp_path_factory):
    """Errors of both methods on all rendered shots."""
    return report_of(tmp_path_factory.mktemp("shared"), [shared_data / "rendered" / name for name in SETS])


def report_of(folder: Path, data_sets: list[Path]) -> dict:
    words = ["bench", *map(str, data_sets), "--json", str(folder / "report.json"), "--quiet"]
    status = main(words)

    assert status == 0
    return json.loads((folder / "report.json").read_text())


def all_shots(report: dict, method: str) -> dict:
    (line,) = [line for line in report["groups"] if line["method"] == method and not line["group"]]
    return line


def piped(capsys, monkeypatch, tmp_path: Path, shots: Path, rig: Path) -> list[dict]:
    """`capture | detect - | pose -`, one after the other; the pose lines."""
    text, statuses = "", []
    for words in (
        ["capture", "--camera", f"files:{shots}", "--output", "session"],
        ["detect", "-", "--rig", str(rig)],
        ["pose", "-", "--rig", str(rig)],
    ):
        (tmp_path / "piped").write_text(text)
        with (tmp_path / "piped").open() as stream:
            monkeypatch.setattr("sys.stdin", stream)
            statuses.append(main(words))
        text = capsys.readouterr().out
    assert set(statuses) <= {0, 3}
    return [json.loads(line) for line in text.splitlines()]


def test_every_carried_shot_gets_a_pose_through_the_pipe(carried_data, capsys, monkeypatch, tmp_path):
    shots = carried_data / "rig_b" / "shots"

    lines = piped(capsys, monkeypatch, tmp_path, shots, carried_data / "rig_b" / "rig.yaml")

    assert [line["shot"] for line in lines] == sorted(path.stem for path in shots.iterdir())
    assert [line["shot"] for line in lines if line["pose"] is None] == []


def test_images_of_every_format_give_the_pose_of_their_shot(carried_data, capsys):
    with np.load(carried_data / "rig_b" / "shots" / "B_z0500_p00_dim.npz") as shot:
        lit = shot["images"][-1]
    for suffix in FORMATS:
        Path(suffix[1:]).with_suffix(suffix).write_bytes(cv2.imencode(suffix, lit)[1].tobytes())
    truths = map(json.loads, (carried_data / "rig_b" / "truth.jsonl").read_text().splitlines())
    truth = next(truth for truth in truths if truth["shot"] == "B_z0500_p00_dim")

    status = main(["pose", ".", "--rig", str(carried_data / "rig_b" / "rig.yaml")])

    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert status == 0
    assert sorted(line["shot"] for line in lines) == sorted(suffix[1:] for suffix in FORMATS)
    for line in lines:
        assert np.linalg.norm(np.cross(line["pose"]["normal"], truth["normal"])) < 0.01
        assert abs(np.dot(np.subtract(line["pose"]["grasp_m"], truth["center_m"]), truth["normal"])) < 0.001


WRONG = pytest.mark.parametrize(
    ("method", "wrong"), [("ml", set()), ("paper-constrained", set()), ("paper", {"grasp"})]
)
"""Quantities that are wrong: only the paper's grasp point, which is the mean of the break points."""


@WRONG
def test_no_carried_shot_is_missed_and_no_quantity_is_wrong(carried_report, method, wrong):
    line = all_shots(carried_report, method)

    outcomes = line["outcomes"]
    assert (outcomes["missed"], outcomes["lost"], outcomes["partial_none"]) == (0, 0, 0)
    assert {name for name, counts in line["quantities"].items() if counts["wrong"]} == wrong


LIMITS = [
    ("paper", "normal_rad", 0.005, 0.03),
    ("paper", "grasp_m", 0.008, 0.025),
    ("paper", "center_m", 0.2, 0.5),
    ("paper-constrained", "normal_rad", 0.005, 0.03),
    ("paper-constrained", "grasp_m", 0.0001, 0.0007),
    ("paper-constrained", "center_m", 0.005, 0.02),
    ("paper-constrained", "radius_outer_m", 0.004, 0.009),
]
"""Method, error, its median and its maximum: about twice what the shots give, more for the paper's centre.

From six points at 1 m, the normal is accurate to a degree and the centre to a centimetre along the optical axis; the
grasp point is ten times more accurate. The paper's own form does not constrain the centre to the plane, so that a tenth
of a pixel becomes decimetres in depth.
"""


@pytest.mark.parametrize(("method", "quantity", "median", "largest"), LIMITS)
def test_errors_on_carried_shots(carried_report, method, quantity, median, largest):
    error = all_shots(carried_report, method)["errors"][quantity]

    assert error["count"] >= 4
    assert error["median"] < median
    assert error["max"] < largest


def test_the_constrained_method_reduces_grasp_errors_tenfold(carried_report):
    free, constrained = (
        all_shots(carried_report, method)["errors"]["grasp_m"]["rmse"] for method in ("paper", "paper-constrained")
    )

    assert constrained < free / 10


@pytest.mark.slow
def test_a_rig_calibrated_from_carried_board_views_gives_the_same_grasp_points(carried_data, capsys):
    boards, data = carried_data / "calib_b", carried_data / "rig_b"
    camera = [str(boards / "camera"), "--board", str(boards / "camera_board.yaml"), "--output", "camera.yaml"]
    planes = [str(boards / "planes"), "--board", str(boards / "plane_board.yaml"), "--camera", "camera.yaml"]

    statuses = [
        main(["calibrate-camera", *camera]),
        main(["calibrate-planes", *planes, "--laser-order", "right,middle,left", "--output", "rig.yaml"]),
        main(["bench", str(data), "--rig", "rig.yaml", "--method", "paper-constrained", "--json", "report.json"]),
    ]

    assert statuses == [0, 0, 0]
    errors = all_shots(json.loads(Path("report.json").read_text()), "paper-constrained")["errors"]
    assert errors["grasp_m"]["median"] < 0.0005
    assert errors["normal_rad"]["median"] < 0.008


@pytest.mark.slow
def test_no_rendered_shot_is_lost_and_each_without_a_pose_has_its_reason(shared_data, capsys, monkeypatch, tmp_path):
    lines, names = [], []
    for name in SETS:
        folder = shared_data / "rendered" / name
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        lines += piped(capsys, monkeypatch, tmp_path, folder / "shots", folder / "rig.yaml")
        names += sorted(path.stem for path in (folder / "shots").iterdir())

    assert [line["shot"] for line in lines] == names
    assert [line["shot"] for line in lines if line["pose"] is None and not line["reason"]] == []
    assert [line["shot"] for line in lines if line["status"] == "ok" and line["reason"]] == []


@pytest.mark.slow
@WRONG
def test_failures_and_wrong_quantities_on_all_rendered_shots(shared_report, method, wrong):
    line = all_shots(shared_report, method)

    outcomes = line["outcomes"]
    assert sum(outcomes.values()) == 45
    assert (outcomes["lost"], outcomes["no_target"]) == (0, 0)
    assert outcomes["missed"] <= 1
    assert {name for name, counts in line["quantities"].items() if counts["wrong"]} == wrong


@pytest.mark.slow
def test_errors_on_all_rendered_shots(shared_report):
    errors = all_shots(shared_report, "paper-constrained")["errors"]

    assert errors["normal_rad"]["median"] < 0.005
    assert errors["grasp_m"]["median"] < 0.0002
    assert errors["center_m"]["median"] < 0.03
