"""`ringpose calibrate-camera`: files, reasons, statuses."""

import contextlib
import io
import shutil
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from ringpose.cli.main import main

VIEWS = ("cam_B_00.png", "cam_B_03.png", "cam_B_06.png", "cam_B_09.png")


def copy_views(carried_data: Path, folder: Path) -> None:
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


@dataclass(frozen=True)
class Run:
    """One run: its exit status, messages, and what it wrote."""

    folder: Path
    status: int
    out: str
    err: str
    camera: dict


@pytest.fixture(scope="module")
def run(carried_data, tmp_path_factory):
    """A calibration with report, overlays and comparison of the models, from four views and a black image."""
    folder = tmp_path_factory.mktemp("run")
    copy_views(carried_data, folder)
    cv2.imwrite(str(folder / "views" / "black.png"), np.zeros((1200, 1600), np.uint8))
    out, err = io.StringIO(), io.StringIO()
    words = ["--overlay", "drawn", "--compare", *(["--report", "camera.html"] if find_spec("matplotlib") else [])]
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = calibrate("views", *words)
    return Run(folder, status, out.getvalue(), err.getvalue(), written(folder))


def test_carried_views_give_the_true_focal_length(run):
    assert run.camera["camera_matrix"]["data"][0] == pytest.approx(1781.3, abs=2.0)
    assert run.camera["distortion_coefficients"]["data"][0] == pytest.approx(-0.105, abs=0.01)


def test_the_file_says_how_good_it_is_and_where_it_comes_from(run):
    assert 0 < run.camera["standard_deviations"]["fx"] < 2
    assert run.camera["quality"]["rms_px"] < 0.1
    assert [view["name"] for view in run.camera["quality"]["views"]] == [name[:-4] for name in VIEWS]
    assert len(run.camera["covariance"]["data"]) == 9
    assert len(run.camera["provenance"]["inputs"]) == 6


def test_an_image_without_a_board_is_named_and_the_rest_goes_on(run):
    assert run.status == 3
    assert "ringpose: black: no board: too dark" in run.err
    assert run.camera["quality"]["without_board"][0]["name"] == "black"


def test_overlays_are_drawn_for_found_and_missing_boards(run):
    assert sorted(path.name for path in (run.folder / "drawn").iterdir()) == ["black.png", *VIEWS]
    assert cv2.imread(str(run.folder / "drawn" / "black.png")).max() == 255


def test_the_summary_names_values_and_deviations(run):
    assert run.out == ""
    assert "4 of 4 views used, rms 0.0" in run.err
    assert "ringpose: fx 178" in run.err


def test_the_verdict_stands_in_the_file_and_on_stderr(run):
    verdict = run.camera["quality"]["verdict"]

    assert f"ringpose: verdict: {verdict['grade']}: " in run.err
    assert all(f"ringpose: advice: {sentence}\n" in run.err for sentence in verdict["advice"])
    assert {"name", "value", "good_limit", "redo_limit", "grade"} <= set(verdict["findings"][0])


def test_the_report_shows_its_pictures(run):
    pytest.importorskip("matplotlib")

    html = (run.folder / "camera.html").read_text()
    assert "Verdict: " in html
    assert html.count("<img ") == 5


def test_two_models_are_compared_on_request(run):
    fits = run.camera["quality"]["models"]["fits"]

    assert [fit["distortion_model"] for fit in fits] == ["plumb_bob", "rational_polynomial"]
    assert "the models differ by median" in run.err


