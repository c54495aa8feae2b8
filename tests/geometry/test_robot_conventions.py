"""Conventions of robots' poses, against scipy and the examples of the manual."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ringpose.errors import UsageError
from ringpose.files.robot_tables import read_tool_poses
from ringpose.geometry.robot_conventions import ANGLE_ORDERS, CONVENTIONS, convention_named

MANUAL = Path(__file__).parents[2] / "man" / "ringpose-robot.7"


@pytest.mark.parametrize("order", ANGLE_ORDERS)
def test_angles_are_those_of_scipys_orders(order):
    angles_deg = np.array([20.0, -35.0, 50.0])

    rotation = convention_named(f"mm,{order},deg").rotation_of(angles_deg)

    expected = Rotation.from_euler(order, angles_deg, degrees=True).as_matrix()
    np.testing.assert_allclose(rotation, expected, atol=1e-12)


def test_quaternions_and_rotation_vectors_are_scipys():
    turn = Rotation.from_rotvec([0.3, -0.5, 0.9])
    x, y, z, w = turn.as_quat()

    for text, numbers in (
        ("m,xyzw", [x, y, z, w]),
        ("m,wxyz", [w, x, y, z]),
        ("m,rotation_vector,rad", turn.as_rotvec()),
    ):
        rotation = convention_named(text).rotation_of(np.array(numbers))
        np.testing.assert_allclose(rotation, turn.as_matrix(), atol=1e-12)


def test_every_convention_has_words_that_mean_the_same():
    for name, convention in CONVENTIONS.items():
        same = convention_named(convention.text)
        assert (same.length_m, same.rotation, same.order) == (
            convention.length_m,
            convention.rotation,
            convention.order,
        ), name
        assert same.angle_rad == convention.angle_rad


def rows_of_the_manual() -> dict[str, str]:
    found = re.findall(r"^\.It Cm (\w+)\n.*: ([-\d. ]+)$", MANUAL.read_text(), re.MULTILINE)
    return dict(found)


def test_the_manual_has_an_example_of_every_convention():
    assert set(rows_of_the_manual()) == set(CONVENTIONS)


@pytest.mark.parametrize("name", CONVENTIONS)
def test_the_manuals_example_is_read_as_the_pose_that_it_states(name, tmp_path):
    file = tmp_path / "poses.txt"
    file.write_text(rows_of_the_manual()[name] + "\n")

    (pose,) = read_tool_poses(str(file), convention_named(name), (), name == "tum").poses

    np.testing.assert_allclose(pose.position_m, [0.1, 0.2, 0.3], atol=1e-9)
    np.testing.assert_allclose(pose.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-4)


@pytest.mark.parametrize(
    ("text", "word"),
    [("kuka2", "must be one of"), ("mm,ZYX", "deg or rad"), ("ZYX,deg", "m or mm"), ("m,xyzw,deg", "quaternions")],
)
def test_incomplete_conventions_are_refused(text, word):
    with pytest.raises(UsageError, match=word):
        convention_named(text)
