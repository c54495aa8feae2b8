"""How much of the lines of real images the line detector finds."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from ringpose.detect.line_segments import find_segments
from ringpose.types.options import SegmentMethod


def recalled_px(truth, segments, distances_px, angle_rad):
    """Length of one true segment that lies beside found ones, for each distance, sampled at each pixel."""
    start, end = truth.reshape(2, 2)
    true_px = np.linalg.norm(end - start)
    along = (end - start) / true_px
    found = segments.end_px - segments.start_px
    length = np.linalg.norm(found, axis=1)
    found = found / length[:, None]
    parallel = abs(found[:, 0] * along[1] - found[:, 1] * along[0]) < np.sin(angle_rad)
    found, length, first = found[parallel], length[parallel], segments.start_px[parallel]
    samples = start + np.linspace(0, 1, 2 * round(true_px) + 1)[1::2, None] * (end - start)
    offset = samples[:, None] - first
    ahead = (offset * found).sum(axis=2)
    aside = abs(offset[..., 0] * found[:, 1] - offset[..., 1] * found[:, 0])
    aside[(ahead < -1) | (ahead > length + 1)] = np.inf
    nearest = aside.min(axis=1, initial=np.inf)
    return true_px * (nearest[:, None] <= distances_px).mean(axis=0)


def york_recall(folder: Path, method, distances_px):
    """Length-weighted recall over all photographs; their lines count pixels from 1."""
    recalled = total = 0.0
    for photograph in sorted((folder / "images").glob("*.jpg")):
        (lines,) = (folder / "lines").glob(f"{photograph.stem}*.csv")
        truth = np.loadtxt(lines, delimiter=",", skiprows=1)[:, :4] - 1
        segments = find_segments(cv2.imread(str(photograph), cv2.IMREAD_GRAYSCALE), method=method)
        recalled += sum(recalled_px(line, segments, distances_px, np.radians(5)) for line in truth)
        total += np.hypot(*(truth[:, 2:] - truth[:, :2]).T).sum()
    return recalled / total


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "floors"), [(SegmentMethod.LENGTH, [0.64, 0.77]), (SegmentMethod.REFINED, [0.76, 0.84])]
)
def test_recall_on_the_york_photographs_at_one_and_a_half_and_three_pixels(shared_data: Path, method, floors):
    recall = york_recall(shared_data / "real" / "yorkurban", method, np.array([1.5, 3.0]))

    assert (recall > floors).all(), recall
