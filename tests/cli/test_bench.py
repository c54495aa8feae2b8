"""`ringpose bench`, on poses that are off by known amounts."""

import csv
import hashlib
import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from known_poses import CENTER_M, NORMAL, on_ring, pose_of, truth_of, write_lines, write_truths

from ringpose.cli.main import main
from ringpose.files.records import line_of
from ringpose.files.records.poses import pose_record
from ringpose.types.pose import PoseLine, RingPose

pytestmark = pytest.mark.usefixtures("empty_folder")


def pose_off_by(off_m: float) -> RingPose:
    """Centre and grasp point off along the ring's axis, radii along themselves, the normal by as many radians."""
    return pose_of(
        center_m=CENTER_M - off_m * NORMAL,
        normal=np.array([math.sin(off_m), 0.0, -math.cos(off_m)]),
        radius_inner_m=0.4 + off_m,
        radius_outer_m=0.5 - off_m,
        grasp_m=on_ring(0.0, 0.45) - off_m * NORMAL,
    )


def write_poses(**offsets_m: float | None) -> str:
    """A line for each shot; None has no pose."""
    shots = {shot: None if off_m is None else pose_off_by(off_m) for shot, off_m in offsets_m.items()}
    reason = "no laser stripe found"
    lines = [PoseLine(shot=s, stamp_s=0.0, pose=p, reason=None if p else reason) for s, p in shots.items()]
    return write_lines("poses.jsonl", lines)


@pytest.fixture
def poses() -> str:
    """Two shots at half a metre, off by 3 and 4 mm, one at a metre without a pose."""
    write_truths("truth.jsonl", [truth_of(shot=s, groups={"distance_m": 1.0 if s == "c" else 0.5}) for s in "abc"])
    return write_poses(a=0.003, b=-0.004, c=None)


def report_of(capsys, *words: str) -> tuple[int, dict]:
    status = main(["bench", *words, "--truth", "truth.jsonl", "--json", "-"])
    return status, json.loads(capsys.readouterr().out)


def test_poses_of_another_rig_than_the_one_given_are_rejected(capsys, rig):
    write_truths("truth.jsonl", [truth_of(shot=shot) for shot in "ab"])
    own = hashlib.sha256(rig.read_bytes()).hexdigest()
    lines = [PoseLine(shot=s, stamp_s=0.0, pose=pose_off_by(0.0), rig=r) for s, r in (("a", own), ("b", "5b" * 32))]
    write_lines("poses.jsonl", lines)

    status, report = report_of(capsys, "poses.jsonl", "--rig", str(rig))

    assert status == 65
    assert report["groups"][-1]["outcomes"]["lost"] == 1


@pytest.mark.parametrize("name", ["poses.jsonl", "-"])
def test_errors_and_failures_are_reported_by_group(poses, capsys, monkeypatch, name):
    monkeypatch.setattr("sys.stdin", io.StringIO(Path(poses).read_text()))

    status, report = report_of(capsys, name)

    off_m = math.sqrt((0.003**2 + 0.004**2) / 2)
    rmse = {quantity: spread["rmse"] for quantity, spread in report["groups"][-1]["errors"].items()}
    assert status == 0
    others = ("center_z_m", "center_m", "normal_rad", "radius_inner_m", "radius_outer_m", "grasp_m")
    assert rmse == pytest.approx({"center_x_m": 0.0, "center_y_m": 0.0} | dict.fromkeys(others, off_m), abs=1e-12)
    counted = [(each["group"], each["shots"], each["outcomes"]["missed"]) for each in report["groups"]]
    assert counted == [({"distance_m": 0.5}, 2, 0), ({"distance_m": 1.0}, 1, 1), ({}, 3, 1)]


def track_values(**changes) -> dict:
    """A track record whose pose is 3 mm off, with the keys that are compared."""
    line = PoseLine(shot="a", stamp_s=0.0, pose=pose_off_by(0.003))
    return pose_record(line) | {
        "schema": "ringpose/track/1", "validity": "valid", "fusion_status": "fused", "status": "ok",
        "measurement_stamp_s": 0.0, "camera": "inertial_assumed", **changes,
    }  # fmt: skip


