"""`ringpose calibrate-camera`: files, reasons, statuses."""

import shutil

import cv2
import numpy as np
import pytest
import yaml
from needed import needed_module
from plane_views import run_in

from ringpose.cli.main import main
from ringpose.files.cameras.formats import read_camera

VIEWS = ("cam_B_00.png", "cam_B_03.png", "cam_B_06.png", "cam_B_09.png")
FIRST = f"views/{VIEWS[0]}"


def copy_views(carried_data, folder):
    """Put four carried views of the ChArUco board and its board file into a working folder."""
    (folder / "views").mkdir()
    for name in VIEWS:
        shutil.copy(carried_data / "calib_b" / "camera" / name, folder / "views")
    shutil.copy(carried_data / "calib_b" / "camera_board.yaml", folder)


@pytest.fixture
def folder(carried_data, tmp_path, monkeypatch):
    """A working folder with these."""
    monkeypatch.chdir(tmp_path)
    copy_views(carried_data, tmp_path)
    return tmp_path


def calibrate(*words: str) -> int:
    return main(["calibrate-camera", "--board", "camera_board.yaml", "--output", "camera.yaml", *words])


def written(folder) -> dict:
    return yaml.safe_load((folder / "camera.yaml").read_text())


@pytest.fixture(scope="module")
def run(carried_data, tmp_path_factory):
    """A calibration with overlays and comparison of the models, from four views and a black image."""
    folder = tmp_path_factory.mktemp("run")
    copy_views(carried_data, folder)
    cv2.imwrite(str(folder / "views" / "black.png"), np.zeros((1200, 1600), np.uint8))
    return run_in(folder, lambda: calibrate("views", "--overlay", "drawn", "--compare"))


def test_the_camera_file_has_the_true_parameters_with_their_quality_and_provenance(run):
    camera = written(run.folder)

    assert camera["camera_matrix"]["data"][0] == pytest.approx(1781.3, abs=2.0)
    assert camera["distortion_coefficients"]["data"][0] == pytest.approx(-0.105, abs=0.01)
    assert 0 < camera["standard_deviations"]["fx"] < 2
    assert camera["quality"]["rms_px"] < 0.1
    assert [view["name"] for view in camera["quality"]["views"]] == [name[:-4] for name in VIEWS]
    models = [fit["distortion_model"] for fit in camera["quality"]["models"]["fits"]]
    assert models == ["plumb_bob", "rational_polynomial"]
    assert max(camera["quality"]["models"]["difference_px"]) < 0.1  # where both are known, without the poles beyond
    assert len(camera["covariance"]["data"]) == 9
    assert len(camera["provenance"]["inputs"]) == 6


def test_an_image_without_a_board_is_named_and_the_others_are_used(run):
    assert run.status == 0
    assert "verdict: redo" not in run.err
    assert "ringpose calibrate-camera: black: no board: too dark" in run.err
    assert written(run.folder)["quality"]["without_board"][0]["name"] == "black"


def test_overlays_are_drawn_for_found_and_missing_boards(run):
    assert sorted(path.name for path in (run.folder / "drawn").iterdir()) == ["black.png", *VIEWS]
    assert cv2.imread(str(run.folder / "drawn" / "black.png")).max() == 255


def test_summary_and_verdict_are_printed_on_stderr(run):
    verdict = written(run.folder)["quality"]["verdict"]

    assert run.out == ""
    assert "4 of 4 views used, rms 0.0" in run.err
    assert "ringpose calibrate-camera: fx 178" in run.err
    assert "the models differ by median" in run.err
    assert f"ringpose calibrate-camera: verdict: {verdict['grade']}: " in run.err
    assert all(f"ringpose calibrate-camera: advice: {sentence}\n" in run.err for sentence in verdict["advice"])
    assert {"name", "value", "good_limit", "redo_limit", "grade"} <= set(verdict["findings"][0])


