"""`ringpose bench study`: results, resumption, and what is rejected."""

import json
import re
from pathlib import Path

import pytest
from filelock import SoftFileLock
from needed import needed_module

from ringpose.cli.main import main
from ringpose.files.studies.specification import preset_names, read_study, study_path

MANUAL = Path(__file__).parents[2] / "man" / "ringpose-bench.1"


@pytest.fixture
def folder(study_folder):
    """A working folder with a study of two cells by two methods."""
    return study_folder(light="dim", methods="[ml, paper]")


def test_a_study_prints_tables_and_writes_a_row_for_each_shot_and_method(folder, capsys, study_rows):
    assert main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1"]) == 0

    rows = study_rows("out")
    assert [(row["shot"], row["method"]) for row in rows] == [(str(i), m) for i in range(4) for m in ("ml", "paper")]
    assert "position error x (mm)" in capsys.readouterr().out
    about = json.loads((folder / "out" / "study.json").read_text())
    assert about["shots"] == 4
    assert len(about["study_sha256"]) == len(about["rig_sha256"]) == 64


@pytest.mark.slow
def test_parquet_has_the_same_rows_and_names_the_study(folder, study_rows):
    parquet = needed_module("pyarrow.parquet", "ringpose[report]")
    main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1"])

    table = parquet.read_table("out/results.parquet")

    expected = [float(row["center_m"]) for row in study_rows("out") if row["center_m"]]
    assert [value for value in table["center_m"].to_pylist() if value is not None] == expected
    assert json.loads(table.schema.metadata[b"ringpose"])["title"] == "small"


@pytest.mark.slow
def test_an_interrupted_study_resumes_to_the_same_results(folder, study_rows):
    main(["bench", "study", "study.yaml", "--output", "whole", "--jobs", "1"])
    main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1"])
    parts = folder / "out" / "parts"
    shots = {json.loads(line)["shot"]: line for part in parts.iterdir() for line in part.read_text().splitlines(True)}
    for part in parts.iterdir():
        part.unlink()
    (parts / "000000001-000000002-0-0.jsonl").write_text(shots[1] + shots[2])  # as if the rest had not been finished
    (parts / ".x.jsonl.abc.part").write_text("{")

    assert main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1"]) == 0

    assert study_rows("out") == study_rows("whole")


@pytest.mark.slow
def test_the_number_of_processes_does_not_change_the_results(folder, study_rows):
    for jobs in ("1", "3"):
        main(["bench", "study", "study.yaml", "--output", jobs, "--jobs", jobs, "--count", "8"])

    assert study_rows("1") == study_rows("3")


def test_results_of_another_study_are_not_continued(folder, capsys, study_rows):
    main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1", "--count", "1"])

    assert main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1"]) == 65
    assert "another study" in capsys.readouterr().err
    assert main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1", "--force"]) == 0
    assert len(study_rows("out")) == 8


@pytest.mark.slow
def test_results_of_another_version_are_not_continued(folder, capsys):
    main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1", "--count", "1"])
    about = folder / "out" / "study.json"
    about.write_text(json.dumps({**json.loads(about.read_text()), "code_sha256": "0"}))

    assert main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1", "--count", "1"]) == 65
    assert "version" in capsys.readouterr().err


def test_a_folder_in_use_is_reported_with_its_holder(folder, capsys):
    (folder / "out").mkdir()
    with SoftFileLock(folder / "out" / "results.lock"):
        assert main(["bench", "study", "study.yaml", "--output", "out"]) == 73

    assert "in use" in capsys.readouterr().err


def test_a_damaged_part_is_named(folder, capsys):
    main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1"])
    part = next((folder / "out" / "parts").iterdir())
    part.write_text(part.read_text()[:-20])

    assert main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1"]) == 65
    assert part.name in capsys.readouterr().err


def test_cron_prints_only_if_a_limit_is_missed(folder, capsys):
    text = (folder / "study.yaml").read_text()
    words = ["bench", "study", "study.yaml", "--jobs", "1", "--count", "1", "--cron", "--output"]

    (folder / "study.yaml").write_text(text + "limits: {max_center_m: 1, min_available_share: 0.1}\n")
    assert main([*words, "held"]) == 0
    assert capsys.readouterr() == ("", "")

    (folder / "study.yaml").write_text(text + "limits: {max_center_m: 0.0001}\n")
    assert main([*words, "missed"]) == 3
    printed = capsys.readouterr()
    assert "max_center_m" in printed.err
    assert "position error" in printed.out


