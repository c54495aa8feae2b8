import numpy as np
import pytest
import yaml

from ringpose.errors import DataError
from ringpose.files.boards import read_board, write_board
from ringpose.geometry.board import corner_points
from ringpose.types.board import Board, BoardMarker

SIZES = {"squares_x": 11, "squares_y": 8, "square_m": 0.025, "marker_m": 0.018}
CHARUCO = {"kind": "charuco", "dictionary": "DICT_4X4_50"} | SIZES
FOUR_MARKERS = {"width_m": 0.3, "height_m": 0.24, "marker_m": 0.06, "margin_m": 0.01, "dictionary": "DICT_4X4_50"}
BOARDS = [
    Board(**CHARUCO, legacy_pattern=True),
    Board(kind="chessboard", squares_x=10, squares_y=7, square_m=0.025, square_y_m=0.026),
    Board(kind="four_markers", **FOUR_MARKERS, order="0 left"),
    Board(kind="aruco_grid", squares_x=5, squares_y=7, marker_m=0.04, gap_m=0.01, dictionary="DICT_4X4_50"),
    Board(
        kind="marker_map",
        dictionary="DICT_4X4_50",
        markers=(BoardMarker(id=7, corners_m=((0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1))),),
    ),
    Board(kind="separate_squares", squares_x=8, squares_y=8, square_m=0.0127, gap_m=0.0098778),
    Board(kind="aprilgrid", squares_x=5, squares_y=7, marker_m=0.04, gap_m=0.01, dictionary="DICT_APRILTAG_36h11"),
    Board(kind="asymmetric_circles", squares_x=4, squares_y=11, spacing_in_row_m=0.02),
    Board(kind="symmetric_circles", squares_x=4, squares_y=11, spacing_m=0.02),
]


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.kind)
def test_board_is_read_as_it_was_written(tmp_path, board):
    write_board(tmp_path / "board.yaml", board)

    assert read_board(tmp_path / "board.yaml") == board


@pytest.mark.parametrize(
    ("changes", "finding"),
    [
        ({"kind": "charucco"}, "kind: is 'charucco', must be one of charuco"),
        (
            {"square_m": 25},
            "square_m: is 25, must be 0.0005 to 1; give metres: 0.025 if it is in millimetres, 0.25 if",
        ),
        ({"square_m": -0.02}, "square_m: is -0.02, must be 0.0005 to 1"),
        ({"square_m": 1e-320}, "square_m: is 9.99989e-321, must be 0.0005 to 1; give metres"),
        ({"marker_m": 0.03}, "marker_m: is 0.03, must be smaller than square_m"),
        ({"squares_x": 1}, "squares_x: is 1, must be at least 2 and at most 200"),
        ({"kind": "chessboard", "squares_y": 3}, "squares_y: is 3, must be at least 4"),
        ({"squares_x": 100_000}, "squares_x: is 100000, must be at least 2 and at most 200"),
        ({"squares_x": 11.0}, "squares_x: is 11.0, must be a whole number"),
        ({"dictionary": None}, "dictionary: is null, must have a value"),
        ({"legacy_pattern": "yes"}, "legacy_pattern: is the text 'yes', must be true or false"),
        ({"squre_m": 0.02}, "unknown key 'squre_m'; did you mean 'square_m'?"),
        ({"square_y_m": 0.026}, "square_y_m: does not belong to a board of the kind charuco"),
        *(({key: None}, f"{key}: is null, must have a value") for key in SIZES),
    ],
)
def test_an_invalid_board_is_rejected(tmp_path, changes, finding):
    (tmp_path / "board.yaml").write_text(yaml.safe_dump(CHARUCO | changes))

    with pytest.raises(DataError) as caught:
        read_board(tmp_path / "board.yaml")

    assert str(caught.value).startswith(f"{tmp_path / 'board.yaml'}: {finding}")


APRILGRID = """target_type: 'aprilgrid' #gridtype
tagCols: 3               #number of apriltags
tagRows: 2               #number of apriltags
tagSize: 0.08            #size of apriltag, edge to edge [m]
tagSpacing: 0.3          #ratio of space between tags to tagSize
"""


def test_a_target_of_kalibr_has_its_places_and_numbers(tmp_path):
    """Kalibr counts corners from the lower left, x right and y up, row by row across the markers."""
    (tmp_path / "aprilgrid.yaml").write_text(APRILGRID)

    board = read_board(tmp_path / "aprilgrid.yaml")

    up = np.array([0, 0.08, 0.104, 0.184])
    right = np.array([0, 0.08, 0.104, 0.184, 0.208, 0.288])
    kalibr = np.stack(np.meshgrid(right, up), axis=-1).reshape(-1, 2)
    margin_m, bottom_m = 0.024, 0.184 + 0.024
    assert corner_points(board)[:, :2] == pytest.approx(np.array([margin_m, bottom_m]) + kalibr * [1, -1], abs=1e-12)


@pytest.mark.parametrize(
    ("before", "after", "finding"),
    [
        ("0.3 ", "24  ", "tagSpacing: is 24, must be at least 0.01 and at most 1"),
        ("tagSize: 0.08", "tagSize: 80", "tagSize: is 80, must be 0.0002 to 1; give metres: 0.08 if"),
        ("'aprilgrid'", "'checkerboard'", "target_type: is 'checkerboard', only 'aprilgrid' is read; write a board"),
        ("'aprilgrid'", "'circlegrid'", "only 'aprilgrid' is read; write a board file of kind: symmetric_circles or"),
        ("'aprilgrid'", "'dots'", "target_type: is 'dots', must be one of aprilgrid"),
        ("tagRows: 2", "codeOffset: 7", "codeOffset: is 7, must be 0"),
        ("tagRows: 2", "tagRow: 2", "unknown key 'tagRow'; did you mean 'tagRows'?"),
    ],
)
def test_a_target_of_kalibr_that_cannot_be_is_rejected(before, after, finding, tmp_path):
    (tmp_path / "aprilgrid.yaml").write_text(APRILGRID.replace(before, after))

    with pytest.raises(DataError) as caught:
        read_board(tmp_path / "aprilgrid.yaml")

    assert finding in str(caught.value)


