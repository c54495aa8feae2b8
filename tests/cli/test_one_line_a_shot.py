"""One shot in gives one line out: `pose` reads all that `detect` writes, and no shot's numbers end the stream."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from drawn_scene import DrawnScene, draw_shot, drawn_rig, true_break_points
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from schemas import validated

from ringpose.cli.main import main
from ringpose.detect.break_points import MAX_END_SIGMA_PX
from ringpose.detect.pipeline import detect
from ringpose.files import records
from ringpose.files.images.shots import write_shot
from ringpose.files.records.detections import checked_detection, detection_of, detection_record
from ringpose.files.records.poses import pose_line_of, pose_record
from ringpose.files.rigs import read_rig
from ringpose.measure.stream import Setup, pose_line
from ringpose.types.detection import MAX_SIGMA_PX, BreakPointFlag, BreakPoints
from ringpose.types.options import Method, PoseFrame
from ringpose.types.pose import NoPose

SCENE, DRAWN_RIG = DrawnScene(), drawn_rig()
ENDS_PX = true_break_points(SCENE, DRAWN_RIG)
relaxed = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@pytest.fixture(scope="module")
def drawn_shot():
    return draw_shot(SCENE, DRAWN_RIG, [0, 1, 2, 4], np.random.default_rng(1))


def without_times(line):
    return pose_record(replace(line, latency_s=0.0, stage_s={}))


def test_a_shot_and_its_detection_give_the_same_line(drawn_shot):
    detection = detect(drawn_shot, DRAWN_RIG)
    read = read_back(detection, DRAWN_RIG)

    validated(json.loads(records.line_of(detection_record(detection))))
    line = Setup(rig=DRAWN_RIG).measure(drawn_shot)

    assert read.ring is not None
    assert records.line_of(without_times(pose_line(read, DRAWN_RIG))) == records.line_of(without_times(line))


def test_a_detection_whose_ring_is_far_off_gives_the_same_pose(drawn_shot):
    detection = detect(drawn_shot, DRAWN_RIG)
    far = replace(detection.ring, origin_m=detection.ring.origin_m + 1e3, curvature_per_m=-1e3)

    lines = [pose_line(replace(detection, ring=ring), DRAWN_RIG) for ring in (far, None)]

    np.testing.assert_allclose(*(line.pose.center_m for line in lines), rtol=1e-9)


def with_glint(shot, laser, edge, start_px, length_px, level):
    """The shot with a bright patch in all frames: from so far outside a stripe's end, negative inside, outward."""
    x, y = ENDS_PX[laser, edge].astype(int)
    first, last = (x + start_px, x + length_px) if edge == 0 else (x - length_px, x - start_px)
    images = shot.images.copy()
    images[:, y - 25 : y + 25, max(first, 0) : max(last, 0)] = level
    return replace(shot, images=images)


@pytest.fixture
def rig_of_shots(rig):
    return read_rig(rig)


def read_back(detection, rig):
    record = records.parsed_record(records.line_of(detection_record(detection)), "x")
    return checked_detection(detection_of(record, "x"), rig, "x")


def round_trip(line):
    return pose_line_of(validated(records.parsed_record(records.line_of(pose_record(line)), "x")), "x")


def test_an_end_that_a_saturated_glint_hides_is_not_measured(drawn_shot):
    found = detect(with_glint(drawn_shot, 1, 0, -6, 60, 255), DRAWN_RIG).break_points

    assert isinstance(found, BreakPoints)
    assert not found.seen[1, 0]
    assert found.flags[1, 0] & BreakPointFlag.UNCLEAR
    assert found.seen.sum() == 5


@pytest.mark.slow
@settings(relaxed, max_examples=2)
@example(laser=1, edge=0, start_px=-6, length_px=60, level=255)
@given(
    laser=st.integers(0, 2),
    edge=st.integers(0, 1),
    start_px=st.integers(-9, 3),
    length_px=st.integers(8, 60),
    level=st.sampled_from([200, 245, 255]),
)
def test_what_detect_writes_of_a_glint_pose_reads(drawn_shot, laser, edge, start_px, length_px, level):
    detection = detect(with_glint(drawn_shot, laser, edge, start_px, length_px, level), DRAWN_RIG)

    after = read_back(detection, DRAWN_RIG)

    assert type(after.break_points) is type(detection.break_points)
    if isinstance(after.break_points, BreakPoints):
        assert np.nanmax(after.break_points.covariance_px2) <= MAX_END_SIGMA_PX**2
    line = pose_line(after, DRAWN_RIG, Method.ML, PoseFrame.CAMERA)
    assert round_trip(line).status == line.status


@st.composite
def admissible_records(draw):
    """Changes to a good record's break points, each within what a record may hold."""
    sigma = st.sampled_from([0.0, 1e-300, 1e-9, 0.1, 10.0, MAX_SIGMA_PX])
    offset = st.sampled_from([0.0, 1e-9, 0.3, -20.0, 300.0])
    number = st.integers(0, 2)
    changes = []
    for _ in range(draw(st.integers(1, 5))):
        key = draw(st.sampled_from(["position_px", "face_start_px", "face_sigma_px", "covariance_px2", "flags"]))
        values = (draw(offset), draw(offset), draw(sigma), draw(st.integers(0, 127)))
        changes.append((key, draw(number), draw(st.integers(0, 1)), draw(st.booleans()), values))
    return changes