@pytest.mark.slow
def test_two_results_of_one_study_are_compared(folder, capsys):
    words = ["bench", "study", "study.yaml", "--jobs", "1", "--output"]
    main([*words, "a"])
    main([*words, "b"])
    main([*words, "other", "--seed", "9"])
    capsys.readouterr()

    for first in ("a", "a/results.csv"):
        words = ["bench", "compare", first, "b", "--by", "distance_m"]
        assert main([*words, "--json", "c.json", "--force"]) == 0
        assert list(json.loads((folder / "c.json").read_text())["provenance"]["inputs"])[1] == "b/results.csv"
        assert "8 of 8" in (out := capsys.readouterr().out) or "4 of 4" in out
    assert main(["bench", "compare", "a", "other"]) == 65
    assert "another truth" in capsys.readouterr().err


@pytest.mark.slow
def test_a_table_that_is_cut_off_is_rejected(folder):
    main(["bench", "study", "study.yaml", "--output", "a", "--jobs", "1"])
    whole = (folder / "a" / "results.csv").read_bytes()
    (folder / "a" / "results.csv").write_bytes(whole[: len(whole) * 3 // 4])

    assert main(["bench", "compare", "a/results.csv", "a"]) == 65


@pytest.mark.slow
def test_the_worst_shots_are_written_as_a_data_set(folder):
    words = ["bench", "study", "study.yaml", "--output", "out", "--jobs", "1", "--keep", "worst:2"]
    assert main(words) == 0

    assert len(list((folder / "out" / "worst" / "detections").iterdir())) == 2
    assert len((folder / "out" / "worst" / "truth.jsonl").read_text().splitlines()) == 2


@pytest.mark.slow
def test_a_report_has_every_section_and_no_external_reference(folder):
    needed_module("matplotlib", "ringpose[report]")

    words = ["bench", "study", "study.yaml", "--output", "out", "--jobs", "1", "--count", "20", "--report", "page.html"]
    assert main(words) == 0

    page = (folder / "page.html").read_text()
    assert page.count("<img") == 6
    assert all(word in page for word in ("Set-up", "bounds", "consistency", "Integrity", "Failures", "Provenance"))
    assert "http://" not in page
    assert ">nan<" not in page


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("count: 2", "cuont: 2", "cuont"),
        ("level: features", "level: pictures", "pictures"),
        ("[0.3, 0.5]", "[-0.3, 0.5]", "distance_m"),
        ("[0.3, 0.5]", "{uniform: [0.5, 0.3]}", "uniform"),
        ("[0.3, 0.5]", "[]", "distance_m"),
        ("distance_m: [0.3, 0.5], ", "", "distance_m"),
        ("light: dim", "light: [dim, dusk]", "dusk"),
        ("[ml, paper]", "[ml, papr]", "papr"),
        ("light: dim", "light: dim, faults: end+nothing", "nothing"),
        ("light: dim", "light: {shares: {dim: 0.5, normal: 0.4}}", "vary.light.shares"),
        ("light: dim", "light: {shares: {dim: 1.0}, choice: [dim]}", "uniform, choice and shares"),
        ("light: dim", "light: {shares: {dim: 0.5, dusk: 0.5}}", "dusk"),
        ("[0.3, 0.5]", "{shares: {0.3: 1.0}}", "distance_m"),
        ("methods:", "occurrence: {end: 0.1}\nmethods:", "occurrence"),
        ("light: dim", "light: dim, missing_share: 1.5", "missing_share"),
        ("light: dim", "light: dim, ring_radius_outer_m: 0.02", "ring_radius_outer_m"),
        ("light: dim", "light: dim, sequence: 'off,9'", "sequence"),
        ("light: dim", "light: dim, wavelength: 1", "wavelength"),
        ("methods:", "limits: {max_center: 1}\nmethods:", "max_center"),
        ("methods:", "limits: {max_wrong: {turned: 1}}\nmethods:", "turned"),
        ("methods:", "table: hue\nmethods:", "hue"),
        ("level: features", "level: images\ncalibrate: 1", "calibrate"),
        ("level: features", "level: features\ncalibrate: true", "calibrate"),
        ("vary: {", "vary: {missing_share: 0.1, ", "features"),
        ("light: dim", "light: dim, target: moon", "moon"),
        ("light: dim", "light: dim, surfaces: clean", "level: images"),
        ("methods:", "surfaces: {rust: {colour: 1}}\nmethods:", "surfaces.rust"),
        ("methods:", "cases: {}\nmethods:", "cases"),
        ("methods:", "cases: {far: {distance_m: 2}}\nmethods:", "distance_m"),
        ("methods:", "cases: {dark: {light: [dim, normal]}}\nmethods:", "light"),
        ("methods:", "cases:\nmethods:", "cases"),
        ("methods:", "cases: {1: {}}\nmethods:", "cases"),
        ("methods:", "cases: {bright: {light: dim, stripe_dn: 200}}\nmethods:", "stripe_dn"),
        ("light: dim", "light: dim, stripe_dn: 1000", "saturate"),
        ("methods:", "assume: {ring_tolerance_m: 3}\nmethods:", "ring_tolerance_m"),
        ("methods:", "assume:\nmethods:", "assume"),
        ("methods:", "assume: {still: true, max_speed_m_s: 1}\nmethods:", "still"),
        ("[ml, paper]", "[ml, track]", "track"),
        ("methods:", "track: {shots: 3, period_s: 0.2}\nmethods:", "track"),
    ],
)
def test_a_bad_study_is_rejected_with_the_key_that_is_wrong(folder, capsys, old, new, word):
    text = (folder / "study.yaml").read_text().replace(old, new)
    (folder / "study.yaml").write_text(text.replace("level: features", "level: images") if word == "features" else text)

    assert main(["bench", "study", "study.yaml", "--output", "out"]) == 65

    assert word in capsys.readouterr().err
    assert not (folder / "out").exists()


