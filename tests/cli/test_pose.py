import json
import time
from copy import deepcopy

import numpy as np
import pytest
import yaml

from ringpose.files.records.poses import pose_line_of

CENTER_M = [0.58, 0.02, 0.9]
"""Of the ring whose break points the fixture `detections` holds."""


@pytest.fixture
def pose(run, rig, detections):
    """Runs `ringpose pose` with the rig, of the detections unless other inputs are given."""
    return lambda *words, inputs=(detections,): run("pose", *inputs, "--rig", rig, *words)


@pytest.mark.parametrize("method", ["paper", "paper-constrained"])
def test_pose_of_exact_break_points_is_exact(pose, method):
    found = pose("--method", method)

    assert found.status == 0
    assert [record["shot"] for record in found.records] == ["a", "b", "c"]
    np.testing.assert_allclose(found.records[0]["pose"]["center_m"], CENTER_M, atol=1e-9)
    np.testing.assert_allclose(found.records[0]["pose"]["normal"], [0, 0, -1], atol=1e-9)


def test_pose_in_the_tool_frame_is_the_cameras_moved_by_the_mount(pose, rig):
    mount = np.array(yaml.safe_load(rig.read_text())["mount"]["tool_from_camera"])

    found = pose("--method", "paper-constrained", "--frame", "tool")

    assert found.status == 0
    np.testing.assert_allclose(found.records[0]["pose"]["center_m"], (mount @ [*CENTER_M, 1])[:3], atol=1e-9)
    np.testing.assert_allclose(found.records[0]["pose"]["normal"], mount[:3, :3] @ [0, 0, -1], atol=1e-9)
    assert found.records[0]["frame"] == "tool"


def test_tool_frame_needs_the_mount(pose, rig):
    values = yaml.safe_load(rig.read_text())
    del values["mount"]
    rig.write_text(yaml.safe_dump(values))

    status, out, (message,) = pose("--frame", "tool")

    assert (status, out) == (65, [])
    assert "has no mount" in message


def test_line_names_the_rig_by_its_hash_and_the_time_it_took(pose):
    began_s = time.monotonic()

    found = pose()

    line = pose_line_of(found.records[0], "x")
    assert len(line.rig) == 64
    assert 0 < line.latency_s < time.monotonic() - began_s
    assert line.stamp_s == 1.7e9
    assert found.messages == []


def test_brief_lines_have_no_measurement(pose):
    full, brief = pose().records, pose("--brief").records

    rounded_keys = {"latency_s", "stage_s", "pose", "velocity", "rig_health"}
    assert all("measurement" in line and "plane_evidence" in line for line in full)
    assert not any("measurement" in line or "plane_evidence" in line for line in brief)
    for short, long in zip(brief, full, strict=True):
        assert {**long, **{key: short[key] for key in rounded_keys}} == {
            **short,
            **{key: long[key] for key in ("measurement", "plane_evidence")},
        }
        assert pose_line_of(short, "x").pose is not None


def test_shot_without_break_points_has_a_line_without_pose_and_with_every_laser(pose, rig, picture):
    (record,) = pose(inputs=[picture("black.png")]).records

    assert (record["shot"], record["status"], record["pose"]) == ("black", "none", None)
    assert record["rig_health"] == dict.fromkeys(laser["name"] for laser in yaml.safe_load(rig.read_text())["lasers"])


def test_detection_of_another_number_of_lasers_is_refused(pose, rig):
    values = yaml.safe_load(rig.read_text())
    rig.write_text(yaml.safe_dump(values | {"lasers": values["lasers"][:2]}))

    status, out, messages = pose()

    assert (status, out) == (65, [])
    assert "has 3 lasers, the rig has 2" in messages[0]


def test_detection_without_break_points_of_another_number_of_lasers_is_refused(pose, tmp_path):
    record = {"schema": "ringpose/detection/2", "shot": "a", "stamp_s": 1.0, "reason": "no laser stripe found"}
    (tmp_path / "none.jsonl").write_text(json.dumps(record | {"lasers_on": [True, True]}))

    status, _, (message,) = pose(inputs=[tmp_path / "none.jsonl"])

    assert status == 65
    assert "none.jsonl:1: lasers_on: has 2 lasers, the rig has 3" in message


@pytest.mark.parametrize("output", ["-", "found"])
def test_detections_are_measured_with_their_own_rig_only(run, pose, rig, picture, tmp_path, output):
    black, detections = picture("black.png"), tmp_path / "found.jsonl"
    found = run("detect", black, "--rig", rig, "--output", output if output == "-" else tmp_path / output)
    detections.write_text("\n".join(found.out))
    inputs = [detections if output == "-" else tmp_path / output]
    assert pose(inputs=inputs).status == 3
    rig.write_text(rig.read_text() + "\n# calibrated again\n")

    status, out, (message,) = pose(inputs=inputs)

    assert (status, out) == (65, [])
    assert "is of another rig" in message


@pytest.mark.parametrize("part", ["break_points", "repeated"])
@pytest.mark.parametrize(("key", "limit_px"), [("position_px", 1281.0), ("face_start_px", 7041.0)])
def test_detection_beside_the_rigs_image_is_refused(pose, detections, tmp_path, part, key, limit_px):
    records = [json.loads(line) for line in detections.read_text().splitlines()]
    records[0]["repeated"] = deepcopy(records[0]["break_points"])
    place = records[0][part][key][1]
    (place[0] if key == "position_px" else place)[0] = limit_px
    changed = tmp_path / "changed.jsonl"
    changed.write_text("".join(json.dumps(record) + "\n" for record in records))

    status, out, (message,) = pose(inputs=[changed])

    assert (status, len(out)) == (65, len(records) - 1)
    assert f"{changed}:1: {part}.{key}: lies beyond the image of 640 x 480 pixels" in message


