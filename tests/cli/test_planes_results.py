"""Outputs of `ringpose calibrate-planes` for good views: one run, checked by many tests."""

import re

import numpy as np
import pytest
from needed import needed_module
from plane_views import ORDER, calibrate, copy_views, run_in, written
from ring_scenes import RIGS

from ringpose.calibrate.camera.parameters import parameters_of
from ringpose.cli.main import main
from ringpose.files.rigs import read_rig
from ringpose.geometry.rotations import tilt_basis


@pytest.fixture(scope="module")
def run(carried_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    copy_views(carried_data, folder)
    words = ("--laser-names", "left,middle,right", "--expected-angles", "10,13", "--overlay", "drawn")
    return run_in(folder, lambda: calibrate("planes", *ORDER, *words))


def worst_angle_deg(rig: dict) -> float:
    normals = np.array([laser["normal"] for laser in rig["lasers"]])
    return float(np.degrees(np.linalg.norm(np.cross(normals, RIGS["B"].lasers.normal), axis=1).max()))


@pytest.mark.parametrize(
    ("method", "angle_deg"), [pytest.param("total-least-squares", 0.02, marks=pytest.mark.slow), ("paper", 0.1)]
)
def test_carried_views_give_the_true_planes(method, angle_deg, plane_folder):
    status = calibrate("planes", *ORDER, "--method", method)

    found = written(plane_folder)
    assert status == 0
    assert [laser["name"] for laser in found["lasers"]] == ["left", "middle", "right"]
    assert worst_angle_deg(found) < angle_deg
    assert found["quality"]["method"] == method
    assert ("paper" in found["quality"]) is (method != "paper")


@pytest.mark.slow
def test_switched_frames_need_no_order(shared_data, plane_folder):
    status = calibrate(str(shared_data / "rendered" / "calib_b" / "planes"))

    assert status == 0
    assert worst_angle_deg(written(plane_folder)) < 0.01


def test_the_rig_file_has_the_true_planes_with_their_quality_and_provenance(run):
    found = written(run.folder)

    assert run.status == 0
    assert worst_angle_deg(found) < 0.02
    assert max(laser["held_out_rms_m"] for laser in found["quality"]["lasers"]) < 60e-6
    assert len(found["provenance"]["inputs"]) == 5
    beside = found["quality"]["paper"]
    assert [laser["name"] for laser in beside] == ["left", "middle", "right"]
    assert max(np.degrees(laser["angle_rad"]) for laser in beside) < 0.1
    covariance = read_rig(run.folder / "rig.yaml").covariance
    assert covariance.data.shape == (9, 9)
    assert covariance.parameters[:2] == ("left.tilt_1", "left.tilt_2")
    assert np.linalg.eigvalsh(covariance.data).min() > 0


def test_overlays_show_the_stripes(run):
    names = sorted(path.name for path in (run.folder / "drawn").iterdir())
    assert names == ["pln_B_01.png", "pln_B_03.png", "pln_B_05.png"]


def test_the_summary_has_held_out_errors_by_distance_and_the_verdict_the_views_to_add(run):
    verdict = written(run.folder)["quality"]["verdict"]
    poor = {finding["name"] for finding in verdict["findings"] if finding["grade"] != "good"}

    assert run.out == ""
    assert re.search(r"3 views, rms [23]\d um, held out [23]\d um", run.err)
    assert "left: held out " in run.err
    assert " um at 0." in run.err
    assert verdict["grade"] == "can be improved"
    assert {"views", "angle_error_rad"} <= poor
    assert "verdict: can be improved" in run.err
    assert "advice: add views that show the stripe of left" in run.err


@pytest.mark.slow
def test_the_report_shows_residuals_and_uncertainty(plane_folder):
    needed_module("matplotlib", "ringpose[report]")

    calibrate("planes", *ORDER, "--overlay", "drawn", "--report", "out.html")

    html = (plane_folder / "out.html").read_text()
    assert html.count("data:image/png;base64,") == 5
    assert "Verdict: can be improved" in html


@pytest.mark.slow
def test_freed_camera_and_planes_of_rendered_boards_lie_within_three_deviations(
    shared_data, rig_of_rendered_boards, tmp_path
):
    boards, rig_file = shared_data / "rendered" / "calib_b", tmp_path / "rig.yaml"
    camera = str(rig_of_rendered_boards.parent / "camera.yaml")
    words = ["--board", str(boards / "plane_board.yaml"), "--camera", camera, "--laser-order", "right,middle,left"]

    main(["calibrate-planes", str(boards / "planes"), *words, "--free-camera", "--output", str(rig_file), "--quiet"])

    found, true = read_rig(rig_file), read_rig(boards / "true_rig.yaml")
    errors = [parameters_of(found.camera) - parameters_of(true.camera)]
    for name, normal, distance_m in zip(found.lasers.names, found.lasers.normal, found.lasers.distance_m, strict=True):
        laser = true.lasers.names.index(name)
        along = true.lasers.normal[laser] @ normal
        errors.append(-tilt_basis(normal) @ true.lasers.normal[laser] / along)
        errors.append(np.array([distance_m - np.sign(along) * true.lasers.distance_m[laser]]))
    deviations = np.array(list(found.covariance.standard_deviations.values()))
    assert np.abs(np.concatenate(errors) / deviations).max() < 3.0