def test_track_records_are_scored_by_their_shots_and_stamps(capsys):
    moving = truth_of(shot="a", stamp_s=10.0, velocity_m_s=np.array([0.0, 0.0, 0.1]), normal=pose_off_by(0.003).normal)
    write_truths("truth.jsonl", [moving])
    records = [track_values(stamp_s=10.03), track_values(stamp_s=10.5, shot=None, fusion_status="none")]
    Path("track.jsonl").write_text("".join(line_of(each) for each in records))

    status, report = report_of(capsys, "track.jsonl")

    assert status == 0
    expected_m = np.linalg.norm(-0.003 * NORMAL - np.array([0.0, 0.0, 0.003]))
    assert report["groups"][-1]["shots"] == 1
    assert report["groups"][-1]["errors"]["center_m"]["rmse"] == pytest.approx(expected_m, abs=1e-12)


def test_a_live_track_is_compared_with_the_truths_nearest_in_time(capsys):
    stamps_s = {"a": 10.0, "b": 10.1}
    write_truths("truth.jsonl", [truth_of(shot=shot, stamp_s=stamp_s) for shot, stamp_s in stamps_s.items()])
    records = [track_values(stamp_s=stamp_s, shot=str(stamp_s)) for stamp_s in (10.02, 10.04, 10.07, 10.12)]
    Path("track.jsonl").write_text("".join(line_of(each) for each in records))

    status, report = report_of(capsys, "track.jsonl")

    assert (status, report["matching"]["matched"]) == (0, 2)
    assert report["groups"][-1]["errors"]["center_m"]["rmse"] == pytest.approx(0.003, abs=1e-12)


@pytest.mark.parametrize(
    ("changes", "finding"),
    [({"stamp_s": 99.0, "shot": "live"}, "no truth"), ({"frame": "base"}, "base frame")],
    ids=["of another clock", "in the base frame"],
)
def test_a_track_without_a_truth_of_its_clock_and_frame_is_rejected(poses, capsys, changes, finding):
    Path("track.jsonl").write_text(line_of(track_values(**changes)))

    assert main(["bench", "track.jsonl", "--truth", "truth.jsonl"]) == 65
    assert finding in capsys.readouterr().err


def test_the_table_goes_to_standard_output(poses, capsys):
    status = main(["bench", poses, "--truth", "truth.jsonl"])

    streams = capsys.readouterr()
    assert (status, streams.err) == (0, "")
    assert streams.out.splitlines()[1].split()[:4] == ["method", "distance_m", "shots", "ok"]
    assert streams.out.splitlines()[4].split()[:4] == ["paper", "all", "3", "2"]


def test_a_line_without_a_truth_is_named(poses, capsys):
    write_poses(a=0.003, b=0.003, c=0.003, stranger=0.0)

    status = main(["bench", poses, "--truth", "truth.jsonl"])

    assert status == 65
    assert capsys.readouterr().err.startswith(
        "ringpose bench: poses.jsonl: 1 shots have a pose line but no truth in truth.jsonl (the first is stranger)"
    )


def test_a_bad_line_is_named_and_the_rest_is_scored(poses, capsys):
    with Path(poses).open("a") as stream:
        stream.write("{}\nnot json\n")

    status = main(["bench", poses, "--truth", "truth.jsonl", "--json", "-"])

    streams = capsys.readouterr()
    assert status == 65
    assert [line.split(": ")[1] for line in streams.err.splitlines()] == ["poses.jsonl:4", "poses.jsonl:5"]
    assert len(json.loads(streams.out)["shots"]) == 3


def test_shots_with_two_lines_are_one_message(poses, capsys):
    Path(poses).write_text(Path(poses).read_text() * 2)

    status = main(["bench", poses, "--truth", "truth.jsonl"])

    streams = capsys.readouterr()
    assert (status, len(streams.err.splitlines())) == (65, 1)
    assert "3 of 3 shots of the truth matched, 3 repeated" in streams.out
    assert "poses.jsonl: 3 shots have more than one pose line of one method" in streams.err


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (["--max-grasp-mm", "3.6"], 0, ""),
        (["--max-grasp-mm", "3.5"], 3, "grasp_m: RMSE 0.003536 of distance_m 0.5 (paper) exceeds 0.0035"),
        (["--max-normal-deg", "0.2"], 3, "normal_rad: RMSE 0.003536"),
        (["--max-center-mm", "1"], 3, "center_m: RMSE"),
        (["--max-radius-mm", "1"], 3, "radius_inner_m: RMSE"),
        (["--max-missed", "1", "--max-wrong", "0"], 0, ""),
        (["--max-missed", "0"], 3, "missed and lost: 1 shots of all shots (paper) exceed 0"),
    ],
)
def test_a_limit_that_is_missed_is_status_3(poses, capsys, words, status, complaint):
    ended = main(["bench", poses, "--truth", "truth.jsonl", *words])

    streams = capsys.readouterr()
    assert ended == status
    assert complaint in streams.err
    assert (streams.err == "") == (status == 0)


