"""`ringpose bench`: poses and truth -> tables of errors."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ringpose.cli.options import STDOUT, Force, JsonFile, OptionalRigFile, PoseFrame, Quiet, finite
from ringpose.types.options import Method

if TYPE_CHECKING:
    from ringpose.bench.pipeline import Matching
    from ringpose.bench.score import Answer, Score
    from ringpose.bench.summary import Summary
    from ringpose.cli.batch import Batch
    from ringpose.types.camera import Camera
    from ringpose.types.rig import Rig
    from ringpose.types.truth import Truth

DEFAULT_GROUPS = ("distance_m", "light")

PosesOrFolders = Annotated[
    list[str],
    typer.Argument(metavar="INPUT...", help="With --truth pose lines (- for stdin); without it data set folders."),
]
TruthFiles = Annotated[
    list[Path] | None,
    typer.Option("--truth", metavar="FILE", help="What is really there (truth.jsonl); may be given again."),
]
By = Annotated[
    str | None,
    typer.Option("--by", metavar="GROUPS", help="Groups of the truth, by commas; distance_m,light if not given."),
]
Methods = Annotated[
    list[Method] | None, typer.Option("--method", help="Of data sets, may be given again; all methods if not given.")
]
CsvFile = Annotated[str | None, typer.Option("--csv", metavar="FILE", help="A row a shot as CSV; - instead of tables.")]
MaxCenter = Annotated[
    float | None,
    typer.Option("--max-center-mm", metavar="MM", min=0, callback=finite, help="Limit on the centre's RMSE."),
]
MaxNormal = Annotated[
    float | None,
    typer.Option("--max-normal-deg", metavar="DEG", min=0, callback=finite, help="Limit on the normal's RMSE."),
]
MaxRadius = Annotated[
    float | None,
    typer.Option("--max-radius-mm", metavar="MM", min=0, callback=finite, help="Limit on the radii's RMSE."),
]
MaxGrasp = Annotated[
    float | None,
    typer.Option("--max-grasp-mm", metavar="MM", min=0, callback=finite, help="Limit on the grasp point's RMSE."),
]
MaxMissed = Annotated[
    int | None, typer.Option("--max-missed", metavar="N", min=0, help="Limit on shots missed or lost.")
]
MaxWrong = Annotated[int | None, typer.Option("--max-wrong", metavar="N", min=0, help="Limit on wrong quantities.")]


def bench(
    inputs: PosesOrFolders,
    truth: TruthFiles = None,
    rig: OptionalRigFile = None,
    by: By = None,
    method: Methods = None,
    json: JsonFile = None,
    csv: CsvFile = None,
    max_center_mm: MaxCenter = None,
    max_normal_deg: MaxNormal = None,
    max_radius_mm: MaxRadius = None,
    max_grasp_mm: MaxGrasp = None,
    max_missed: MaxMissed = None,
    max_wrong: MaxWrong = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Compare poses with the truth: errors by group, failures counted; status 3 if a limit is missed."""
    from ringpose.bench.thresholds import error_limits
    from ringpose.cli.batch import Batch
    from ringpose.errors import UsageError

    if json == csv == STDOUT:
        raise UsageError("", "--json - and --csv - both want standard output", "write one of them into a file")
    if truth and method:
        raise UsageError("--method", "pose lines have been computed already", "leave it out")
    batch = Batch()
    matched: Matching | None = None
    if truth:
        scores, matched = scores_of_lines(inputs, truth, rig, batch)
    else:
        scores = _scores_of_folders(inputs, rig, method or list(Method), batch, quiet)
        truth = [Path(folder) / "truth.jsonl" for folder in inputs]
    limits = error_limits(max_center_mm, max_normal_deg, max_radius_mm, max_grasp_mm)
    if not scores:
        batch.finish()
    names = group_names(scores, by)
    lines, missed = _judged(scores, names, limits, (max_missed, max_wrong), batch)
    targets = _Targets(json, csv, force, _files(inputs, truth, rig), [path for path in truth if path.is_file()])
    _write(targets, scores, lines, missed, names, matched)
    batch.finish()


class _Targets(NamedTuple):
    json: str | None
    csv: str | None
    force: bool
    inputs: list[Path]
    truths: list[Path]


def scores_of_lines(
    inputs: list[str], truth_files: list[Path], rig: Path | None, batch: "Batch"
) -> "tuple[list[Score], Matching]":
    """Pose lines against their truths; a rig beside a truth file gives the arc that the stripes span."""
    from ringpose.bench.pipeline import matching, scores
    from ringpose.errors import DataError

    sets = [(_truths(file), _camera(rig or file.with_name("rig.yaml"), rig is not None)) for file in truth_files]
    truths = [truth for of_set, _ in sets for truth in of_set]
    if twice := _first_repeated([truth.shot for truth in truths]):
        raise DataError(twice, "stands in two truth files", "give data sets whose shots have different names")
    answers = _answers_in(inputs, truths, batch)
    matched = matching(answers, truths)
    place, files = ", ".join(inputs), ", ".join(map(str, truth_files))
    if matched.without_truth:
        with batch.item():
            found = f"{len(matched.without_truth)} shots have a pose line but no truth in {files}"
            raise DataError(
                place, f"{found} (the first is {matched.without_truth[0]})", "give their truth with --truth"
            )
    if matched.repeated:
        with batch.item():
            found = f"{len(matched.repeated)} shots have more than one pose line of one method"
            raise DataError(
                place, f"{found} (the first is {matched.repeated[0]}); the last line counts", "bench each run alone"
            )
    return [each for of_set, camera in sets for each in scores(answers, of_set, camera)], matched


