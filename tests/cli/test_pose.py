import json

import numpy as np
import pytest
import yaml
from schemas import validated

from ringpose.cli.main import main
from ringpose.files.records.poses import pose_line_of

CENTER_M = [0.58, 0.02, 0.9]
"""Of the ring whose break points the fixture `detections` holds."""


def lines(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def pose_lines(text: str) -> list[dict]:
    return [validated(record) for record in lines(text)]


@pytest.mark.parametrize("method", ["paper", "paper-constrained"])
def test_pose_of_exact_break_points_is_exact(rig, detections, capsys, method):
    assert main(["pose", str(detections), "--rig", str(rig), "--method", method]) == 0

    records = pose_lines(capsys.readouterr().out)
    assert [record["shot"] for record in records] == ["a", "b", "c"]
    np.testing.assert_allclose(records[0]["pose"]["center_m"], CENTER_M, atol=1e-9)
    np.testing.assert_allclose(records[0]["pose"]["normal"], [0, 0, -1], atol=1e-9)


def test_pose_in_the_tool_frame_is_the_cameras_moved_by_the_mount(rig, detections, capsys):
    mount = np.array(yaml.safe_load(rig.read_text())["mount"]["tool_from_camera"])

    words = ["pose", str(detections), "--rig", str(rig), "--method", "paper-constrained", "--frame", "tool"]
    assert main(words) == 0

    record = pose_lines(capsys.readouterr().out)[0]
    np.testing.assert_allclose(record["pose"]["center_m"], (mount @ [*CENTER_M, 1])[:3], atol=1e-9)
    np.testing.assert_allclose(record["pose"]["normal"], mount[:3, :3] @ [0, 0, -1], atol=1e-9)
    assert record["frame"] == "tool"


def test_tool_frame_needs_the_mount(rig, detections, capsys):
    values = yaml.safe_load(rig.read_text())
    del values["mount"]
    rig.write_text(yaml.safe_dump(values))

    assert main(["pose", str(detections), "--rig", str(rig), "--frame", "tool"]) == 65

    captured = capsys.readouterr()
    assert (captured.out, captured.err.count("\n")) == ("", 1)
    assert "has no mount" in captured.err


def test_line_names_the_rig_by_its_hash_and_the_time_it_took(rig, detections, capsys):
    main(["pose", str(detections), "--rig", str(rig)])

    line = pose_line_of(pose_lines(capsys.readouterr().out)[0], "x")
    assert len(line.rig) == 64
    assert 0 < line.latency_s < 5
    assert line.stamp_s == 1.7e9


def test_brief_lines_have_no_measurement(rig, detections, capsys):
    main(["pose", str(detections), "--rig", str(rig)])
    full = pose_lines(capsys.readouterr().out)
    main(["pose", str(detections), "--rig", str(rig), "--brief"])
    brief = pose_lines(capsys.readouterr().out)

    differing = {"latency_s": None, "stage_s": None, "measurement": None, "plane_evidence": None}
    assert all("measurement" in line and "plane_evidence" in line for line in full)
    assert not any("measurement" in line or "plane_evidence" in line for line in brief)
    assert [line | differing for line in brief] == [line | differing for line in full]


def test_shot_without_break_points_is_a_line_with_its_reason(rig, picture, capsys):
    assert main(["pose", str(picture("black.png")), "--rig", str(rig)]) == 3

    (record,) = pose_lines(capsys.readouterr().out)
    assert (record["shot"], record["status"], record["pose"]) == ("black", "none", None)
    assert record["reason"] == "the image is dark: no stripe stands out of the noise"


def test_bad_inputs_are_named_and_the_rest_goes_on(rig, detections, picture, tmp_path, capsys):
    (tmp_path / "broken.png").write_bytes(picture("whole.png", 40).read_bytes()[:100])
    words = ["pose", str(tmp_path / "none.npz"), str(tmp_path / "broken.png"), str(detections), "--rig", str(rig)]

    assert main(words) == 66

    captured = capsys.readouterr()
    assert len(pose_lines(captured.out)) == 3
    missing, broken = captured.err.splitlines()
    assert missing == f"ringpose: {tmp_path}/none.npz: does not exist"
    assert broken.startswith(f"ringpose: {tmp_path}/broken.png: is a PNG image that is cut short")


def test_detection_of_another_number_of_lasers_is_refused(rig, detections, capsys):
    values = yaml.safe_load(rig.read_text())
    rig.write_text(yaml.safe_dump(values | {"lasers": values["lasers"][:2]}))

    assert main(["pose", str(detections), "--rig", str(rig)]) == 65

    captured = capsys.readouterr()
    assert captured.out == ""
    assert "has 3 lasers, the rig has 2" in captured.err


def test_detection_without_break_points_of_another_number_of_lasers_is_refused(rig, tmp_path, capsys):
    record = {"schema": "ringpose/detection/2", "shot": "a", "stamp_s": 1.0, "reason": "no laser stripe found"}
    (tmp_path / "none.jsonl").write_text(json.dumps(record | {"lasers_on": [True, True]}))

    assert main(["pose", str(tmp_path / "none.jsonl"), "--rig", str(rig)]) == 65
    assert "none.jsonl:1: lasers_on: has 2 lasers, the rig has 3" in capsys.readouterr().err


@pytest.mark.parametrize(("key", "limit_px"), [("position_px", 1281.0), ("face_start_px", 7041.0)])
def test_detection_beside_the_rigs_image_is_refused(rig, detections, tmp_path, capsys, key, limit_px):
    records = lines(detections.read_text())
    place = records[0]["break_points"][key][1]
    (place[0] if key == "position_px" else place)[0] = limit_px
    changed = tmp_path / "changed.jsonl"
    changed.write_text("".join(json.dumps(record) + "\n" for record in records))

    assert main(["pose", str(changed), "--rig", str(rig)]) == 65

    captured = capsys.readouterr()
    assert len(pose_lines(captured.out)) == len(records) - 1
    assert f"{changed}:1: break_points.{key}: lies beyond the image of 640 x 480 pixels" in captured.err


def test_shot_without_a_pose_still_tells_the_health_of_each_laser(rig, picture, capsys):
    main(["pose", str(picture("black.png")), "--rig", str(rig)])

    (record,) = pose_lines(capsys.readouterr().out)
    names = [laser["name"] for laser in yaml.safe_load(rig.read_text())["lasers"]]
    assert record["rig_health"] == dict.fromkeys(names)


def test_what_is_no_name_ends_no_stream(rig, detections, tmp_path, monkeypatch, capsys):
    (tmp_path / "stdin").write_bytes(b"a\0b\n" + 3000 * b"x" + b"\n" + detections.read_bytes())
    with (tmp_path / "stdin").open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        status = main(["pose", "-", "--rig", str(rig)])

    captured = capsys.readouterr()
    assert status == 66
    assert len(pose_lines(captured.out)) == 3
    assert "is not a valid file name" in captured.err
    assert max(map(len, captured.err.splitlines())) < 200


def test_verbose_says_what_became_of_each_shot(rig, detections, capsys):
    main(["pose", str(detections), "--rig", str(rig), "--still", "-v"])  # version 1 has no stamps of features

    captured = capsys.readouterr()
    record = pose_lines(captured.out)[0]
    assert captured.err.startswith(f"ringpose: a: {', '.join(record['flags']) or 'ok'}")


def test_nothing_is_said_where_all_is_well(rig, detections, capsys):
    main(["pose", str(detections), "--rig", str(rig)])

    assert capsys.readouterr().err == ""


def test_missing_rig_is_no_input(detections, tmp_path, capsys):
    assert main(["pose", str(detections), "--rig", str(tmp_path / "none.yaml")]) == 66
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("words", "finding"),
    [
        (["--rings", "rings.yaml"], "--rings: a catalogue needs --ring"),
        (["--ring", "auto", "--radius-outer", "0.6"], "--ring: the catalogue gives the radii"),
        (["--radius-sd", "0.001"], "--radius-sd: needs a radius"),
        (["--radius-outer", "597"], "--radius-outer: 597 is not the radius of a ring in metres; give metres: 0.597"),
        (["--radius-outer", "nan"], "--radius-outer: nan is not the radius of a ring in metres"),
        (
            ["--radius-outer", "0.597", "--radius-inner", "567"],
            "--radius-inner: 567 is not the radius of a ring in metres",
        ),
        (["--radius-outer", "0.597", "--radius-sd", "0.5"], "give metres: 0.0005"),
        (
            ["--radius-outer", "0.597", "--radius-sd", "1e-300"],
            "--radius-sd: 1e-300 is not a plausible standard deviation",
        ),
        (["--radius-outer", "0.5", "--radius-inner", "0.6"], "--radius-inner: is not smaller"),
        (["--ring", "nominal-1195"], "did you mean 'nominal-1194'?"),
        (["--method", "paper", "--radius-outer", "0.6"], "paper does not use the ring's radii"),
    ],
)
def test_what_cannot_be_known_of_a_ring_is_wrong_usage(rig, detections, capsys, words, finding):
    status = main(["pose", str(detections), "--rig", str(rig), *words])

    assert status == 2
    assert finding in capsys.readouterr().err


