"""`--output` with `--resume`: an interrupted run that is continued gives what one run would have given."""

import json

import pytest


@pytest.fixture
def pose(run, rig, detections, tmp_path):
    return lambda *words: run("pose", detections, "--rig", rig, "--no-times", *words)


def interrupted(whole, part, lines):
    """Leave the first lines of a complete file as an interrupted run does."""
    kept = whole.read_text().splitlines(keepends=True)
    part.write_text("".join(kept[:lines]) + kept[lines][:20])


def test_poses_in_a_file_are_those_on_standard_output(pose, tmp_path):
    printed = pose()
    found = pose("--output", tmp_path / "poses.jsonl")

    assert (found.status, found.out) == (printed.status, [])
    assert (tmp_path / "poses.jsonl").read_text().splitlines() == printed.out


@pytest.mark.parametrize("command", ["pose", "track"])
def test_continued_lines_are_those_of_one_run(run, pose, tmp_path, rig, command):
    pose("--output", tmp_path / "poses.jsonl")
    words = {
        "pose": ["pose", tmp_path / "detections.jsonl"],
        "track": ["track", tmp_path / "poses.jsonl", "--max-speed", 1],
    }[command]
    words = [*words, "--rig", rig, "--no-times", "--output"]
    one = run(*words, tmp_path / "one.jsonl")
    interrupted(tmp_path / "one.jsonl", tmp_path / "two.jsonl.part", 1)

    refused = run(*words, tmp_path / "two.jsonl")
    found = run(*words, tmp_path / "two.jsonl", "--resume")

    assert refused.status == 73
    assert found.status == one.status
    assert (tmp_path / "two.jsonl").read_text() == (tmp_path / "one.jsonl").read_text()


def test_lines_of_other_inputs_are_not_continued(pose, tmp_path):
    pose("--output", tmp_path / "poses.jsonl")
    line = json.loads((tmp_path / "poses.jsonl").read_text().splitlines()[0])
    (tmp_path / "other.jsonl.part").write_text(json.dumps(line | {"shot": "stranger"}) + "\n")

    found = pose("--output", tmp_path / "other.jsonl", "--resume")

    assert found.status == 65
    assert "of the shot 'stranger', which is not the next of the inputs" in found.messages[0]
    assert not (tmp_path / "other.jsonl").exists()


def test_lines_of_another_rig_are_not_continued(pose, tmp_path, rig):
    pose("--output", tmp_path / "poses.jsonl")
    interrupted(tmp_path / "poses.jsonl", tmp_path / "other.jsonl.part", 1)
    rig.write_text(rig.read_text() + "\n")

    found = pose("--output", tmp_path / "other.jsonl", "--resume")

    assert (found.status, "another rig file" in found.messages[0]) == (65, True)


@pytest.mark.parametrize(
    ("options", "differs"),
    [
        (["--method", "paper"], "pose"),
        (["--risk", "1e-3"], "protection"),
        (["--radius-inner", "0.6"], "rejected"),
        (["--ring-tolerance", "0.001"], "priors"),
        (["--budget"], "budget"),
    ],
)
def test_lines_of_other_options_are_not_continued(pose, tmp_path, options, differs):
    pose("--output", tmp_path / "poses.jsonl")
    interrupted(tmp_path / "poses.jsonl", tmp_path / "other.jsonl.part", 1)

    found = pose("--output", tmp_path / "other.jsonl", "--resume", *options)

    assert (found.status, "other options" in found.messages[0]) == (65, True)
    assert differs in found.messages[0]


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["--resume"], "--output"),
        (["--output", "a.jsonl", "--resume", "--brief"], "--brief"),
        (["--output", "a.jsonl", "--resume", "--track"], "ringpose track"),
        (["--output", "a.jsonl", "--newest"], "--newest"),
    ],
)
def test_what_cannot_be_continued_is_wrong_usage(pose, words, option):
    found = pose(*words)

    assert (found.status, option in found.messages[0]) == (2, True)


def test_detections_of_another_rig_are_not_continued(run, carried_data, tmp_path):
    shot, rig = carried_data / "rig_b" / "shots" / "B_z0500_p00_dim.npz", carried_data / "rig_b" / "rig.yaml"
    words = ["detect", shot, "--output", tmp_path / "found", "--resume"]
    other = tmp_path / "other.yaml"
    other.write_text(rig.read_text() + "\n")
    assert run(*words, "--rig", rig).status == 0

    for without in (["--rig", other], ["--segments-only"]):
        found = run(*words, *without)
        assert (found.status, found.out) == (65, [])
        assert "was detected with another rig file" in found.messages[0]


def test_detections_that_are_there_are_left_out(run, carried_data, tmp_path):
    shots = sorted((carried_data / "rig_b" / "shots").iterdir())[:2]
    words = ["detect", *shots, "--rig", carried_data / "rig_b" / "rig.yaml", "--output", tmp_path]
    names = run(*words).out
    (tmp_path / f"{shots[1].stem}.npz").unlink()

    found = run(*words, "--resume", "--verbose")

    assert found.out == names
    assert [message.split(": ")[1] for message in found.messages] == [shots[1].stem]