def test_unusable_images_are_named_and_the_rest_goes_on(folder, capsys):
    whole = (folder / "views" / VIEWS[0]).read_bytes()
    (folder / "views" / "damaged.png").write_bytes(whole[: len(whole) // 2])
    cv2.imwrite("views/zoom.png", np.zeros((480, 640), np.uint8))
    shutil.copy(folder / "views" / VIEWS[0], folder / "copy.png")

    status = calibrate("views", "copy.png", "--quiet", "--distortion-model", "rational_polynomial")

    stderr = capsys.readouterr().err
    assert status == 65
    assert "damaged.png" in stderr
    assert "zoom: 640 x 480 pixels, the others have 1600 x 1200" in stderr
    assert "ringpose: copy: is the same image as cam_B_00; give it once\n" in stderr
    assert written(folder)["quality"]["views_used"] == len(VIEWS)
    assert written(folder)["distortion_coefficients"]["cols"] == 8


def test_an_output_that_exists_is_refused_before_the_work(folder, capsys):
    (folder / "camera.yaml").write_text("precious")

    status = calibrate("nowhere")

    assert (status, capsys.readouterr().err) == (
        73,
        "ringpose: camera.yaml: exists already; add --force to replace it\n",
    )
    assert (folder / "camera.yaml").read_text() == "precious"


def test_a_report_in_the_place_of_the_output_is_refused(folder, capsys):
    pytest.importorskip("matplotlib")

    status = calibrate("views", "--report", "./camera.yaml")

    assert (status, capsys.readouterr().err) == (
        2,
        "ringpose: --report: camera.yaml is the output, too; give each its own file\n",
    )


def test_an_output_in_a_missing_folder_is_refused_before_the_work(folder, capsys):
    status = calibrate("nowhere", "--report", "missing/report.html")

    assert status == 73
    assert capsys.readouterr().err.count("\n") == 1
    assert not (folder / "camera.yaml").exists()


def test_images_of_one_name_do_not_overwrite_their_pictures(folder, capsys):
    (folder / "more").mkdir()
    shutil.move(folder / "views" / VIEWS[1], folder / "more" / VIEWS[0])

    calibrate("views", "more", "--overlay", "drawn", "--force", "--quiet")

    said = "ringpose: cam_B_00: another image has this name, too; rename one, or leave out --overlay\n"
    assert said in capsys.readouterr().err


def test_a_dictionary_that_is_not_known_is_refused_once(folder, capsys):
    board = yaml.safe_load((folder / "camera_board.yaml").read_text())
    (folder / "camera_board.yaml").write_text(yaml.safe_dump(board | {"dictionary": "DICT_FOO"}))

    status = calibrate("views")

    assert (status, capsys.readouterr().err.count("DICT_FOO")) == (65, 1)


def test_the_camera_is_read_back_with_its_covariance(folder):
    from ringpose.files.cameras.formats import read_camera

    calibrate("views", "--camera-name", "wide", "--fix-k3")

    camera = read_camera(folder / "camera.yaml")
    assert camera.camera_name == "wide"
    assert camera.covariance.standard_deviations["k3"] == 0


def test_the_wrong_board_file_says_so_for_each_image(folder, capsys):
    board = (folder / "camera_board.yaml").read_text().replace("DICT_5X5_100", "DICT_6X6_250")
    (folder / "camera_board.yaml").write_text(board)

    status = calibrate(f"views/{VIEWS[0]}")

    assert status == 65
    assert "not those of this board; is it the right board file (DICT_5X5_250, numbers 0" in capsys.readouterr().err
    assert not (folder / "camera.yaml").exists()


def test_images_that_are_not_there_are_said_alone(folder, capsys):
    status = calibrate("nowhere.png")

    assert (status, capsys.readouterr().err) == (66, "ringpose: nowhere.png: does not exist\n")


def test_a_missing_image_outranks_too_few_views(folder, capsys):
    status = calibrate(f"views/{VIEWS[0]}", "nowhere.png")

    assert status == 66
    assert "1 view of the board, at least 3 are needed" in capsys.readouterr().err


def test_a_verdict_of_redo_is_a_limit_missed_and_no_quiet_hides_it(folder, capsys):
    status = calibrate(*(f"views/{name}" for name in VIEWS[:3]), "--quiet")

    assert status == 3
    assert capsys.readouterr().err.startswith("ringpose: verdict: redo: views_used 3 (limit 10); ")
    assert (folder / "camera.yaml").exists()


def test_two_images_are_too_few_and_the_line_says_what_to_add(folder, capsys):
    status = calibrate(f"views/{VIEWS[0]}", f"views/{VIEWS[1]}")

    assert status == 65
    assert "2 views of the board, at least 3 are needed; add views" in capsys.readouterr().err


def test_names_come_through_standard_input(folder, monkeypatch):
    (folder / "names").write_text("".join(f"views/{name}\n" for name in VIEWS))
    with (folder / "names").open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        status = calibrate("-")

    assert status == 0


def test_quiet_says_nothing_of_what_went_well(folder, capsys):
    calibrate("views", "--quiet")

    assert capsys.readouterr().err == ""


def test_a_report_that_exists_is_refused_before_the_work(folder):
    Path("camera.html").write_text("mine")

    assert calibrate("views", "--report", "camera.html") == 73
    assert not Path("camera.yaml").exists()


@pytest.mark.parametrize("words", ["", "near", "0.5,-1", "1e9"])
def test_distances_that_are_none_are_wrong_usage(folder, words, capsys):
    assert calibrate("views", "--distances", words) == 2
    assert "give metres, as 0.2,0.5,1" in capsys.readouterr().err
