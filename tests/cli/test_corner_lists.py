"""`ringpose calibrate-camera` on lists of corners that another program found."""

import json

import numpy as np
import pytest
import yaml
from known_views import TRUE_CAMERA, projected_px, true_poses

from ringpose.cli.main import main

BOARD = "{kind: chessboard, squares_x: 9, squares_y: 7, square_m: 0.03}"
PLACES = np.stack(np.meshgrid(np.arange(1, 9), np.arange(1, 7)), axis=-1).reshape(-1, 2) * 0.03


@pytest.fixture
def corners(rng) -> list[dict]:
    """Corners of ten views of that board, with noise, as another program lists them."""
    listed = []
    for view, (turn, place) in enumerate(true_poses(rng, 10)):
        pixels = projected_px(np.column_stack([PLACES, np.zeros(len(PLACES))]) @ turn.T + place)
        for number, (x, y) in enumerate(pixels + 0.03 * rng.standard_normal(pixels.shape)):
            listed.append({"view": f"v{view}", "id": number, "x_px": float(x), "y_px": float(y)})
    return listed


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs the command in a folder with these files; status, standard error and the camera that was written."""
    monkeypatch.chdir(tmp_path)

    def run(files: dict[str, str], *words: str):
        for name, text in files.items():
            (tmp_path / name).write_text(text)
        status = main(["calibrate-camera", "--output", "camera.yaml", "--force", *words])
        camera = tmp_path / "camera.yaml"
        return status, capsys.readouterr().err, yaml.safe_load(camera.read_text()) if camera.exists() else None

    return run


def table(corners: list[dict], separator: str = ",") -> str:
    return "\n".join([separator.join(corners[0]), *(separator.join(map(str, row.values())) for row in corners)])


def with_places(corners: list[dict]) -> list[dict]:
    return [row | dict(zip(("x_m", "y_m", "z_m"), (*PLACES[row["id"]], 0.0), strict=True)) for row in corners]


def test_a_table_and_json_lines_give_the_same_camera_within_its_sigmas(corners, run):
    lines = "\n".join(json.dumps(row) for row in with_places(corners))

    status, err, by_board = run(
        {"board.yaml": BOARD, "corners.csv": table(corners, ";")},
        "--board", "board.yaml", "--image-size", "1600x1200", "corners.csv",
    )  # fmt: skip
    _, _, by_places = run({"corners.jsonl": lines}, "--image-size", "1600x1200", "corners.jsonl")

    assert status == 0, err
    assert "10 of 10 views used" in err
    assert "210.0 x 150.0 mm" in err
    assert by_places["camera_matrix"] == by_board["camera_matrix"]
    matrix, sigma = np.reshape(by_board["camera_matrix"]["data"], (3, 3)), by_board["standard_deviations"]
    errors = (matrix - TRUE_CAMERA.camera_matrix)[[0, 1, 0, 1], [0, 1, 2, 2]]
    assert (np.abs(errors) < 3 * np.array([sigma[name] for name in ("fx", "fy", "cx", "cy")])).all()


@pytest.mark.slow
def test_opencvs_own_corners_give_the_published_camera(shared_data, run):
    """calib1.dat of opencv_extra, lengths in mm: 7 views of 35 corners."""
    words = (shared_data / "real" / "opencv_extra_calib" / "calib1.dat").read_text().split()
    numbers = np.array(words[5 : 5 + 7 * 35 * 5], dtype=np.float64)  # after the sizes of image and board, and 7
    places, pixels = numbers[: 7 * 105].reshape(7, 35, 3) / 1000, numbers[7 * 105 :].reshape(7, 35, 2)
    rows = [
        {"view": view, "id": 35 * view + number, "x_px": x, "y_px": y, "x_m": place[0], "y_m": place[1]}
        for view in range(7)
        for number, (place, (x, y)) in enumerate(zip(places[view], pixels[view], strict=True))
    ]

    _, err, camera = run({"c.csv": table(rows)}, "--image-size", "640x480", "--fix-k3", "--keep-all", "c.csv")

    assert camera is not None, err
    matrix = np.reshape(camera["camera_matrix"]["data"], (3, 3))
    assert matrix[[0, 1, 0, 1], [0, 1, 2, 2]] == pytest.approx([809.9479, 806.55964, 361.99611, 214.39514], abs=0.01)
    assert camera["distortion_coefficients"]["data"][:4] == pytest.approx(
        [-0.12821, -0.39441, -0.00435, -0.00732], abs=5e-5
    )


@pytest.mark.parametrize(
    ("change", "words", "found"),
    [
        (
            lambda rows: rows,
            ["--image-size", "1600x600"],
            "outside of images of 1600 x 600 pixels; correct --image-size",
        ),
        (lambda rows: [*rows, rows[0]], [], "id: is 0, which view v0 has already"),
        (lambda rows: [*rows[:-1], rows[-1] | {"z_m": 0.1}], [], "z_m: is 0.1, must be 0; give corners in one plane"),
        (lambda rows: [*rows[:-1], rows[-1] | {"x_m": 0.5}], [], "id: is 47, which was at 0.24, 0.18 m before"),
        (lambda rows: [*rows[:-1], rows[-1] | {"x_px": "12,5"}], [], "must be a number"),
        (lambda rows: [{"view": "a"}], [], "c.csv:1: has no column id in its first line"),
        (lambda rows: rows, ["--board", "board.yaml"], "x_m: is given, and so is --board; leave out one of them"),
        (lambda rows: rows, ["--channel", "r"], "--channel: needs images"),
        (lambda rows: rows, ["other.png"], "other.png is no list of corners"),
        (lambda rows: rows, ["--image-size", "1600"], "--image-size: is '1600'; give width and height"),
    ],
)
def test_a_list_that_cannot_be_is_named_with_its_line(change, words, found, corners, run):
    files = {"board.yaml": BOARD, "c.csv": table(change(with_places(corners)), "\t")}

    status, err, _ = run(files, "--image-size", "1600x1200", "c.csv", *words)

    assert status != 0
    assert found in err


def test_a_view_with_too_few_corners_is_left_out_and_named(corners, run):
    rows = with_places(corners)

    status, err, _ = run({"c.csv": table([rows[0] | {"view": "one"}, *rows[1:]])}, "--image-size", "1600x1200", "c.csv")

    assert status == 0
    assert "one: no board: 1 corners, 6 are needed" in err