@pytest.mark.slow
def test_the_report_has_a_verdict_and_pictures(folder):
    needed_module("matplotlib", "ringpose[report]")

    calibrate("views", "--compare", "--report", "camera.html")

    html = (folder / "camera.html").read_text()
    assert "Verdict: " in html
    assert html.count("<img ") == 6


@pytest.mark.slow
def test_unusable_images_are_named_and_the_others_are_used(folder, capsys):
    whole = (folder / FIRST).read_bytes()
    (folder / "views" / "damaged.png").write_bytes(whole[: len(whole) // 2])
    cv2.imwrite("views/zoom.png", np.zeros((480, 640), np.uint8))
    shutil.copy(folder / FIRST, folder / "copy.png")
    (folder / "more").mkdir()
    cv2.imwrite(f"more/{VIEWS[0]}", np.zeros((1200, 1600), np.uint8))
    words = ["--quiet", "--overlay", "drawn", "--distortion-model", "rational_polynomial"]

    status = calibrate("views", "copy.png", "more", *words)

    stderr = capsys.readouterr().err
    assert status == 65
    assert "damaged.png" in stderr
    assert "zoom: 640 x 480 pixels, the others have 1600 x 1200" in stderr
    assert "ringpose calibrate-camera: copy: is the same image as cam_B_00" in stderr
    assert "ringpose calibrate-camera: cam_B_00: another image has this name" in stderr
    assert written(folder)["quality"]["views_used"] == len(VIEWS)
    assert written(folder)["distortion_coefficients"]["cols"] == 8


@pytest.mark.parametrize(
    ("words", "status", "named"),
    [
        (["nowhere", "--output", "kept"], 73, "kept: exists already"),
        (["nowhere", "--report", "missing/report.html"], 73, "missing"),
        (["views", "--report", "./camera.yaml"], 2, "--report: camera.yaml is the output, too"),
        (["views", "--report", "kept"], 73, "kept"),
        (["nowhere.png"], 66, "nowhere.png: does not exist"),
        ([FIRST, "nowhere.png"], 66, "1 view of the board, at least 3 are needed"),
        ([FIRST, f"views/{VIEWS[1]}"], 65, "2 views of the board, at least 3 are needed; add views"),
        pytest.param(
            [FIRST, "--board", "other_board.yaml"],
            65,
            "is it the right board file (DICT_5X5_250, numbers 0",
            marks=pytest.mark.slow,
        ),
        (["views", "--board", "unknown_board.yaml"], 65, '"DICT_FOO"'),
        *((["views", "--distances", text], 2, "give metres, as 0.2,0.5,1") for text in ("", "near", "0.5,-1", "1e9")),
    ],
)
def test_bad_usage_is_reported_once_and_nothing_is_written(folder, capsys, words, status, named):
    text = (folder / "camera_board.yaml").read_text()
    (folder / "other_board.yaml").write_text(text.replace("DICT_5X5_100", "DICT_6X6_250"))
    (folder / "unknown_board.yaml").write_text(text.replace("DICT_5X5_100", "DICT_FOO"))
    (folder / "kept").write_text("precious")

    assert calibrate(*words) == status
    assert capsys.readouterr().err.count(named) == 1
    assert not (folder / "camera.yaml").exists()
    assert (folder / "kept").read_text() == "precious"


def test_a_quiet_calibration_from_names_on_standard_input_prints_nothing(folder, monkeypatch, capsys):
    (folder / "names").write_text("".join(f"views/{name}\n" for name in VIEWS))
    with (folder / "names").open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        status = calibrate("-", "--quiet", "--camera-name", "wide", "--fix-k3")

    camera = read_camera(folder / "camera.yaml")
    assert (status, capsys.readouterr().err) == (0, "")
    assert camera.camera_name == "wide"
    assert camera.covariance.standard_deviations["k3"] == 0


def test_the_verdict_redo_is_printed_even_if_quiet(folder, capsys):
    status = calibrate(*(f"views/{name}" for name in VIEWS[:3]), "--quiet")

    assert status == 3
    assert capsys.readouterr().err.startswith("ringpose calibrate-camera: verdict: redo: ")
    assert (folder / "camera.yaml").exists()
