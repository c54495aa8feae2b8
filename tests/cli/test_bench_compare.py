"""`ringpose bench compare`: exit statuses, the one line of no change, and what is refused."""

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from known_poses import CENTER_M, NORMAL, on_ring, pose_of, truth_of, write_lines, write_truths

from ringpose.cli.main import main
from ringpose.types.assumptions import Assumptions
from ringpose.types.pose import PoseFlag, PoseLine, Priors, RadiusPrior

SHOTS = 16
NO_FLAG = PoseFlag(0)


pytestmark = pytest.mark.usefixtures("empty_folder")


def write_truth(name: str = "truth.jsonl", **changes) -> None:
    write_truths(name, [truth_of(shot=f"s{n}", groups={"distance_m": n % 2}, **changes) for n in range(SHOTS)])


def line(shot: str, error_m: float = 0.0, method: str = "ml", rig: str = "r1", flags=NO_FLAG) -> PoseLine:
    """The true pose, but for its centre and grasp point, with standard deviations of 1 mm."""
    pose = pose_of(
        center_m=CENTER_M - error_m * NORMAL,
        grasp_m=on_ring(0.0, 0.45) - error_m * NORMAL,
        method=method,
        covariance=np.eye(7) * 1e-6,
        covariance_center_m2=np.eye(3) * 1e-6,
        covariance_grasp_m2=np.eye(3) * 1e-6,
        flags=flags,
    )
    return PoseLine(shot=shot, stamp_s=0.0, pose=pose, flags=flags, rig=rig, latency_s=0.01)


@pytest.fixture
def results(rng) -> dict[str, str]:
    """The true poses, errors whose NEES is 1, those grown by half, and those of another method."""
    write_truth()
    errors_m = 0.001 * np.sqrt(3) * rng.permutation(np.linspace(-1.6, 1.6, SHOTS))
    shots = [f"s{n}" for n in range(SHOTS)]
    return {
        "true": write_lines("true.jsonl", [line(shot) for shot in shots]),
        "a": write_lines("a.jsonl", [line(shot, e) for shot, e in zip(shots, errors_m, strict=True)]),
        "grown": write_lines("grown.jsonl", [line(shot, 1.5 * e) for shot, e in zip(shots, errors_m, strict=True)]),
        "other": write_lines("o.jsonl", [line(s, 2 * e, "paper") for s, e in zip(shots, errors_m, strict=True)]),
    }


TRUTH = ("--truth", "truth.jsonl")
ALL = (*TRUTH, "--by", "")


def test_the_truth_as_estimate_has_no_error_and_nothing_wrong(results, capsys):
    status = main(["bench", results["true"], *TRUTH, "--json", "-"])

    everything = json.loads(capsys.readouterr().out)["groups"][-1]
    assert status == 0
    assert max(spread["max"] for spread in everything["errors"].values()) < 1e-12
    assert max(everything["nees"].values()) < 1e-12
    assert everything["wrong"] == {"count": 0, "judged": 5 * SHOTS, "allowed": 0, "gross": 0, "none_wrong": True}
    assert (everything["available"], everything["targets"]) == (SHOTS, SHOTS)


def test_too_many_wrong_quantities_are_status_3(results, capsys):
    lines = [line(f"s{n}", 0.007, flags=PoseFlag.CENTER_WEAK if n else NO_FLAG) for n in range(SHOTS)]
    write_lines("off.jsonl", lines)

    statuses = [main(["bench", "off.jsonl", *TRUTH, "--max-wrong", limit]) for limit in (str(SHOTS + 1), str(SHOTS))]

    assert statuses == [0, 3]
    assert f"{SHOTS + 1} quantities" in capsys.readouterr().err