def _answers_in(inputs: list[str], truths: "list[Truth]", batch: "Batch") -> "list[Answer]":
    """The pose lines of the inputs; each line that cannot be compared is named on stderr."""
    from ringpose.bench.pose_errors import truth_at
    from ringpose.bench.score import answer_of
    from ringpose.errors import DataError
    from ringpose.files.inputs import RECORDS_SUFFIX, Record
    from ringpose.files.inputs import inputs as named
    from ringpose.files.poses import pose_line_of

    by_shot = {truth.shot: truth for truth in truths}
    answers = []
    for item in batch.good(named(inputs, (RECORDS_SUFFIX,))):
        with batch.item():
            if not isinstance(item, Record):
                raise DataError(str(item), "holds no pose lines", "give the .jsonl output of ringpose pose")
            answer = answer_of(pose_line_of(item.values, item.place), item.place)
            if answer.shot in by_shot:
                truth_at(by_shot[answer.shot], answer.stamp_s)  # refuses stamps of another clock
            answers.append(answer)
    return answers


def _first_repeated(names: list[str]) -> str | None:
    return next((name for name, count in Counter(names).items() if count > 1), None)


def _truths(file: Path) -> "list[Truth]":
    from ringpose.errors import DataError
    from ringpose.files.truths import read_truths

    truths = list(read_truths(file))
    if not truths:
        raise DataError(str(file), "names no shot")
    return truths


def _files(inputs: list[str], truths: list[Path], rig: Path | None) -> list[Path]:
    """The files whose hashes go into the report; of a data set its rig and truth."""
    named = [Path(name) for name in inputs if name != STDOUT]
    of_sets = [folder / "rig.yaml" for folder in named if folder.is_dir()]
    every = [*truths, rig, *named, *of_sets]
    return [path for path in every if path is not None and path.is_file()]


def _camera(rig: Path, wanted: bool) -> "Camera | None":
    """The camera of a rig file that the user names, or that is there."""
    from ringpose.files.rigs import read_rig

    return read_rig(rig).camera if wanted or rig.exists() else None


def _scores_of_folders(
    folders: list[str], rig: Path | None, methods: list[Method], batch: "Batch", quiet: bool
) -> "list[Score]":
    """Data sets, each detected and posed here by every method."""
    from ringpose.bench.pipeline import scores
    from ringpose.errors import UsageError
    from ringpose.files.rigs import read_rig

    found = []
    for folder in map(Path, folders):
        if str(folder) == STDOUT or folder.is_file():
            raise UsageError("", f"{folder} is no data set folder", "give --truth FILE to compare pose lines")
        with batch.item():
            of_shots = read_rig(rig or folder / "rig.yaml")
            truths = _truths(folder / "truth.jsonl")
            answers = list(_answers(folder / "shots", truths, of_shots, methods, batch, quiet))
            found += scores(answers, truths, of_shots.camera)
    return found


def _answers(
    shots: Path, truths: "list[Truth]", rig: "Rig", methods: list[Method], batch: "Batch", quiet: bool
) -> "Iterator[Answer]":
    from ringpose.bench.score import answer_of
    from ringpose.cli.progress import counted
    from ringpose.detect.pipeline import detect
    from ringpose.files.shots import read_shot
    from ringpose.pose.record import pose_line

    for truth in counted(truths, "shots", quiet):
        with batch.item():
            detection = detect(read_shot(shots / f"{truth.shot}.npz", rig=rig), rig)
            for method in methods:
                line = pose_line(detection, rig, method, PoseFrame.CAMERA)
                yield replace(answer_of(line, truth.shot), method=method.value)


def _judged(
    scores: "list[Score]",
    names: list[str],
    limits: dict[str, float],
    counts: tuple[int | None, int | None],
    batch: "Batch",
) -> "tuple[list[Summary], list[str]]":
    """The groups, and a sentence for each limit that they miss; counts are limits on missed shots, wrong quantities."""
    from ringpose.bench.summary import summaries
    from ringpose.bench.thresholds import missed_count_limits, missed_error_limits
    from ringpose.cli import messages
    from ringpose.errors import NO_POSE

    lines = summaries(scores, names)
    missed = [*missed_error_limits(lines, limits), *missed_count_limits(lines, *counts)]
    for sentence in missed:
        messages.say(sentence)
        batch.met(NO_POSE)
    return lines, missed


def group_names(scores: "list[Score]", by: str | None) -> list[str]:
    """The groups wished for; without a wish those of distance and light that there are."""
    from ringpose.bench.summary import unknown_groups
    from ringpose.errors import UsageError

    names = list(DEFAULT_GROUPS) if by is None else [name.strip() for name in by.split(",") if name.strip()]
    unknown = unknown_groups(scores, names)
    if by is not None and unknown:
        raise UsageError("--by", f'no shot has a group "{unknown[0]}"')
    return [name for name in names if name not in unknown]


def _write(
    targets: _Targets,
    scores: "list[Score]",
    lines: "list[Summary]",
    missed: list[str],
    names: list[str],
    matched: "Matching | None",
) -> None:
    from ringpose.bench.report import csv_rows, report
    from ringpose.bench.table import table
    from ringpose.files import records
    from ringpose.files.io import csv_text, write_result
    from ringpose.files.provenance import provenance, sha256

    if STDOUT not in (targets.json, targets.csv):
        records.write_text(table(lines, names, matched))
    if targets.json is not None:
        made = report(lines, scores, missed, matched, map(sha256, targets.truths))
        write_result(
            targets.json, records.line_of({**made, "provenance": provenance(targets.inputs)}), force=targets.force
        )
    if targets.csv is not None:
        write_result(targets.csv, csv_text(csv_rows(scores)), force=targets.force)
