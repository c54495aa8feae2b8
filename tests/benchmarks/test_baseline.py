"""The frozen poses are whole, and every rendered shot is among them."""

import gzip
import json
import runpy
from pathlib import Path

import pytest

from ringpose.cli.main import main

BENCHMARK = runpy.run_path(str(Path(__file__).parent / "compare_baseline.py"))
FILES = [(group, method) for group in BENCHMARK["SETS"] for method in BENCHMARK["METHODS"]]


@pytest.mark.parametrize(("group", "method"), FILES)
def test_the_baseline_has_a_record_for_each_rendered_shot_and_no_time(shared_data, group, method):
    text = gzip.decompress((BENCHMARK["BASELINE"] / f"{group}.{method}.jsonl.gz").read_bytes()).decode()
    records = [json.loads(line) for line in text.splitlines()]
    truths = [
        json.loads(line)["shot"]
        for name in BENCHMARK["SETS"][group]
        for line in (shared_data / "rendered" / name / "truth.jsonl").read_text().splitlines()
    ]

    assert sorted(record["shot"] for record in records) == sorted(truths)
    assert {record["latency_s"] for record in records} == {None}
    assert {record["pose"]["method"] for record in records if record["pose"]} == {method}


def test_the_baseline_beside_itself_has_not_changed(shared_data, capsys):
    baseline = str(BENCHMARK["BASELINE"] / "still.ml.jsonl.gz")
    truths = [
        word
        for name in BENCHMARK["SETS"]["still"]
        for word in ("--truth", str(shared_data / "rendered" / name / "truth.jsonl"))
    ]

    status = main(["bench", "compare", baseline, baseline, *truths])

    streams = capsys.readouterr()
    assert (status, streams.err) == (0, "")
    assert streams.out.startswith("nothing changed: 45 shots")
