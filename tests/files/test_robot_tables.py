"""Robot poses in tables, folders, YAML and JSON lines."""

import io
import json

import numpy as np
import pytest

from ringpose.errors import DataError, UsageError
from ringpose.files.robot_tables import read_tool_poses
from ringpose.geometry.robot_conventions import convention_named


def read(tmp_path, text, convention=None, columns=(), name="poses.csv"):
    file = tmp_path / name
    file.write_text(text)
    return read_tool_poses(str(file), None if convention is None else convention_named(convention), columns)


QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""A quarter turn about z."""


@pytest.mark.parametrize(
    ("text", "convention"),
    [
        ("shot,X,Y,Z,A,B,C\na,100,200,300,90,0,0\n", "kuka"),
        ("shot;X;Y;Z;A;B;C\na;100,0;200,0;300,0;90;0;0\n", "kuka"),
        ("A;B;C;name;Z;Y;X\n90;0;0;a;300;200;100\n", "kuka"),
        ("a {X 100.0, Y 200.0, Z 300.0, A 90, B 0, C 0}\n".replace("a {", "a, {"), "kuka"),
        ("VAR robtarget a:=[[100,200,300],[0.70711,0,0,0.70711],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n", "abb"),
        ("a, p[0.1, 0.2, 0.3, 0, 0, 1.5707963]\n", "ur"),
        ("a ((0.1, 0.2, 0.3), (0, 0, 0.70710678, 0.70710678))\n".replace("a (", "a, ("), "m,xyzw"),
        ("a 0 -1 0 0.1 1 0 0 0.2 0 0 1 0.3 0 0 0 1\n", "m,matrix"),
    ],
)
def test_what_robots_write_is_read(text, convention, tmp_path):
    (pose,) = read(tmp_path, text, convention).poses

    assert pose.name == "a"
    np.testing.assert_allclose(pose.position_m, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(pose.rotation, QUARTER, atol=2e-5)


def test_matrices_of_four_lines_are_read_in_millimetres(tmp_path):
    text = "0 -1 0 100\n1 0 0 200\n0 0 1 300\n0 0 0 1\n\n" * 2

    poses = read(tmp_path, text, "mm,matrix", name="poses.txt").poses

    assert len(poses) == 2
    np.testing.assert_allclose(poses[1].position_m, [0.1, 0.2, 0.3])


def test_columns_are_taken_by_their_given_names(tmp_path):
    (pose,) = read(
        tmp_path, "17 1.5 0 90 0 100 200 300\n", "kuka", ["-", "stamp_s", "C", "A", "B", "X", "Y", "Z"]
    ).poses

    assert pose.stamp_s == 1.5
    np.testing.assert_allclose(pose.rotation, QUARTER, atol=1e-12)


def test_messages_of_ros_are_read_from_yaml(tmp_path):
    text = """
poses:
  - header: {stamp: {sec: 5, nanosec: 500000000}}
    pose: {position: {x: 0.1, y: 0.2, z: 0.3}, orientation: {x: 0, y: 0, z: 0.70710678, w: 0.70710678}}
  - header: {stamp: {sec: 6, nanosec: 0}}
    transform: {translation: {x: 0.1, y: 0.2, z: 0.3}, rotation: {x: 0, y: 0, z: 0, w: 1}}