def changed(points, changes):
    for key, laser, edge, missing, (dx, dy, sigma, flag) in changes:
        row = points[key][laser]
        if key == "position_px":
            row[edge] = [None, None] if missing else [(row[edge][0] or 0.0) + dx, (row[edge][1] or 0.0) + dy]
        elif key == "face_start_px":
            points[key][laser] = [None, None] if missing else [(row[0] or 0.0) + dx, (row[1] or 0.0) + dy]
        elif key == "covariance_px2":
            row[edge] = [[None] * 2] * 2 if missing else [[sigma**2, 0.0], [0.0, sigma**2]]
        else:
            row[edge] = flag if key == "flags" else sigma
    return points


@settings(relaxed, max_examples=20)
@given(changes=admissible_records(), method=st.sampled_from(list(Method)))
def test_every_admissible_record_is_a_line_that_can_be_read(rig_of_shots, detections, changes, method):
    record = json.loads(detections.read_text().splitlines()[0])
    record["break_points"] = changed(record["break_points"], changes)

    detection = checked_detection(detection_of(record, "x"), rig_of_shots, "x")
    line = pose_line(detection, rig_of_shots, method, PoseFrame.CAMERA)

    assert round_trip(line).status == line.status
    assert (line.status == "none") == (line.pose is None)
    assert line.pose is not None or line.reason


def test_equations_that_cannot_be_solved_are_a_line_with_a_reason(rig, detections, capsys, monkeypatch):
    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("ringpose.measure.stream.most_likely_pose", singular)

    records_of_shots = [json.loads(line) for line in detections.read_text().splitlines()]
    rejection = {"what": "point", "laser": "middle", "edge": "inner", "opposite": False, "chi2": None}
    detections.write_text("".join(json.dumps(each | {"rejected": [rejection]}) + "\n" for each in records_of_shots))

    assert main(["pose", str(detections), "--rig", str(rig)]) == 3

    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["shot"], line["status"]) for line in lines] == [(shot, "none") for shot in "abc"]
    assert {line["reason"] for line in lines} == {NoPose.SINGULAR.value}
    assert {tuple(line["lasers"].values()) for line in lines} == {3 * ("rejected",)}
    assert all(line["rejected"] == [rejection] for line in lines)


def upright_stripe(points):
    """A stripe's line runs along the columns and has no error, that of another is missing: a singular plane."""
    points["face_end_px"][0] = [None, None]
    points["face_start_px"][2], points["face_end_px"][2], points["face_sigma_px"][2] = [0, 323], [0, 0], [0, 0]


def distant_exact_end(points):
    """An end far from the others has no error along its stripe: rounding exceeds what is left of the curvature."""
    points["position_px"][0][0] = [None, None]
    points["position_px"][2][0][0] = 0.0
    points["covariance_px2"][2][1] = [[0, 0], [0, 0.01]]
    points["face_sigma_px"][2][0] = None


@pytest.mark.parametrize("degenerate", [upright_stripe, distant_exact_end])
def test_degenerate_numbers_end_no_stream(rig, detections, tmp_path, capsys, degenerate):
    record = json.loads(detections.read_text().splitlines()[0]) | {"shot": "degenerate"}
    degenerate(record["break_points"])
    file = tmp_path / "degenerate.jsonl"
    file.write_text(json.dumps(record) + "\n" + detections.read_text())

    main(["pose", str(file), "--rig", str(rig)])

    captured = capsys.readouterr()
    assert [json.loads(line)["shot"] for line in captured.out.splitlines()] == ["degenerate", "a", "b", "c"]
    assert captured.err == ""


def drawn_rig_file(path):
    camera, lasers = DRAWN_RIG.camera, DRAWN_RIG.lasers
    matrix = {"rows": 3, "cols": 3, "data": camera.camera_matrix.ravel().tolist()}
    coefficients = {"rows": 1, "cols": 5, "data": camera.distortion_coefficients.tolist()}
    values = {
        "ringpose": "rig/1",
        "camera": {
            "image_width": camera.image_width,
            "image_height": camera.image_height,
            "camera_matrix": matrix,
            "distortion_model": camera.distortion_model,
            "distortion_coefficients": coefficients,
        },
        "lasers": [
            {"name": name, "normal": normal, "distance_m": distance}
            for name, normal, distance in zip(
                lasers.names, lasers.normal.tolist(), lasers.distance_m.tolist(), strict=True
            )
        ],
    }
    path.write_text(yaml.safe_dump(values))
    return path


@pytest.mark.slow
def test_each_shot_that_can_be_read_comes_through_the_pipe(forked, drawn_shot, tmp_path):
    rig = drawn_rig_file(tmp_path / "rig.yaml")
    folder = tmp_path / "shots"
    folder.mkdir()
    shots = {"a": drawn_shot, "b_glint": with_glint(drawn_shot, 1, 0, -6, 60, 255), "d": drawn_shot}
    shots["e_dark"] = replace(drawn_shot, images=np.zeros_like(drawn_shot.images))
    for name, shot in shots.items():
        write_shot(folder / f"{name}.npz", replace(shot, name=name))
    (folder / "c_broken.npz").write_bytes((folder / "a.npz").read_bytes()[:-1000])
    with (
        forked(["detect", folder, "--rig", rig]) as first,
        forked(["pose", "-", "--rig", rig], stdin=first.stdout) as second,
    ):
        out, said = second.communicate(timeout=600)
        refused = first.stderr.read()

    lines = {record["shot"]: record["status"] for record in map(json.loads, out.splitlines())}
    assert list(lines) == sorted(shots)
    assert lines["e_dark"] == "none"
    assert "c_broken.npz" in refused
    assert (said, first.returncode, second.returncode) == ("", 65, 3)
