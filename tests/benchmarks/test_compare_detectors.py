"""The comparison of line detectors."""

import cv2
import numpy as np
import pytest
from benchmarks.compare_detectors import main

NAMES = [
    "EdgeDrawing",
    "LSD",
    "FastLineDetector",
    "Canny+HoughLinesP",
    "ringpose length",
    "ringpose refined",
    "ringpose stripes",
]


@pytest.fixture
def bars(tmp_path):
    """A picture of a bright bar in rows 99 to 101, columns 100 to 539, and a file of its edges."""
    image = np.zeros((480, 640), np.uint8)
    image[99:102, 100:540] = 255
    cv2.imwrite(str(tmp_path / "bars.png"), image)
    (tmp_path / "bars.csv").write_text("x1,y1,x2,y2\n100,98.5,539,98.5\n100,101.5,539,101.5\n")
    return tmp_path / "bars.png"


def test_photographs_with_annotated_lines_have_recall_by_length(bars, capsys):
    main([str(bars), "--lines", str(bars.parent), "--rounds", "1"])

    title, heading, *rows = capsys.readouterr().out.rstrip().splitlines()
    figures = {row.split("  ")[0]: row.split()[-4:] for row in rows}
    assert (title, heading.split("  ")[-2:]) == ("1 images", ["recall 1.5 px", "recall 3 px"])
    assert list(figures) == NAMES
    assert figures["EdgeDrawing"][0] == "1.000"
    assert float(figures["ringpose refined"][2]) > 0.9


@pytest.mark.slow
def test_synthetic_images_have_the_detection_chain_too(capsys):
    main(["--kind", "dark", "--seeds", "1", "--rounds", "1"])

    title, heading, *rows = capsys.readouterr().out.rstrip().splitlines()
    assert title == "dark"
    assert heading.split()[:5] == ["detector", "ms", "ratio", "segments", "recall"]
    assert [row.split("  ")[0] for row in rows] == [*NAMES, "ringpose detect"]