def test_what_is_not_a_name_ends_no_stream(pose, detections, tmp_path, monkeypatch):
    (tmp_path / "stdin").write_bytes(b"a\0b\n" + 3000 * b"x" + b"\n" + detections.read_bytes())
    with (tmp_path / "stdin").open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        status, out, messages = pose(inputs=["-"])

    assert (status, len(out)) == (66, 3)
    assert "is not a valid file name" in messages[0]
    assert max(map(len, messages)) < 200


def test_verbose_reports_what_became_of_each_shot(pose):
    found = pose("--still", "-v")  # version 1 has no stamps of features

    assert found.messages[0].startswith(f"ringpose pose: a: {', '.join(found.records[0]['flags']) or 'ok'}")


@pytest.mark.parametrize(
    ("words", "finding"),
    [
        ("--rings rings.yaml", "--rings: a catalogue needs --ring"),
        ("--ring auto --radius-outer 0.6", "--ring: the catalogue gives the radii"),
        ("--radius-sd 0.001", "--radius-sd: needs a radius"),
        ("--radius-outer 597", "--radius-outer: is 597, must be 0.02 to 5; give metres: 0.597"),
        ("--radius-outer nan", "--radius-outer: is nan, must be 0.02 to 5"),
        ("--radius-outer 0.597 --radius-inner 567", "--radius-inner: is 567, must be 0.02 to 5"),
        ("--radius-outer 0.597 --radius-sd 0.5", "give metres: 0.0005"),
        ("--radius-outer 0.597 --radius-sd 1e-300", "--radius-sd: is 1e-300, must be 1e-06 to 0.1194"),
        ("--radius-outer 0.5 --radius-inner 0.6", "--radius-inner: is not smaller"),
        ("--ring nominal-1195", "did you mean 'nominal-1194'?"),
        ("--method paper --radius-outer 0.6", "paper does not use the ring's radii"),
        ("--method paper --max-speed 0.1", "--max-speed"),
        ("--method paper --max-rate 3", "--max-rate"),
        ("--method paper-constrained --ring-tolerance 0.001", "--ring-tolerance"),
        ("--method paper --robot-poses poses.jsonl", "--robot-poses"),
        ("--count 3", "--count"),
        ("--sequence all", "--sequence"),
        ("--predict-for 1", "--track"),
        ("--track --method paper", "--method"),
        ("--track --frame tool", "--frame"),
        ("--frame base", "--robot-poses"),
        ("--robot-convention kuka", "--robot-poses"),
        ("--frame base --robot-poses poses.jsonl --overlay pictures", "--overlay"),
        ("--track --max-speed 0", "--max-speed"),
        ("--track --lost-after 1", "--lost-after"),
        ("--track --gripper-tilt-deg 1", "--gripper-radial-m"),
    ],
)
def test_options_that_contradict_each_other_or_would_be_ignored_are_wrong_usage(pose, words, finding):
    status, out, (message,) = pose(*words.split())

    assert (status, out) == (2, [])
    assert finding in message


def test_a_catalogue_gives_probabilities(pose):
    posterior = pose("--ring", "auto").records[0]["pose"]["ring_posterior"]

    assert {"nominal-1194", "none of these"} < set(posterior)


@pytest.mark.parametrize("name", ["mine", "auto"])
@pytest.mark.parametrize(("words", "tolerance_m"), [([], 3e-4), (["--ring-tolerance", "0.0002"], 2e-4)])
def test_the_tolerance_of_a_ring_of_the_catalogue_is_assumed(pose, tmp_path, name, words, tolerance_m):
    (tmp_path / "rings.yaml").write_text(
        "ringpose: rings/1\nrings: [{name: mine, radius_inner_m: [0.5665, 0.5675], radius_outer_m: [0.5965, 0.5975], "
        "source: drawing 12, tolerance_m: 0.0003}]"
    )

    found = pose("--rings", tmp_path / "rings.yaml", "--ring", name, *words)

    assert found.records[0]["priors"]["ring_tolerance_m"] == tolerance_m


def test_a_known_radius_is_the_radius(pose):
    found = pose("--radius-outer", "0.597", "--radius-sd", "1e-6")

    assert found.records[0]["pose"]["radius_outer_m"] == pytest.approx(0.597, abs=1e-4)


@pytest.mark.parametrize("place", ["800", "a,b", "-1,0", "1600,0", "0,1200"])
def test_a_place_of_the_grasp_point_outside_the_image_is_refused(pose, place):
    status, out, (message,) = pose("--grasp-near", place)

    assert (status, out) == (2, [])
    assert message.startswith("ringpose pose: --grasp-near:")
    assert "such as" in message


def test_a_terminal_gets_a_table_unless_records_are_asked_for(run, rig, detections, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    words = ["pose", detections, "--rig", rig, "--still"]

    table = run(*words).out

    assert [row.split()[0] for row in table[2:] if not row.startswith(" ")] == ["a", "b", "c"]
    assert [json.loads(line)["shot"] for line in run(*words, "--json").out] == ["a", "b", "c"]
    assert run(*words, "--brief").out[0].startswith("{")


@pytest.mark.parametrize("track", [[], ["--track"]])
def test_without_times_the_same_input_gives_the_same_output(run, rig, detections, track):
    words = ["pose", detections, "--rig", rig, "--no-times", *track]
    once = run(*words).out

    assert run(*words).out == once
    assert json.loads(once[0])["latency_s"] is None