def test_the_same_run_twice_is_one_line_and_status_0(results, capsys):
    status = main(["bench", "compare", results["a"], results["a"], *TRUTH])

    streams = capsys.readouterr()
    assert (status, streams.err) == (0, "")
    assert streams.out.startswith(f"nothing changed: {SHOTS} shots, 13 quantities ({SHOTS} of {SHOTS} shots matched)")
    assert streams.out.count("\n") == 1


@pytest.mark.parametrize(("words", "status"), [(["--tolerance", "0.6"], 0), (["--tolerance", "0.4"], 3), ([], 3)])
def test_errors_half_as_large_again_are_named_with_status_3_unless_tolerated(results, capsys, words, status):
    assert main(["bench", "compare", results["a"], results["grown"], *ALL, *words]) == status

    streams = capsys.readouterr()
    assert any(row.split()[:3] == ["ml", "center", "mm"] and "worse" in row for row in streams.out.splitlines())
    assert ("worse: center_m of all shots (ml): " in streams.err) == ("+50.0%" in streams.err) == (status == 3)


def test_better_errors_are_status_0_and_another_rig_is_accepted_on_request(results, capsys, rig):
    write_lines("rig.jsonl", [line(f"s{n}", rig="r2") for n in range(SHOTS)])

    assert main(["bench", "compare", results["other"], results["a"], *ALL]) == 0
    assert "paper -> ml" in capsys.readouterr().out
    words = ["bench", "compare", results["true"], "rig.jsonl", *ALL, "--rig", str(rig)]
    assert main([*words, "--allow-other-rig"]) == 0
    assert main(words) == 65


@pytest.mark.parametrize(
    ("wrong", "without_pose", "status", "found"),
    [
        ((0, 1), (), 3, "newly wrong: 2: s0 center (ml); s0 grasp (ml)"),
        ((3, 4), (), 0, "newly wrong: 2: s3 center (ml); s3 grasp (ml)"),
        ((0, 0), (3,), 0, "newly without a pose: 1: s3 (ml)"),
    ],
    ids=["grossly wrong where none was wrong", "one more wrong among wrong ones", "without a pose"],
)
def test_quantities_and_poses_that_are_newly_wrong_or_missing_are_named(
    results, capsys, wrong, without_pose, status, found
):
    before, after = (
        [line(f"s{n}", 0.007 if n < count else 0.0) for n in range(SHOTS)] for count in wrong
    )  # the first shots are wrong
    after = [each if n not in without_pose else replace(each, pose=None, reason="x") for n, each in enumerate(after)]
    files = write_lines("before.jsonl", before), write_lines("after.jsonl", after)

    assert main(["bench", "compare", *files, *ALL, "--json", "c.json"]) == status

    streams = capsys.readouterr()
    assert found in streams.out
    assert (f"none wrong -> 2 of {5 * SHOTS} quantities wrong (ml)" in streams.err) == (status == 3)
    assert json.loads(Path("c.json").read_text())["no_longer_correct"] == (["ml"] if status else [])


def test_tables_and_compressed_records_give_the_same_rows_as_records(results, capsys):
    for name in ("a", "grown"):
        main(["bench", results[name], *TRUTH, "--json", f"{name}.json", "--by", ""])
    Path("a.jsonl.gz").write_bytes(gzip.compress(Path("a.jsonl").read_bytes()))
    capsys.readouterr()

    rows = []
    for words in (
        ["a.jsonl", "grown.jsonl", *ALL],
        ["a.json", "grown.json", "--by", ""],
        ["a.jsonl.gz", "grown.json", *ALL],
    ):
        assert main(["bench", "compare", *words, "--json", "-"]) == 3
        rows.append(json.loads(capsys.readouterr().out)["rows"])

    assert rows[0] == rows[1] == rows[2]


def test_a_shot_that_b_lost_is_named_and_status_3(results, capsys):
    lines = Path(results["a"]).read_text().splitlines(keepends=True)
    Path("short.jsonl").write_text("".join(lines[:-1]))

    status = main(["bench", "compare", results["a"], "short.jsonl", *TRUTH])

    streams = capsys.readouterr()
    assert status == 3
    assert f"{SHOTS - 1} of {SHOTS} shots matched" in streams.out
    assert "short.jsonl: 1 shots have no line" in streams.err
    assert f"s{SHOTS - 1}" in streams.err


