"""`ringpose calibrate-planes`: files, reasons, statuses."""

import shutil

import numpy as np
import pytest
import yaml

from ringpose.cli.main import main

TRUE_NORMALS = np.array(
    [
        [0.00566835033, 0.984148362139, -0.17725651216],
        [-0.004363296259, 0.9999874955, 0.002443458521],
        [-0.007049019511, 0.985054082892, 0.172101031672],
    ]
)
ORDER = ("--laser-order", "right,middle,left")


@pytest.fixture
def folder(carried_data, tmp_path, monkeypatch):
    """A working folder with the true camera and the carried views of the four-marker board, all lasers on."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(carried_data / "calib_b" / "planes", tmp_path / "planes")
    shutil.copy(carried_data / "calib_b" / "plane_board.yaml", tmp_path)
    shutil.copy(carried_data / "rig_b" / "rig.yaml", tmp_path / "camera.yaml")
    return tmp_path


def calibrate(*words: str) -> int:
    files = ["--camera", "camera.yaml", "--board", "plane_board.yaml", "--output", "rig.yaml"]
    return main(["calibrate-planes", *files, *words])


def written(folder) -> dict:
    return yaml.safe_load((folder / "rig.yaml").read_text())


def worst_angle_deg(rig: dict) -> float:
    normals = np.array([laser["normal"] for laser in rig["lasers"]])
    return float(np.degrees(np.linalg.norm(np.cross(normals, TRUE_NORMALS), axis=1).max()))


@pytest.mark.parametrize(("method", "angle_deg"), [("total-least-squares", 0.02), ("paper", 0.1)])
def test_carried_views_give_the_true_planes(method, angle_deg, folder):
    status = calibrate("planes", *ORDER, "--method", method)

    found = written(folder)
    assert status == 0
    assert [laser["name"] for laser in found["lasers"]] == ["left", "middle", "right"]
    assert worst_angle_deg(found) < angle_deg
    assert found["quality"]["method"] == method


def test_the_file_says_how_good_it_is_and_where_it_comes_from(folder):
    calibrate("planes", *ORDER)

    found = written(folder)
    assert max(laser["held_out_rms_m"] for laser in found["quality"]["lasers"]) < 60e-6
    assert found["covariance"]["parameters"][:2] == ["left.tilt_1", "left.tilt_2"]
    assert len(found["provenance"]["inputs"]) == 5


def test_the_rig_is_read_back(folder):
    from ringpose.files.rigs import read_rig

    calibrate("planes", *ORDER, "--laser-names", "left,middle,right")

    rig = read_rig(folder / "rig.yaml")
    assert rig.covariance.data.shape == (9, 9)
    assert np.linalg.eigvalsh(rig.covariance.data).min() > 0


def test_all_lasers_on_and_no_order_is_refused_with_the_remedy(folder, capsys):
    status = calibrate("planes")

    assert status == 65
    assert "give --laser-order" in capsys.readouterr().err
    assert not (folder / "rig.yaml").exists()


def test_one_shot_is_one_line_and_is_refused(folder, capsys):
    status = calibrate("planes/pln_B_01.npz", *ORDER)

    assert status == 65
    said = capsys.readouterr().err
    assert "its one view lie on one line" in said
    assert "add a view of the board 50 mm or more nearer or farther than 0.5" in said


def test_a_shot_without_a_board_is_named_and_the_rest_goes_on(folder, capsys):
    with np.load("planes/pln_B_01.npz") as shot:
        np.savez("planes/dark.npz", **{**shot, "images": np.zeros_like(shot["images"])})

    status = calibrate("planes", *ORDER)

    assert status == 3
    assert "ringpose: dark: no board: too dark" in capsys.readouterr().err
    assert written(folder)["quality"]["without_board"][0]["name"] == "dark"


def test_a_shot_without_stripes_is_named_in_the_summary(folder, capsys):
    with np.load("planes/pln_B_01.npz") as shot:
        np.savez("planes/unlit.npz", **{**shot, "images": shot["images"][[0, 0]]})

    status = calibrate("planes", *ORDER)

    assert status == 0
    assert "unlit: no stripe of left, middle, right" in capsys.readouterr().err


def test_a_wrong_order_is_wrong_usage(folder, capsys):
    assert calibrate("planes", "--laser-order", "up,middle,down") == 2


def test_names_with_a_full_stop_are_wrong_usage(folder, capsys):
    assert calibrate("planes", "--laser-names", "a.b,c,d") == 2


def test_too_few_names_name_the_shot_that_has_more_lasers(folder, capsys):
    status = calibrate("planes", "--laser-names", "left,right")

    assert status == 65
    assert "a frame names laser 3, there are 2 (left, right)" in capsys.readouterr().err


def test_the_camera_of_another_size_is_refused(folder, capsys):
    text = (folder / "camera.yaml").read_text().replace("image_width: 1600", "image_width: 1280")
    (folder / "camera.yaml").write_text(text)

    status = calibrate("planes", *ORDER)

    assert status == 65
    assert "1600 x 1200 pixels, the camera has 1280 x 1200" in capsys.readouterr().err


def test_the_papers_method_needs_markers(folder, capsys):
    (folder / "plane_board.yaml").write_text("{kind: chessboard, squares_x: 8, squares_y: 6, square_m: 0.02}")

    assert calibrate("planes", *ORDER, "--method", "paper") == 2


def test_overlays_show_the_stripes(folder):
    calibrate("planes", *ORDER, "--overlay", "drawn")

    assert sorted(path.name for path in (folder / "drawn").iterdir()) == [
        "pln_B_01.png",
        "pln_B_03.png",
        "pln_B_05.png",
    ]


def test_the_summary_gives_micrometres_held_out_by_distance(folder, capsys):
    calibrate("planes", *ORDER)

    said = capsys.readouterr()
    assert said.out == ""
    assert "3 views, rms 3" in said.err
    assert "left: held out " in said.err
    assert " um at 0." in said.err


@pytest.mark.slow
def test_switched_frames_need_no_order(shared_data, folder):
    status = calibrate(str(shared_data / "rendered" / "calib_b" / "planes"))

    assert status == 0
    assert worst_angle_deg(written(folder)) < 0.01