SQUARE = [[0.01, 0.02], [0.05, 0.02], [0.05, 0.06], [0.01, 0.06]]


@pytest.mark.parametrize(
    ("markers", "finding"),
    [
        ([], "markers: is empty"),
        ([{"id": 3, "corners_m": SQUARE[:3]}], "markers[0].corners_m: has 3 corners, must have 4"),
        (
            [{"id": 3, "corners_m": SQUARE[::-1]}],
            "are not the corners of a square in clockwise order; x is right and y",
        ),
        (
            [{"id": 3, "corners_m": [[-x, y] for x, y in SQUARE]}],
            "from -0.05 to 0.06; give metres from the board's upper",
        ),
        ([{"id": 3, "corners_m": SQUARE}] * 2, "markers[1].id: is 3, which another marker has"),
        (
            [{"id": 50, "corners_m": SQUARE}],
            'dictionary: dictionary "DICT_4X4_50" has markers 0 to 49, the board has 50',
        ),
        ([{"number": 3, "corners_m": SQUARE}], "markers[0]: has no key 'id'"),
    ],
)
def test_a_map_of_markers_that_cannot_be_is_rejected(markers, finding, tmp_path):
    board = {"kind": "marker_map", "dictionary": "DICT_4X4_50", "markers": markers}
    (tmp_path / "board.yaml").write_text(yaml.safe_dump(board))

    with pytest.raises(DataError) as caught:
        read_board(tmp_path / "board.yaml")

    assert finding in str(caught.value)


CIRCLES = {"kind": "asymmetric_circles", "squares_x": 4, "squares_y": 11}


@pytest.mark.parametrize("key", ["spacing_m", "spacing_in_row_m", "spacing_diagonal_m"])
def test_each_convention_of_asymmetric_circles_gives_the_distances_that_it_names(tmp_path, key):
    """Closed form: the second row is shifted by half the distance in a row; the diagonal is at 45 degrees."""
    (tmp_path / "board.yaml").write_text(yaml.safe_dump(CIRCLES | {key: 0.03}))

    first, second, *_ = rows = corner_points(read_board(tmp_path / "board.yaml")).reshape(11, 4, 3)

    distance_m = {
        "spacing_m": second[0, 1] - first[0, 1],
        "spacing_in_row_m": first[1, 0] - first[0, 0],
        "spacing_diagonal_m": np.linalg.norm(second[0] - first[0]),
    }
    assert distance_m[key] == pytest.approx(0.03, rel=1e-12)
    assert distance_m["spacing_in_row_m"] == pytest.approx(2 * distance_m["spacing_m"], rel=1e-12)
    assert np.ptp(rows[..., 1]) == pytest.approx(10 * distance_m["spacing_m"], rel=1e-12)


@pytest.mark.parametrize(
    ("sizes", "finding"),
    [
        ({}, "has no key 'spacing_m', 'spacing_in_row_m' or 'spacing_diagonal_m'; give the one that you have measured"),
        ({"spacing_m": 0.02, "spacing_in_row_m": 0.04}, "spacing_in_row_m: is given beside spacing_m; give the one"),
        ({"spacing_diagonal_m": 20}, "spacing_diagonal_m: is 20, must be 0.0005 to 1; give metres"),
    ],
)
def test_a_circle_grid_has_one_spacing(tmp_path, sizes, finding):
    (tmp_path / "board.yaml").write_text(yaml.safe_dump(CIRCLES | sizes))

    with pytest.raises(DataError, match=finding):
        read_board(tmp_path / "board.yaml")


def test_markers_wider_than_the_board_are_rejected(tmp_path):
    (tmp_path / "board.yaml").write_text(yaml.safe_dump({"kind": "four_markers"} | FOUR_MARKERS | {"height_m": 0.1}))

    with pytest.raises(DataError, match="wider than the board"):
        read_board(tmp_path / "board.yaml")


DICTIONARY = """%YAML:1.0
nmarkers: 2
markersize: 3
marker_0: "101110000"
marker_1: "000111011"
"""
OWN = "{kind: aruco_grid, squares_x: 2, squares_y: 1, marker_m: 0.03, gap_m: 0.01, dictionary: own.yml}"


def test_markers_of_a_dictionary_file_are_read(tmp_path):
    (tmp_path / "own.yml").write_text(DICTIONARY)
    (tmp_path / "board.yaml").write_text(OWN)

    assert read_board(tmp_path / "board.yaml").marker_bits == ("101110000", "000111011")


@pytest.mark.parametrize(
    ("before", "after", "found"),
    [
        ("000111011", "00011101", "3 x 3 digits 0 or 1"),
        ("000111011", "000111012", "3 x 3 digits 0 or 1"),
        ("nmarkers: 2", "nmarkers: 3", "marker_2"),
        ("markersize: 3", "markersize: 30", "at most 10"),
        (DICTIONARY, "", 'no dictionary "own.yml"; give one of OpenCV'),
    ],
)
def test_a_damaged_or_missing_dictionary_is_rejected(tmp_path, before, after, found):
    if after:
        (tmp_path / "own.yml").write_text(DICTIONARY.replace(before, after))
    (tmp_path / "board.yaml").write_text(OWN)

    with pytest.raises(DataError, match=found):
        read_board(tmp_path / "board.yaml")
