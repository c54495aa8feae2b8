"""`ringpose bench compare`: compare two results on the same shots."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from ringpose.cli.app import STDOUT, Force, JsonFile, file_option, number_option
from ringpose.cli.batch import Batch
from ringpose.cli.bench.score import By, TruthFiles, group_names, report_missed, scores_of_lines
from ringpose.errors import DataError, NoInputError, UsageError

if TYPE_CHECKING:
    from ringpose.bench.compare import Pair
    from ringpose.bench.score import Score


def compare(
    a: Annotated[
        str,
        typer.Argument(
            metavar="A", help="The older result: pose records, with --truth, a table of bench --json, or a study's."
        ),
    ],
    b: Annotated[str, typer.Argument(metavar="B", help="The newer result, of the same shots.")],
    truth: TruthFiles = None,
    rig: Annotated[
        Path | None, file_option("--rig", meaning="The rig of the pose lines, for the arc that the stripes span.")
    ] = None,
    by: By = None,
    methods: Annotated[
        str | None,
        typer.Option(
            "--methods", metavar="A,B", help="Compare this method of A with that of B, where they have several."
        ),
    ] = None,
    tolerance: Annotated[
        float, number_option("--tolerance", "SHARE", "Differences up to this do not count as failure.", 0)
    ] = 0.02,
    allow_other_rig: Annotated[
        bool, typer.Option("--allow-other-rig", help="Compare poses that were computed with two rigs.")
    ] = False,
    json: JsonFile = None,
    force: Force = False,
) -> None:
    """Compare two results shot by shot: better, worse or cannot tell; status 3 if something is worse."""
    from ringpose.bench.compare import compare as rows_of
    from ringpose.bench.compare import pairs
    from ringpose.bench.compare_report import comparison_record, comparison_text, worse_sentences
    from ringpose.files import records
    from ringpose.files.io import provenance, write_result

    if a == b == STDOUT:
        raise UsageError("", "both results are read from standard input", "write one of them into a file")
    batch = Batch()
    result_a, result_b = (_read(name, truth, rig, batch, any_rig=allow_other_rig) for name in (a, b))
    if result_a.truths and result_b.truths and result_a.truths != result_b.truths:
        raise DataError(b, f"was scored against another truth than {a}", "score both against one truth")
    paired = pairs(*_of_methods(result_a, result_b, methods))
    _require_pairs(result_a, result_b, paired, allow_other_rig)
    names = group_names(result_a.scores, by)
    rows = rows_of(paired, names, tolerance)
    matched = _matched(result_a, result_b)
    words = f"{matched['both']} of {matched['shots']} shots matched"
    if json != STDOUT:
        records.write_text(comparison_text(rows, paired, names, tolerance, words))
    if json is not None:
        named = [Path(name) for name in (a, b) if name != STDOUT]
        tables = [each / "results.csv" if each.is_dir() else each for each in named]  # of studies
        files = [*tables, *(truth or []), *([rig] if rig else [])]
        made = comparison_record(rows, paired, tolerance, matched)
        write_result(json, records.line_of({**made, "provenance": provenance(files)}), force=force)
    complaints = list(worse_sentences(rows, paired))
    if lost := matched["only_a"]:
        complaints.append(f"{b}: {len(lost)} shots have no line that have one in {a} (the first is {lost[0]})")
    report_missed(complaints, batch)
    batch.finish()


class _Result(NamedTuple):
    name: str
    scores: "list[Score]"
    truths: list[str]
    """SHA-256 of the truth files."""


def _read(name: str, truths: list[Path] | None, rig: Path | None, batch: Batch, *, any_rig: bool) -> _Result:
    """Scores computed from pose records, or read from a report of `bench --json` or from the results of a study.

    `any_rig`: whether the records may be of another rig than `rig`.
    """
    from ringpose.bench.report import recorded_scores
    from ringpose.bench.study.table import scores_of
    from ringpose.files.inputs import holds_records
    from ringpose.files.io import read_bytes, sha256
    from ringpose.files.records import parsed_record
    from ringpose.files.schema import Fields
    from ringpose.files.studies.results import holds_results, read_results

    if name != STDOUT and not Path(name).exists():
        raise NoInputError(name, "does not exist", "give the records of ringpose pose, a table or a study's folder")
    if name != STDOUT and holds_results(Path(name)):
        metadata, rows = read_results(Path(name))
        about = Fields(name, metadata)
        # the same study has the same shots, so that its hash stands for the truth
        return _Result(name, scores_of(rows, about.texts("factors")), [about.text("study_sha256")])
    if name != STDOUT and not holds_records(Path(name)):
        fields = Fields(name, parsed_record(read_bytes(Path(name)), name))
        return _Result(name, recorded_scores(fields), list(fields.texts("truths")))
    if not truths:
        raise UsageError("", f"{name} holds pose records, which need a truth", "give --truth FILE")
    scores, _ = scores_of_lines([name], truths, rig, batch, any_rig=any_rig)
    if all(score.status == "lost" for score in scores):
        raise DataError(name, "has no pose line of a shot of the truth", "give poses of the same data set")
    return _Result(name, scores, sorted(map(sha256, truths)))


def _of_methods(a: _Result, b: _Result, methods: str | None) -> "tuple[list[Score], list[Score]]":
    """The scores to compare: all scores, or those of one chosen method of each result."""
    if methods is None:
        return a.scores, b.scores
    words = [word.strip() for word in methods.split(",")]
    if len(words) != 2:
        raise UsageError("--methods", f"{methods!r} is not two methods", "such as paper-constrained,ml")
    chosen = []
    for result, method in zip((a, b), words, strict=True):
        chosen.append([score for score in result.scores if score.method == method])
        if not chosen[-1]:
            known = ", ".join(sorted({score.method for score in result.scores}))
            raise UsageError("--methods", f"{result.name} has no method {method!r}", f"it has {known}")
    return chosen[0], chosen[1]


def _require_pairs(
    a: _Result, b: _Result, paired: "Sequence[tuple[str, Sequence[Pair]]]", allow_other_rig: bool
) -> None:
    """Reject results that have no shot in common, or whose poses differ in more than the shots."""
    from ringpose.bench.assumptions import assumptions_text

    members = [pair for _, of_method in paired for pair in of_method]
    if not members:
        raise DataError(b.name, f"has no shot and method in common with {a.name}", "give results of the same shots")
    stated = [pair for pair in members if None not in (pair[0].assumptions, pair[1].assumptions)]
    differing = [(one, two) for one, two in stated if one.assumptions != two.assumptions]
    if differing:
        one, two = differing[0]
        texts = [assumptions_text(score.assumptions) for score in (one, two) if score.assumptions is not None]
        finding = f"was computed under other assumptions than {a.name} in {len(differing)} shots"
        first = f"(the first is {one.shot}: {texts[1]}; {a.name}: {texts[0]})"
        raise DataError(b.name, f"{finding} {first}", "compute both under the same")
    other = [one.shot for one, two in members if one.rig and two.rig and one.rig != two.rig]
    if other and not allow_other_rig:
        finding = f"was computed with another rig than {a.name} in {len(other)} shots (the first is {other[0]})"
        raise DataError(b.name, finding, "use one rig.yaml, or --allow-other-rig to compare rigs")


def _matched(a: _Result, b: _Result) -> dict[str, Any]:
    """The number of shots of the truth, and the shots for which both results, only A, or only B have a record."""
    lines_a, lines_b = ({score.shot for score in result.scores if score.status != "lost"} for result in (a, b))
    shots = dict.fromkeys(score.shot for score in (*a.scores, *b.scores))
    return {
        "shots": len(shots),
        "both": len(lines_a & lines_b),
        "only_a": [shot for shot in shots if shot in lines_a - lines_b],
        "only_b": [shot for shot in shots if shot in lines_b - lines_a],
    }
