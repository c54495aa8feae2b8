"""`ringpose bench detectors` and `ringpose bench speed`."""

import json
from pathlib import Path

import pytest

from ringpose.cli.main import main

NAMES = [
    "EdgeDrawing",
    "LSD",
    "FastLineDetector",
    "Canny+HoughLinesP",
    "ringpose length",
    "ringpose refined",
    "ringpose stripes",
]


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def bars(picture):
    """A picture of a bright bar in rows 99 to 101, columns 100 to 539, and its edges as MATLAB counts."""
    picture("bars.png", rows=(100,))
    Path("lines").mkdir()
    Path("lines/bars.csv").write_text("x1,y1,x2,y2\n101,99.5,540,99.5\n101,102.5,540,102.5\n")
    return "bars.png"


def test_images_with_drawn_lines_have_recall_by_length(bars, capsys):
    words = ["--lines-truth", "lines", "--lines-origin", "1", "--rounds", "1", "--json", "-"]

    status = main(["bench", "detectors", bars, *words])

    report = json.loads(capsys.readouterr().out)
    lines = {line["detector"]: line for line in report["groups"][0]["detectors"]}
    assert (status, report["ringpose"], list(lines)) == (0, "bench_detectors/1", NAMES)
    assert lines["EdgeDrawing"]["ratio"] == 1
    assert lines["ringpose refined"]["length_recall"]["1.5"] > 0.9
    assert lines["ringpose refined"]["recall"] is None


def test_synthetic_images_have_the_whole_detection_too(capsys):
    status = main(["bench", "detectors", "--kind", "dark", "--seeds", "1", "--rounds", "1"])

    title, heading, *rows = capsys.readouterr().out.splitlines()
    assert (status, title) == (0, "dark: 1 of 1600 x 1200 pixels")
    assert heading.split()[:5] == ["detector", "ms", "ratio", "segments", "recall"]
    assert [row.split("  ")[0] for row in rows] == [*NAMES, "ringpose detect"]


def test_a_report_goes_into_a_file_beside_the_table(bars, capsys):
    words = ["bench", "detectors", bars, "--rounds", "1", "--json", "report.json"]

    statuses = [main(words), main(words), main([*words, "--force"])]

    assert statuses == [0, 73, 0]
    assert capsys.readouterr().out.startswith("images: 1 of 640 x 480 pixels\n")
    assert list(json.loads(Path("report.json").read_text())["provenance"]["inputs"]) == [bars]


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (["--kind", "purple"], 2, 'ringpose: --kind: there is no kind "purple"; there are dark, dim, speckle'),
        (["--lines-truth", "lines"], 2, "ringpose: --lines-truth: belongs to images, and none is given"),
        (["nowhere.png"], 66, "ringpose: nowhere.png: does not exist"),
        (["bars.png", "--lines-truth", "."], 66, "ringpose: bars.csv: does not exist, but bars.png wants its lines"),
        (["lines/bars.csv"], 65, "ringpose: lines/bars.csv: is no image"),
    ],
)
def test_what_cannot_be_compared_is_one_line(bars, capsys, words, status, complaint):
    ended = main(["bench", "detectors", *words])

    streams = capsys.readouterr()
    assert (ended, streams.out) == (status, "")
    assert len(streams.err.splitlines()) == 1
    assert streams.err.startswith(complaint)


def test_a_bad_image_does_not_stop_the_rest(bars, capsys):
    status = main(["bench", "detectors", "nowhere.png", bars, "--rounds", "1"])

    streams = capsys.readouterr()
    assert status == 66
    assert "nowhere.png" in streams.err
    assert streams.out.startswith("images: 1 of 640 x 480 pixels\n")


def test_a_folder_of_that_name_can_still_be_meant(capsys):
    Path("detectors").mkdir()

    status = main(["bench", "./detectors"])

    assert status == 66
    assert "detectors/rig.yaml: does not exist" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["detectors", "speed"])
def test_help_has_the_words_and_is_light(started, command):
    heavy = "{'numpy', 'cv2', 'scipy', 'yaml', 'rich', 'jaxtyping'}"
    after = f"import atexit, sys\natexit.register(lambda: print(*sys.modules.keys() & {heavy}, file=sys.stderr))"
    with started("bench", command, "--help", before=after) as process:
        printed, said = process.communicate(timeout=60)

    assert (process.returncode, said.split()) == (0, [])
    assert f"Usage: ringpose bench {command} " in printed


@pytest.mark.slow
def test_every_figure_of_speed_has_its_verdict(capsys):
    status = main(["bench", "speed", "--seeds", "1", "--rounds", "1", "--json", "-"])

    sections = json.loads(capsys.readouterr().out)["sections"]
    assert status == 0
    assert [section["section"].split(",")[0] for section in sections] == [
        "straight segments",
        "image to break points",
        "break points to pose",
        "stripe centres",
        "break points",
        "start",
    ]
    assert {gate["verdict"] for section in sections for gate in section["gates"]} <= {"ok", "MISSED", "not yet", "none"}