def test_groups_may_be_chosen(poses, capsys):
    write_truths("truth.jsonl", [truth_of(shot=s, groups={"ring": "R597", "light": s}) for s in "abc"])

    _, report = report_of(capsys, poses, "--by", "light,ring")

    assert report["groups"][0]["group"] == {"light": "a", "ring": "R597"}


def test_csv_has_a_row_a_shot(poses, capsys):
    main(["bench", poses, "--truth", "truth.jsonl", "--csv", "-"])

    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [(row["shot"], row["outcome"], row["distance_m"]) for row in rows] == [
        ("a", "ok", "0.5"),
        ("b", "ok", "0.5"),
        ("c", "missed", "1.0"),
    ]
    assert float(rows[1]["center_z_m"]) == pytest.approx(-0.004)
    assert rows[2]["center_z_m"] == ""


def test_a_report_has_its_provenance_and_is_replaced_only_with_force(poses, capsys):
    words = ["bench", poses, "--truth", "truth.jsonl", "--json", "report.json"]

    statuses = [main(words), main(words), main([*words, "--force"])]

    assert statuses == [0, 73, 0]
    provenance = json.loads(Path("report.json").read_text())["provenance"]
    assert sorted(provenance["inputs"]) == ["poses.jsonl", "truth.jsonl"]


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (["poses.jsonl", "--truth", "nowhere.jsonl"], 66, "nowhere.jsonl: does not exist"),
        (["poses.jsonl", "--truth", "truth.jsonl", "--rig", "nowhere.yaml"], 66, "nowhere.yaml: does not exist"),
        (["poses.jsonl"], 2, "is not a data set folder; give --truth FILE"),
        (["-"], 2, "is not a data set folder"),
        (["empty"], 66, "empty: is not a data set: it has no rig.yaml and no truth.jsonl and no shots"),
        (["poses.jsonl", "--truth", "truth.jsonl", "--json", "-", "--csv", "-"], 2, "both use standard output"),
        (["empty", "--method", "magic"], 2, "--method"),
        (["poses.jsonl", "--truth", "truth.jsonl", "--method", "paper"], 2, "have a method already"),
        (["poses.jsonl", "--truth", "truth.jsonl", "--by", "colour"], 2, 'no shot has a group "colour"'),
        (["none.jsonl", "--truth", "none.jsonl"], 65, "names no shot"),
        *(
            (["poses.jsonl", "--truth", "truth.jsonl", "--since", since], 2, since)
            for since in ("yesterday", "5 weeks", "2024-13-01")
        ),
    ],
)
def test_bad_usage_and_missing_files_give_one_line(poses, capsys, words, status, complaint):
    Path("empty").mkdir()
    Path("none.jsonl").touch()

    ended = main(["bench", *words])

    streams = capsys.readouterr()
    assert (ended, streams.out) == (status, "")
    assert len(streams.err.splitlines()) == 1
    assert complaint in streams.err


def write_stamped(**stamps_s: float) -> str:
    """A line without a pose for each shot, at these times."""
    lines = [PoseLine(shot=shot, stamp_s=stamp_s, pose=None, reason="none") for shot, stamp_s in stamps_s.items()]
    return write_lines("poses.jsonl", lines)


def test_only_shots_since_a_time_are_scored(capsys):
    write_truths("truth.jsonl", [truth_of(shot=shot) for shot in "abc"])
    write_stamped(a=1.70e9, b=1.71e9)
    words = ["bench", "poses.jsonl", "--truth", "truth.jsonl", "--since", "2024-01-01T00:00:00+00:00"]

    assert main([*words, "--json", "-"]) == 0

    assert [shot["shot"] for shot in json.loads(capsys.readouterr().out)["shots"]] == ["b"]


def test_cron_prints_only_if_a_limit_is_missed_or_there_is_no_shot(capsys):
    write_truths("truth.jsonl", [truth_of()])
    write_stamped(a=1.7e9)
    words = ["bench", "poses.jsonl", "--truth", "truth.jsonl", "--cron", "--max-missed"]

    assert main([*words, "1"]) == 0
    assert capsys.readouterr() == ("", "")
    assert main([*words, "0"]) == 3
    assert "missed" in capsys.readouterr().err
    assert main([*words, "1", "--since", "24h"]) == 3
    assert "no shot since 24h" in capsys.readouterr().err
