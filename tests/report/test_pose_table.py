"""The table of pose lines for a person: 80 columns, digits that the errors justify, and what degrades a pose."""

from dataclasses import replace

import numpy as np
import pytest
from whole_records import complete_line, complete_track

from ringpose.report.pose_table import WIDTH, PoseTable
from ringpose.types.pose import PoseFlag


@pytest.fixture
def line(rng):
    """A pose at 0.5 m, known to 0.2 mm and 0.03 degrees."""
    line = complete_line(rng)
    pose = replace(
        line.pose,
        grasp_m=np.array([0.0123456, -0.0345678, 0.5]),
        normal=np.array([0.0, 0.0, -1.0]),
        covariance_grasp_m2=np.diag([1e-4, 1e-4, 2.04e-4]) ** 2,
        covariance=np.diag(np.radians([0.0312, 0.01, 1, 1, 1, 1, 1])) ** 2,
    )
    return replace(line, shot="shot_1", pose=pose, flags=PoseFlag(0), reason=None)


def test_a_row_has_the_digits_that_its_standard_deviations_justify(line):
    _, names, row = PoseTable().text(line).splitlines()
    pitch, yaw = (float(f"{angle:.3f}") for angle in np.degrees([line.pose.pitch_rad, line.pose.yaw_rad]))

    assert names.split() == ["shot", "status", "x", "y", "z", "+-", "pitch", "yaw", "+-"]
    assert row.split()[:6] == ["shot_1", "ok", "12.35", "-34.57", "500.00", "0.20"]
    assert [float(each) for each in row.split()[6:]] == pytest.approx([pitch, yaw, 0.031])


def test_the_heading_stands_once_and_names_the_frame(line):
    table = PoseTable()
    assert f"{line.frame} frame" in table.text(line).splitlines()[0]
    assert len(table.text(line).splitlines()) == 1


def test_flags_that_degrade_and_the_reason_follow_within_the_width(line):
    why = "the stripe of laser 2 lies 12 standard deviations off the plane of the others, which are on the ring"
    poor = replace(line, shot="a_name_of_more_than_eighteen_letters", flags=PoseFlag.CENTER_WEAK, reason=why)
    row, *further = PoseTable().text(poor).splitlines()[2:]

    assert row.split()[1] == "degraded"
    assert " ".join(" ".join(further).split()) == f"center_weak; {why}"
    assert max(map(len, [row, *further])) <= WIDTH


def test_what_is_not_determined_is_a_dash(line):
    unknown = replace(line.pose, normal=np.full(3, np.nan), covariance=None, covariance_grasp_m2=None)
    row = PoseTable().text(replace(line, pose=unknown)).splitlines()[2]
    assert row.split()[5:] == ["-", "-", "-", "-"]


def test_a_line_without_pose_has_its_reason(line):
    rows = PoseTable().text(replace(line, pose=None, reason="no laser stripe found")).splitlines()[2:]
    assert [row.strip() for row in rows] == ["shot_1             none", "no laser stripe found"]


def test_a_line_of_a_track_is_a_row(rng):
    track = complete_track(rng)
    row = PoseTable().text(track).splitlines()[2]
    assert row.split()[:2] == [track.attempt.shot, track.status]