def test_how_often_a_fault_occurs_is_stated_only_of_one_that_is_drawn(folder, capsys):
    text = (folder / "study.yaml").read_text().replace("light: dim", "light: dim, faults: {choice: [none, end]}")
    (folder / "study.yaml").write_text(text.replace("methods:", "table: faults\noccurrence: {ends: 0.1}\nmethods:"))

    assert main(["bench", "study", "study.yaml", "--output", "out"]) == 65

    assert "occurrence.ends: is not a fault of any shot" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "status", "named"),
    [
        (["paper-sinthetic"], 2, "paper-synthetic"),
        (["none.yaml"], 66, "none.yaml"),
        *((["study.yaml", "--keep", keep], 2, "--keep") for keep in ("best:2", "worst", "worst:0")),
        (["study.yaml", "--scheduler", "tcp://127.0.0.1:1", "--scheduler-file", "x.json"], 2, "--scheduler"),
    ],
)
def test_bad_usage_is_reported(folder, capsys, words, status, named):
    assert main(["bench", "study", *words, "--output", "out"]) == status
    assert named in capsys.readouterr().err


@pytest.mark.parametrize("name", preset_names())
def test_the_presets_are_valid(name):
    read = read_study(study_path(name))

    assert read.shots >= 150
    assert read_study(study_path(name), count=2).sha256 != read.sha256


def test_help_and_manual_name_every_preset(capsys):
    assert main(["bench", "study", "--help"]) == 0
    printed = set(re.findall(r"[\w-]+", capsys.readouterr().out))
    manual = set(re.findall(r"[\w-]+", MANUAL.read_text()))

    assert set(preset_names()) <= printed & manual


@pytest.mark.slow
def test_the_cases_of_a_study_are_stated_and_can_be_compared(folder, capsys):
    text = (folder / "study.yaml").read_text().replace("light: dim", "light: dim, plane_tilt_rad: 0, target: ring")
    cases = "cases: {none: {}, turned: {plane_tilt_rad: 0.01}, no ring: {target: body}}\nassume: {}\n"
    (folder / "study.yaml").write_text(text.replace("methods:", f"{cases}table: case\nmethods:"))

    assert main(["bench", "study", "study.yaml", "--output", "out", "--jobs", "1"]) == 0
    printed = capsys.readouterr().out
    assert "case turned: plane_tilt_rad 0.01" in printed
    assert "ring tolerance 0.1 mm" in printed
    assert "poses without a ring" in printed
    assert main(["bench", "compare", "out", "out"]) == 0
