"""Numbers of the console: truth, estimate and error beside each other, and the plots as CSV."""

import csv
import re

import numpy as np
import pytest

pytest.importorskip("viser")

from known_poses import pose_of

from ringpose.console.display import comparison_html, csv_of
from ringpose.types.truth import Truth

TRUTH = Truth(
    shot="a",
    expect="pose",
    center_m=np.array([0.57, 0.03, 0.5]),
    normal=np.array([0.0, 0.0, -1.0]),
    radius_inner_m=0.567,
    radius_outer_m=0.597,
)


def rows_of(html):
    rows = re.findall(r"<tr><td>([^<]+)</td>(.*?)</tr>", html)
    return {name: re.findall(r"<td>([^<]*)</td>", cells) for name, cells in rows}


def test_truth_estimate_sigma_and_error_are_in_mm_and_degrees():
    pose = pose_of(
        center_m=TRUTH.center_m + np.array([0.001, 0.0, -0.002]),
        normal=np.array([0.0, np.sin(0.01), -np.cos(0.01)]),
        radius_inner_m=0.567,
        radius_outer_m=0.598,
        covariance=np.diag([1e-3, 2e-3, 1e-4, 1e-3, 1e-3, 3e-3, 4e-3]) ** 2,
        covariance_center_m2=np.diag([1e-3, 2e-3, 3e-3]) ** 2,
    )

    rows = rows_of(comparison_html(pose, TRUTH))

    assert rows["centre x (mm)"] == ["570.00", "571.00", "1.00", "1.00"]
    assert rows["centre z (mm)"] == ["500.00", "498.00", "3.00", "-2.00"]
    assert rows["pitch (deg)"] == ["0.00", "-0.57", "0.11", "-0.57"]
    assert rows["outer radius (mm)"] == ["597.00", "598.00", "4.00", "1.00"]


def test_without_a_pose_the_truth_stands_alone():
    rows = rows_of(comparison_html(None, TRUTH))

    assert rows["centre x (mm)"] == ["570.00", "-", "-", "-"]
    assert len(rows) == 7


def test_the_csv_has_what_the_plots_show():
    text = csv_of("time (s)", [0.5, 1.5], [(1.0, 2.0, 0.1, 0.2, np.nan, 0.02), (3.0, 4.0, 0.3, 0.4, 0.03, 0.04)])

    head, first, second = csv.reader(text.splitlines())
    assert head[:3] == ["time (s)", "error of the centre (mm)", "sigma of the error of the centre (mm)"]
    assert (first, second[0]) == (["0.5", "1", "2", "0.1", "0.2", "", "0.02"], "1.5")
