"""`ringpose calibrate-planes`: errors, reasons, exit statuses."""

import re

import cv2
import numpy as np
import pytest
from plane_views import ORDER, calibrate, calibrated, copy_views, run_in, written

from ringpose.files.images.sessions import write_session
from ringpose.types.session import Capture, Session

ROWS = ((550, 1200), (230, 550), (0, 230))
"""Between which rows the carried views have the stripes of left, middle and right."""


@pytest.fixture
def switched_shots(plane_folder):
    """The carried views as if the lasers had been on one after the other."""
    for file in sorted((plane_folder / "planes").glob("*.npz")):
        dark, lit = np.load(file)["images"]
        row = np.arange(len(lit))[:, None]
        frames = [dark, *(np.where((row >= first) & (row < last), lit, dark) for first, last in ROWS)]
        masks = np.array([0, 1, 2, 4], np.uint8)
        np.savez(file, images=np.stack(frames), lasers=masks, stamp_s=np.arange(4) / 10, exposure_s=np.full(4, 0.01))


@pytest.fixture(scope="module")
def poor_shots(carried_data, tmp_path_factory):
    """A calibration to which shots with one defect each are added."""
    folder = tmp_path_factory.mktemp("poor")
    copy_views(carried_data, folder)
    planes = folder / "planes"
    with np.load(planes / "pln_B_01.npz") as shot:
        dark, lit = shot["images"]
        row, column = np.indices(dark.shape)
        glow = 100 * np.exp(-((row - 450) ** 2 + (column - 800) ** 2) / (2 * 60**2))  # 141 px wide at half its height
        images = {
            "black": np.zeros((2, *dark.shape), np.uint8),
            "unlit": np.stack([dark, dark // 2]),
            "weak": np.stack([dark, np.maximum(dark, lit // 60)]),
            "blurred": np.stack([dark, cv2.add(dark, glow.astype(np.uint8))]),
            "full": np.stack([dark, np.full_like(lit, 255)]),
        }
        for name, pair in images.items():
            np.savez(planes / f"{name}.npz", **{**shot, "images": pair})
    return run_in(folder, lambda: calibrate("planes", *ORDER))


@pytest.mark.slow
def test_shots_without_board_or_stripes_are_named_with_the_reason_and_the_others_are_used(poor_shots):
    stderr = poor_shots.err

    assert poor_shots.status == 0
    assert "verdict: redo" not in stderr
    assert "ringpose calibrate-planes: black: no board: too dark" in stderr
    assert written(poor_shots.folder)["quality"]["without_board"][0]["name"] == "black"
    assert "unlit: no stripe of left, middle, right" in stderr
    assert "weak: no stripe of left, middle, right: 0 stripes on the board where 3 lasers are on: too dark" in stderr
    assert "of the board is saturated" in stderr
    width_px = re.search(r"blurred: .* where 3 lasers are on: blurred, or not the lasers' light: (\d+) px wide", stderr)
    assert float(width_px[1]) == pytest.approx(141, abs=15)


CHESSBOARD = "{kind: chessboard, squares_x: 8, squares_y: 6, square_m: 0.02}"


@pytest.mark.parametrize(
    ("words", "status", "named"),
    [
        ([], 65, "give --laser-order"),
        (["--laser-order", "up,middle,down"], 2, "--laser-order"),
        (["--laser-names", "a.b,c,d"], 2, "--laser-names"),
        (["--laser-names", "left,right"], 65, "a frame names laser 3, there are 2 (left, right)"),
        ([*ORDER, "--camera", "small.yaml"], 65, "1600 x 1200 pixels, the camera has 1280 x 1200"),
        ([*ORDER, "--method", "paper", "--board", "chessboard.yaml"], 2, "paper"),
        ([*ORDER, "--free-camera"], 2, "has no covariance"),
        ([*ORDER, "--free-camera", "--method", "total-least-squares"], 2, "--free-camera: only the joint method"),
        ([*ORDER, "--expected-angles", "ten"], 2, "--expected-angles"),
        ([*ORDER, "--expected-angles", "10"], 2, "has 1, must have 2; give left to middle, middle to right"),
        ([*ORDER, "--expected-angles", "-10,10"], 2, "is -10, must be 0 to 180; give degrees"),
        ([*ORDER, "--expected-angles", "nan,10"], 2, "is nan, must be 0 to 180; give degrees"),
        *(([*ORDER, "--working-distance", text], 2, "--working-distance") for text in ("0", "nan", "-1")),
    ],
)
def test_bad_usage_is_reported_and_no_rig_is_written(plane_folder, capsys, words, status, named):
    text = (plane_folder / "camera.yaml").read_text()
    (plane_folder / "small.yaml").write_text(text.replace("image_width: 1600", "image_width: 1280"))
    (plane_folder / "chessboard.yaml").write_text(CHESSBOARD)

    assert calibrate("planes", *words) == status
    assert named in capsys.readouterr().err
    assert not (plane_folder / "rig.yaml").exists()


@pytest.mark.parametrize("missing", ["--output", "--camera", "INPUT"])
def test_a_missing_argument_is_named(missing, plane_folder, capsys):
    words = {"--output": "rig.yaml", "--camera": "camera.yaml", "INPUT": "planes"}
    given = [part for name, value in words.items() if name != missing for part in (name, value) if part != "INPUT"]

    assert calibrated(*given) == 2
    assert f"{missing}: is missing" in capsys.readouterr().err


@pytest.mark.slow
def test_a_board_that_the_lasers_channel_does_not_show_is_found_in_the_luminance(plane_folder, capsys):
    for name in ("pln_B_01", "pln_B_05"):
        dark, lit = np.load(f"planes/{name}.npz")["images"]
        red = np.where(lit > dark + 12, lit, 40).astype(np.uint8)
        cv2.imwrite(f"planes/{name}.png", np.dstack([dark, dark, red]))
    for path in (plane_folder / "planes").glob("*.npz"):
        path.unlink()

    calibrate("planes", *ORDER, "--laser-names", "left,middle,right", "--channel", "r", "--verbose")

    assert "no board" not in (stderr := capsys.readouterr().err)
    assert "pln_B_01: 16 corners, 3 stripes" in stderr


def test_a_laser_that_is_never_lit_is_named_with_what_each_shot_showed(plane_folder, switched_shots, capsys):
    for name in ("pln_B_01", "pln_B_03", "pln_B_05"):
        with np.load(f"planes/{name}.npz") as shot:
            parts = dict(shot)
        parts["images"][3] = parts["images"][0]
        np.savez(f"planes/{name}.npz", **parts)

    status = calibrate("planes")

    stderr = capsys.readouterr().err
    assert status == 65
    assert 'laser "right": no stripe on the board in any of the 3 shots whose frames have it on' in stderr
    assert "pln_B_01: 0 stripes on the board where right is on: too dark" in stderr


@pytest.mark.parametrize(
    ("names", "status", "named"),
    [([["up", "down"]], 65, "there are 2 (up, down)"), (["a", "b"], 2, "sessions of the shots differ: a; b")],
)
def test_lasers_have_the_names_of_the_session_that_the_shots_are_from(
    names, status, named, plane_folder, switched_shots, capsys
):
    captures = tuple(Capture(camera="c", lasers="l", state="finished", laser_names=tuple(each)) for each in names)
    write_session(plane_folder / "planes", Session(captures=captures))

    assert calibrate("planes") == status
    assert named in capsys.readouterr().err


def test_images_without_the_number_of_lasers_are_rejected(plane_folder, capsys):
    cv2.imwrite("lit.png", np.load("planes/pln_B_01.npz")["images"][1])

    status = calibrate("lit.png")

    stderr = capsys.readouterr().err
    assert status == 2
    assert stderr.count("\n") == 1
    assert "--laser-names: lit does not state how many lasers are on; give one" in stderr


@pytest.mark.slow
def test_the_errors_of_poses_are_predicted_at_the_working_distance(plane_folder, capsys):
    calibrate("planes", *ORDER, "--working-distance", "1.0")

    assert re.search(r"poses 1\.00 m away will be off by \d+\.\d mm from this calibration", capsys.readouterr().err)
    findings = written(plane_folder)["quality"]["verdict"]["findings"]
    assert "at 1.00 m" in [finding["place"] for finding in findings if finding["name"] == "ring_center_sd_m"]


@pytest.mark.slow
def test_a_number_of_lasers_below_three_is_reported(plane_folder, switched_shots, capsys):
    for file in sorted((plane_folder / "planes").glob("*.npz")):
        with np.load(file) as shot:
            parts = {key: values[:3] for key, values in shot.items()}
        np.savez(file, **parts)

    calibrate("planes")

    note = "2 lasers by the shots' masks (laser_1, laser_2); if there are more, name all (--laser-names)"
    assert note in capsys.readouterr().err


@pytest.mark.slow
def test_moved_boards_and_exchanged_lasers_are_named_even_if_quiet(plane_folder, switched_shots, capsys):
    with np.load("planes/pln_B_05.npz") as shot:
        moved = np.stack([shot["images"][0], *np.roll(shot["images"][1:], 3, axis=2)])
        np.savez("planes/moved.npz", **{**shot, "images": moved})
    with np.load("planes/pln_B_03.npz") as shot:
        np.savez("planes/pln_B_03.npz", **{**shot, "lasers": np.array([0, 2, 1, 4], np.uint8)})

    status = calibrate("planes", "--quiet")

    stderr = capsys.readouterr().err
    assert status == 65
    assert "ringpose calibrate-planes: pln_B_03: left and middle are exchanged against the other shots" in stderr
    assert "; left out: see how its lasers were switched" in stderr
    assert "moved: the board, or the camera, moved by 3.0 px between its frames; left out" in stderr
    assert [view["name"] for view in written(plane_folder)["quality"]["boards"]] == ["pln_B_01", "pln_B_05"]
