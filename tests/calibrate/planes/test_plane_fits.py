"""Planes through points, the paper's and the nearest."""

import numpy as np
import pytest

from ringpose.calibrate.planes.plane_fit import paper_plane, robust_plane


def test_the_papers_plane_and_the_nearest_plane_agree_on_exact_points(rng):
    points = rng.uniform(-1, 1, (50, 3))
    points[:, 2] = 2 + 0.3 * points[:, 0] - 0.2 * points[:, 1]

    paper, nearest = paper_plane(points), robust_plane(points)

    assert np.abs(paper[0] - nearest[0]).max() < 1e-12
    assert paper[1] == pytest.approx(nearest[1], abs=1e-12)


def test_a_third_of_wrong_points_does_not_move_the_robust_plane(rng):
    points = rng.uniform(-1, 1, (300, 3)) * [1, 1, 0] + rng.normal(0, 1e-4, (300, 3)) + [0, 0, 2]
    points[:90, 2] += rng.uniform(0.01, 0.5, 90)

    normal, distance_m, _ = robust_plane(points)

    assert np.abs(normal - [0, 0, 1]).max() < 1e-4
    assert distance_m == pytest.approx(2, abs=1e-4)