"""

    first, second = read(tmp_path, text, name="poses.yaml").poses

    assert (first.stamp_s, second.stamp_s) == (5.5, 6.0)
    np.testing.assert_allclose(first.rotation, QUARTER, atol=1e-7)


def test_a_folder_has_one_pose_a_file(tmp_path):
    for number in (1, 2):
        (tmp_path / f"pose{number}.txt").write_text(f"(({number}, 0, 0), (0, 0, 0, 1))")

    poses = read_tool_poses(str(tmp_path), convention_named("m,xyzw")).poses

    assert [(pose.name, pose.position_m[0]) for pose in poses] == [("pose1", 1.0), ("pose2", 2.0)]


def test_repeats_are_counted_and_contradictions_named_with_both_lines(tmp_path):
    line = "{},0.1,0.2,{},0,0,0,1\n"
    same = line.format("a", 0.3) * 3 + line.format("b", 0.4)

    assert read(tmp_path, same, "m,xyzw").repeats == 2
    with pytest.raises(DataError, match=r"poses.csv:3: has the name 'a' of .*poses.csv:1, but another pose"):
        read(tmp_path, line.format("a", 0.3) * 2 + line.format("a", 0.31), "m,xyzw")


def test_json_lines_need_no_stamp_where_they_name_the_shot(tmp_path):
    pose = {"position_m": [0.1, 0.2, 0.3], "orientation_xyzw": [0, 0, 0, 1]}

    (read_pose,) = read(tmp_path, json.dumps({"shot": "a", "base_from_tool": pose}), name="poses.jsonl").poses

    assert (read_pose.name, read_pose.stamp_s) == ("a", None)


@pytest.mark.parametrize(
    ("row", "convention", "cause"),
    [
        ("1000,200,300,0,0,0,1", "m,xyzw", "millimetres"),
        ("100,20,30,0,0,0,1", "m,xyzw", "millimetres"),
        ("1,0.2,0.3,10,20,30", "kuka", "in metres"),
        ("1000,200,300,0.5,1.2,-2.1", "kuka", "in radians"),
        ("1,0.2,0.3,90,0,90", "m,ZYX,rad", "in degrees"),
        ("1,0.2,0.3,0.5,0.5,0.5,0.9", "m,xyzw", "must be 1"),
        ("1000,200,300,inf,0,0", "kuka", "is inf, must be a number"),
        ("1000,200,300,0,0", "kuka", "--robot-columns"),
        ("1,0,0,0,0,1,0,0,0,0,1,0,0.1,0.2,0.3,1", "m,matrix", "column by column"),
        ("1,0,0,1000,0,1,0,200,0,0,1,300,0,0,0,1", "m,matrix", "millimetres"),
    ],
)
def test_implausible_values_are_refused_with_the_likely_cause(row, convention, cause, tmp_path):
    with pytest.raises(DataError, match=cause):
        read(tmp_path, f"{row}\n" * 3, convention, name="poses.txt")


@pytest.mark.parametrize("word", ["nan", "null", ".nan", "NaN", ""])
def test_nan_and_null_have_one_message_in_every_format(word, tmp_path):
    json_line = '{"base_from_tool": {"position_m": [0.1, 0.2, %s], "orientation_xyzw": [0, 0, 0, 1]}}\n'
    ros = "pose: {position: {x: 0.1, y: 0.2, z: %s}, orientation: {x: 0, y: 0, z: 0, w: 1}}\n"
    if word not in (".nan", ""):
        with pytest.raises(DataError, match="has null or NaN among its numbers; leave out what is not known"):
            read(tmp_path, json_line % word.replace("nan", "NaN"), name="poses.jsonl")
    if word.lower() != "nan":
        with pytest.raises(DataError, match="position: has null or NaN among its numbers; leave out what is not known"):
            read(tmp_path, ros % word, name="poses.yaml")
    if word != ".nan":
        with pytest.raises(DataError, match="csv:1: z: has null or NaN among its numbers; leave out what is not known"):
            read(tmp_path, f"a,0.1,0.2,{word},0,0,0,1\n", "ros")


def test_a_table_is_read_from_standard_input(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("shot X Y Z A B C\na 100 200 300 90 0 0\n"))

    (pose,) = read_tool_poses("-", convention_named("kuka")).poses

    assert (pose.name, pose.location) == ("a", "standard input:2")
    np.testing.assert_allclose(pose.rotation, QUARTER, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "convention", "message"),
    [
        ('{"stamp_s": 1}\n', "kuka", "--robot-convention: is of no use for JSON lines: their keys state it"),
        ("100 200 300 90 0 0\n", None, "give JSON lines, or --robot-convention for a table"),
        ("100 200 300 90 0\n", "kuka", "standard input:1: has 5 columns"),
        ("", "kuka", "standard input: holds no pose"),
    ],
)
def test_what_is_wrong_on_standard_input_is_named(text, convention, message, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(text))

    with pytest.raises((DataError, UsageError), match=message):
        read_tool_poses("-", None if convention is None else convention_named(convention))


@pytest.mark.parametrize("content", [b"1,2,3\x1b[2J,4,5,6\n", bytes(range(128, 256)) * 4])
def test_a_file_that_is_not_text_is_named_without_its_content(content, tmp_path):
    (tmp_path / "poses.csv").write_bytes(content)

    with pytest.raises(DataError, match=r"poses\.csv:1: is not text; give a table") as error:
        read_tool_poses(str(tmp_path / "poses.csv"), convention_named("kuka"))
    assert str(error.value).isprintable()


def test_a_table_without_a_convention_is_refused(tmp_path):
    with pytest.raises(UsageError, match="does not state units"):
        read(tmp_path, "1,2,3,0,0,0,1\n")