def test_a_catalogue_gives_probabilities(rig, detections, capsys):
    main(["pose", str(detections), "--rig", str(rig), "--ring", "auto"])

    posterior = pose_lines(capsys.readouterr().out)[0]["pose"]["ring_posterior"]
    assert {"nominal-1194", "none of these"} < set(posterior)


@pytest.mark.parametrize("name", ["mine", "auto"])
@pytest.mark.parametrize(("words", "tolerance_m"), [([], 3e-4), (["--ring-tolerance", "0.0002"], 2e-4)])
def test_the_tolerance_of_a_ring_of_the_catalogue_is_assumed(
    rig, detections, tmp_path, capsys, name, words, tolerance_m
):
    (tmp_path / "rings.yaml").write_text(
        "ringpose: rings/1\nrings: [{name: mine, radius_inner_m: [0.5665, 0.5675], radius_outer_m: [0.5965, 0.5975], "
        "source: drawing 12, tolerance_m: 0.0003}]"
    )

    main(["pose", str(detections), "--rig", str(rig), "--rings", str(tmp_path / "rings.yaml"), "--ring", name, *words])

    assert pose_lines(capsys.readouterr().out)[0]["priors"]["ring_tolerance_m"] == tolerance_m


def test_a_known_radius_is_the_radius(rig, detections, capsys):
    main(["pose", str(detections), "--rig", str(rig), "--radius-outer", "0.597", "--radius-sd", "1e-6"])

    assert pose_lines(capsys.readouterr().out)[0]["pose"]["radius_outer_m"] == pytest.approx(0.597, abs=1e-4)


@pytest.mark.parametrize(
    "words",
    [
        ["--method", "paper", "--max-speed", "0.1"],
        ["--method", "paper", "--robot-poses", "poses.jsonl"],
        ["--count", "3"],
        ["--sequence", "all"],
    ],
)
def test_options_that_would_be_ignored_are_wrong_usage(rig, detections, capsys, words):
    assert main(["pose", str(detections), "--rig", str(rig), *words]) == 2
    assert words[-2] in capsys.readouterr().err