def test_two_truth_files_stand_for_the_shots_of_both(results, capsys):
    lines = Path("truth.jsonl").read_text().splitlines(keepends=True)
    Path("one.jsonl").write_text("".join(lines[:10]))
    Path("two.jsonl").write_text("".join(lines[10:]))

    status = main(["bench", "compare", results["a"], results["a"], "--truth", "one.jsonl", "--truth", "two.jsonl"])

    assert (status, f"{SHOTS} of {SHOTS} shots matched" in capsys.readouterr().out) == (0, True)


def test_one_method_of_a_table_is_compared_with_another(results, capsys):
    both = Path(results["a"]).read_text() + Path(results["other"]).read_text()
    Path("both.jsonl").write_text(both)

    status = main(["bench", "compare", "both.jsonl", "both.jsonl", *ALL, "--methods", "ml,paper"])

    assert status == 3
    assert "ml -> paper" in capsys.readouterr().out


@pytest.fixture(scope="module")
def refused(tmp_path_factory) -> Path:
    """A folder with results that cannot be compared."""
    folder = tmp_path_factory.mktemp("refused")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write_truth()
        write_truth("elsewhere.jsonl", radius_inner_m=0.41)
        write_lines("a.jsonl", [line(f"s{n}") for n in range(SHOTS)])
        write_lines("rig.jsonl", [line(f"s{n}", rig="r2") for n in range(SHOTS)])
        for name in ("truth", "elsewhere"):
            main(["bench", "a.jsonl", "--truth", f"{name}.jsonl", "--json", f"{name}.json", "--by", ""])
        moving = '"motion":{"speed_sd_m_s":0.05,"rate_sd_rad_s":0.09}'
        Path("moving.json").write_text(Path("truth.json").read_text().replace('"motion":"still"', moving))
        tolerant = Priors(assumptions=Assumptions(ring_tolerance_m=1e-4))
        write_lines(
            "tolerant.jsonl", [replace(line(f"s{n}"), priors=tolerant if n > 3 else None) for n in range(SHOTS)]
        )
        known = RadiusPrior(inner_m=0.4, outer_m=0.5, inner_sd_m=5e-4, outer_sd_m=5e-4, source="given")
        write_lines("known.jsonl", [replace(line(f"s{n}"), priors=Priors(radius=known)) for n in range(SHOTS)])
        main(["bench", "known.jsonl", *TRUTH, "--json", "known.json", "--by", ""])
        Path("record.json").write_text(Path("truth.jsonl").read_text().splitlines()[0])
        Path("none.jsonl").write_text("")
        Path("broken.jsonl.gz").write_bytes(gzip.compress(Path("a.jsonl").read_bytes())[:30])
    return folder


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (["a.jsonl", "rig.jsonl"], 2, "--truth"),
        (["-", "-", *TRUTH], 2, "standard input"),
        (["a.jsonl", "nowhere.json", *TRUTH], 66, "nowhere.json"),
        (["a.jsonl", "record.json", *TRUTH], 65, "record.json"),
        (["truth.json", "elsewhere.json"], 65, "another truth"),
        (["truth.json", "moving.json"], 65, "other assumptions"),
        (["a.jsonl", "moving.json", *TRUTH], 65, "speed 0.05 m/s"),
        (["a.jsonl", "tolerant.jsonl", *TRUTH], 65, f"other assumptions than a.jsonl in {SHOTS - 4} shots"),
        (["a.jsonl", "known.jsonl", *TRUTH], 65, "radii 400/500 mm"),
        (["truth.json", "known.json"], 65, "radii 400/500 mm"),
        (["a.jsonl", "rig.jsonl", *TRUTH], 65, "another rig"),
        (["a.jsonl", "a.jsonl", *TRUTH, "--methods", "ml"], 2, "--methods"),
        (["a.jsonl", "a.jsonl", *TRUTH, "--methods", "ml,magic"], 2, "magic"),
        (["a.jsonl", "a.jsonl", *TRUTH, *TRUTH], 65, "two truth files"),
        (["a.jsonl", "none.jsonl", *TRUTH], 65, "none.jsonl"),
        (["a.jsonl", "broken.jsonl.gz", *TRUTH], 65, "broken.jsonl.gz"),
        (["truth.json", "truth.json", "--by", "colour"], 2, "colour"),
    ],
)
def test_what_cannot_be_compared_is_named(refused, monkeypatch, capsys, words, status, complaint):
    monkeypatch.chdir(refused)

    ended = main(["bench", "compare", *words])

    streams = capsys.readouterr()
    assert (ended, streams.out) == (status, "")
    assert complaint in streams.err


