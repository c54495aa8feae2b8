"""One table decides the flags of a line; the manual has the same."""

import ast
import runpy
from pathlib import Path

import manual_tables
import pytest

import ringpose
from ringpose.bench.score import FLAGS_OF_QUANTITY
from ringpose.measure.status import QUANTITIES, RULES, SENTENCES, flags_of, sentences
from ringpose.types.finding import NOTHING, Finding
from ringpose.types.pose import HARMLESS_FLAGS, PoseFlag


def test_every_flag_has_one_row():
    assert [rule.flag for rule in RULES] == list(PoseFlag)


@pytest.mark.parametrize("finding", list(Finding), ids=lambda finding: finding.name)
def test_every_finding_sets_a_flag(finding):
    assert flags_of(finding)


def test_findings_together_set_the_flags_of_each():
    assert flags_of(~NOTHING) == PoseFlag(sum(PoseFlag))
    assert all(
        flags_of(first | second) == flags_of(first) | flags_of(second) for first in Finding for second in Finding
    )
    assert flags_of(NOTHING) == PoseFlag(0)


def test_what_is_not_serious_forbids_nothing_that_a_shot_could_show_to_be_wrong():
    for rule in RULES:
        assert rule.flag not in HARMLESS_FLAGS or not rule.forbids or rule.unless


def test_a_row_forbids_quantities_that_bench_judges():
    assert all(rule.forbids <= set(QUANTITIES) for rule in RULES)
    assert FLAGS_OF_QUANTITY["normal"] == (PoseFlag.NORMAL_WEAK | PoseFlag.INCONSISTENT | PoseFlag.ASSIGNMENT_AMBIGUOUS)


def test_sentences_name_the_laser_where_they_are_about_one():
    named = {"laser": "left", "edge": "inner", "fitting": "left, right", "given": "right, left", "change": "has moved"}
    named["spread"] = "2 mm"

    assert "laser left" in sentences(Finding.STRIPE_NOT_FOUND, laser="left")
    assert all("{" not in sentences(finding, **named) for finding in SENTENCES)


@pytest.mark.parametrize(("page", "name"), list(manual_tables.TABLES))
def test_the_manual_has_the_tables_of_the_code(page, name):
    text = (manual_tables.MAN / page).read_text()

    assert text == manual_tables.with_table(text, name, manual_tables.TABLES[page, name]()), "run make man-tables"


def test_no_other_module_decides_flags():
    structure = runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "structure.py"))
    package = Path(ringpose.__file__).parent
    sources = {path.relative_to(package): path.read_text() for path in package.rglob("*.py")}
    trees = {path: ast.parse(source) for path, source in sources.items() if "PoseFlag." in source}

    assert [str(path) for path, tree in trees.items() if structure["decides_flags"](tree)] == ["measure/status.py"]


@pytest.mark.parametrize(
    ("source", "decides"),
    [
        ("def f(line):\n    return line.flags | PoseFlag.MOTION", True),
        ("def f(line):\n    return replace(line, flags=PoseFlag.MOTION)", True),
        ("def f(line):\n    return PoseFlag.MOTION in line.flags", False),
        ("def f(line):\n    return bool(line.flags & PoseFlag.MOTION)", False),
        ("SUSPECT = PoseFlag.MOTION | PoseFlag.RING_FORM", False),
    ],
)
def test_a_flag_is_decided_where_it_is_set_and_not_where_it_is_asked_for(source, decides):
    structure = runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "structure.py"))

    assert structure["decides_flags"](ast.parse(source)) is decides