def test_records_of_both_versions_under_the_same_assumptions_are_compared(results, capsys):
    still = [replace(line(f"s{n}"), priors=Priors()) for n in range(SHOTS)]
    records = [json.loads(each) for each in Path(results["true"]).read_text().splitlines()]
    for record in records:
        record |= {"schema": "ringpose/pose/1", "laser_health": {}, "dropped": 0}
    Path("one.jsonl").write_text("".join(json.dumps(record) + "\n" for record in records))

    assert main(["bench", "compare", "one.jsonl", write_lines("two.jsonl", still), *TRUTH]) == 0
    assert "nothing changed" in capsys.readouterr().out


def test_a_table_of_the_version_before_is_compared_as_one_of_a_still_ring(results, capsys):
    main(["bench", results["a"], *TRUTH, "--json", "a.json", "--by", ""])
    values = json.loads(Path("a.json").read_text())
    assumed = {"still": True, "ring_tolerance_m": 0.0, "rig_stability": 0.0}
    for shot in values["shots"]:
        del shot["assumptions"]
    Path("before.json").write_text(json.dumps(values | {"ringpose": "bench/2", "assumptions": assumed}))

    assert main(["bench", "compare", "before.json", results["a"], *TRUTH]) == 0


def test_tables_state_the_assumptions(results, capsys):
    lines = [
        replace(line(f"s{n}"), priors=Priors(assumptions=Assumptions(ring_tolerance_m=1e-4 if n else 0.0)))
        for n in range(SHOTS)
    ]

    main(["bench", write_lines("mixed.jsonl", lines), *TRUTH, "--json", "mixed.json"])

    stated = [row for row in capsys.readouterr().out.splitlines() if row.startswith("assumptions: still target")]
    assert [row.split("ring tolerance ")[1] for row in stated] == [
        "0 mm, stable rig (1 shots)",
        f"0.1 mm, stable rig ({SHOTS - 1} shots)",
    ]
    table = json.loads(Path("mixed.json").read_text())
    assert [(each["motion"], each["shots"]) for each in table["assumptions"]] == [("still", 1), ("still", SHOTS - 1)]


@pytest.mark.parametrize("matrix", ["full", "center", "grasp"])
def test_a_null_inside_a_covariance_is_one_line_and_the_rest_is_scored(results, capsys, matrix):
    records = [json.loads(each) for each in Path(results["a"]).read_text().splitlines()]
    records[3]["pose"]["covariance"][matrix][0][1] = None
    Path("null.jsonl").write_text("".join(json.dumps(record) + "\n" for record in records))

    status = main(["bench", "null.jsonl", *TRUTH])

    streams = capsys.readouterr()
    assert (status, len(streams.err.splitlines())) == (65, 1)
    assert f"null.jsonl:4: pose.covariance.{matrix}" in streams.err
    assert f"{SHOTS - 1} of {SHOTS} shots of the truth matched" in streams.out
