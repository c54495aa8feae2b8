"""`ringpose bench`: compare poses with the truth and print tables of errors."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from ringpose.cli import messages
from ringpose.cli.app import (
    LIMITS,
    STDOUT,
    CsvFile,
    Force,
    JsonFile,
    Quiet,
    file_option,
    number_option,
    with_option_groups,
)
from ringpose.cli.batch import Batch, with_progress
from ringpose.errors import NO_POSE, DataError, NoInputError, UsageError
from ringpose.types.options import Method

if TYPE_CHECKING:
    from ringpose.bench.score import Matching, PoseEstimate, Score
    from ringpose.bench.summary import Summary
    from ringpose.measure.stream import Stream
    from ringpose.types.detection import Detection
    from ringpose.types.image import Shot
    from ringpose.types.truth import Truth

DEFAULT_GROUPS = ("distance_m", "light")

TruthFiles = Annotated[
    list[Path] | None,
    typer.Option("--truth", metavar="FILE", help="Ground truth (truth.jsonl); may be given again."),
]
OptionalRig = Annotated[
    Path | None,
    file_option("--rig", meaning="The rig of the pose lines; with data sets: measure with this rig instead."),
]
By = Annotated[
    str | None,
    typer.Option(
        "--by",
        metavar="GROUPS",
        help="Groups of the truth with a line each, separated by commas; default: distance_m,light.",
    ),
]


Cron = Annotated[bool, typer.Option("--cron", help="Print nothing unless a limit is missed.")]


def _error_limit(name: str, metavar: str, quantity: str) -> Any:
    return number_option(name, metavar, f"Limit on the {quantity} RMSE.", 0)


def _count_limit(name: str, counted: str) -> Any:
    return typer.Option(name, metavar="N", min=0, help=f"Limit on {counted}.")


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits on errors and counts, as given; None for no limit."""

    PURPOSE: ClassVar = LIMITS

    max_center_mm: Annotated[float | None, _error_limit("--max-center-mm", "MM", "centre's")] = None
    max_normal_deg: Annotated[float | None, _error_limit("--max-normal-deg", "DEG", "normal's")] = None
    max_radius_mm: Annotated[float | None, _error_limit("--max-radius-mm", "MM", "radii's")] = None
    max_grasp_mm: Annotated[float | None, _error_limit("--max-grasp-mm", "MM", "grasp point's")] = None
    max_missed: Annotated[int | None, _count_limit("--max-missed", "shots missed or lost")] = None
    max_wrong: Annotated[int | None, _count_limit("--max-wrong", "wrong quantities")] = None

    def missed(self, lines: "Sequence[Summary]") -> list[str]:
        """A message for each limit that is missed."""
        from ringpose.bench.summary import exceeded_count_limits, exceeded_error_limits

        limits = {
            "center_m": self.max_center_mm and 1e-3 * self.max_center_mm,
            "normal_rad": self.max_normal_deg and radians(self.max_normal_deg),
            "radius_inner_m": self.max_radius_mm and 1e-3 * self.max_radius_mm,
            "radius_outer_m": self.max_radius_mm and 1e-3 * self.max_radius_mm,
            "grasp_m": self.max_grasp_mm and 1e-3 * self.max_grasp_mm,
        }
        return [*exceeded_error_limits(lines, limits), *exceeded_count_limits(lines, self.max_missed, self.max_wrong)]


@with_option_groups
def bench(
    *,
    inputs: Annotated[
        list[str],
        typer.Argument(metavar="INPUT...", help="Pose lines (- for stdin) if --truth is given, else data set folders."),
    ],
    truth: TruthFiles = None,
    rig: OptionalRig = None,
    by: By = None,
    method: Annotated[
        list[Method] | None, typer.Option("--method", help="Method for data sets; may be given again; default: all.")
    ] = None,
    json: JsonFile = None,
    csv: CsvFile = None,
    limits: Limits,
    since: Annotated[
        str | None,
        typer.Option("--since", metavar="TIME", help="Only shots since this time, or of this age (24h, 7d)."),
    ] = None,
    cron: Cron = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Compare poses with the truth: errors by group, failures counted; status 3 if a limit is missed.

    Further commands, each with its own --help: bench compare, bench study, bench design, bench capture.
    """
    from ringpose.bench.integrity import verdicts_text
    from ringpose.bench.report import report, score_table
    from ringpose.bench.summary import summaries
    from ringpose.bench.table import table
    from ringpose.files import records
    from ringpose.files.io import csv_text, provenance, sha256, write_result
    from ringpose.report.stripes import stripes_shown

    if json == csv == STDOUT:
        raise UsageError("", "--json - and --csv - both use standard output", "write one of them into a file")
    if truth and method:
        raise UsageError("--method", "pose lines have a method already", "omit it")
    batch, since_s = Batch(), -inf if since is None else _since_s(since)
    matched: Matching | None = None
    with batch:
        if truth:
            scores, matched = scores_of_lines(inputs, truth, rig, batch, since_s)
        else:
            scores = _scores_of_folders(inputs, rig, method or list(Method), batch, quiet or cron, since_s)
            truth = [Path(folder) / "truth.jsonl" for folder in inputs]
    if not scores:
        report_missed([] if since is None else [f"{', '.join(inputs)}: no shot since {since}"], batch)
        batch.finish()
    names = group_names(scores, by)
    lines = summaries(scores, names)
    missed = limits.missed(lines)
    report_missed(missed, batch)
    if STDOUT not in (json, csv) and (missed or not cron):
        shown = [stripes_shown(_truths(file), _laser_names(rig or file.with_name("rig.yaml"))) for file in truth]
        tables = table(lines, names, matched, [score.assumptions for score in scores])
        verdicts = verdicts_text(scores)
        records.write_text("\n".join(filter(None, [tables, verdicts, *shown])) + "\n" * any(shown))
    if json is not None:
        named = [Path(name) for name in inputs if name != STDOUT]
        files = [*truth, *([rig] if rig else []), *named, *(folder / "rig.yaml" for folder in named)]
        hashes, origin = map(sha256, filter(Path.is_file, truth)), provenance(list(filter(Path.is_file, files)))
        made = report(lines, scores, missed, matched, hashes, origin)
        write_result(json, records.line_of(made), force=force)
    if csv is not None:
        write_result(csv, csv_text(score_table(scores)), force=force)
    batch.finish()


def _laser_names(rig: Path) -> tuple[str, ...]:
    """The names of the lasers in a rig file; none without the file."""
    from ringpose.files.rigs import read_rig

    return read_rig(rig).lasers.names if rig.exists() else ()


def report_missed(sentences: Iterable[str], batch: Batch) -> None:
    """Report missed limits on stderr, one line each; they are status 3."""
    for sentence in sentences:
        messages.echo(sentence)
        batch.record_status(NO_POSE)


def _since_s(text: str) -> float:
    """The time of --since, in seconds since the epoch."""
    import re
    import time
    from datetime import datetime

    age = re.fullmatch(r"(\d{1,9})(s|min|h|d)", text)
    if age is not None:
        return time.time() - float(age[1]) * {"s": 1, "min": 60, "h": 3600, "d": 86400}[age[2]]
    try:
        return datetime.fromisoformat(text).timestamp()
    except ValueError:
        finding = f"{text!r} is neither a time nor an age"
        raise UsageError("--since", finding, "such as 2026-11-23T06:00, 90min, 24h or 7d") from None


def scores_of_lines(
    inputs: list[str],
    truth_files: list[Path],
    rig: Path | None,
    batch: Batch,
    since_s: float = -inf,
    any_rig: bool = False,
) -> "tuple[list[Score], Matching]":
    """Scores of pose records; `rig`, or the rig.yaml in the folder of a truth file, gives the camera for the arc.

    Records of another rig than `rig` are rejected, unless `any_rig` is set.
    Shots before `since_s`, and shots of the truth whose time is not known, are left out. There are no scores if no
    record could be compared, for reasons that have been reported.
    """
    from ringpose.bench.score import matching, scores
    from ringpose.files.rigs import read_rig

    given = None if rig is None else read_rig(rig)
    sets = []
    for file in truth_files:
        own = file.with_name("rig.yaml")
        known = given or (read_rig(own) if own.exists() else None)
        sets.append((_truths(file), None if known is None else known.camera))
    truths = [truth for of_set, _ in sets for truth in of_set]
    names = Counter(truth.shot for truth in truths)
    if twice := [name for name, count in names.items() if count > 1]:
        raise DataError(twice[0], "stands in two truth files", "give data sets whose shots have different names")
    estimates = _estimates_in(inputs, truths, "" if given is None or any_rig else given.sha256, batch)
    if since_s > -inf:
        estimates = [estimate for estimate in estimates if estimate.line.stamp_s >= since_s]
        recent = {estimate.shot for estimate in estimates}
        recent |= {truth.shot for truth in truths if (truth.stamp_s or -inf) >= since_s}
        sets = [([truth for truth in of_set if truth.shot in recent], camera) for of_set, camera in sets]
        truths = [truth for of_set, _ in sets for truth in of_set]
    matched = matching(estimates, truths)
    no_truth = f"have a pose line but no truth in {', '.join(map(str, truth_files))}"
    for shots, what, remedy in (
        (matched.without_truth, no_truth, "give their truth with --truth"),
        (matched.repeated, "have more than one pose line of one method, the last counts", "bench each run alone"),
    ):
        with batch.guarded():
            if shots:
                finding = f"{len(shots)} shots {what} (the first is {shots[0]})"
                raise DataError(", ".join(inputs), finding, remedy)
    if not matched.matched and batch.status:
        return [], matched
    return [score for of_set, camera in sets for score in scores(estimates, of_set, camera)], matched


def _estimates_in(inputs: list[str], truths: "list[Truth]", rig: str, batch: Batch) -> "list[PoseEstimate]":
    """The pose or track records of the inputs; those that cannot be compared are reported on stderr.

    Records of another rig than that of the SHA-256 `rig` are rejected, unless it is empty.

    Track records of instants between measurements have no shot, and are not compared. Track records whose shot the
    truth does not name, as with a live camera, are compared with the truth that is nearest in time.
    """
    from ringpose.bench.score import estimate_of, named_by_stamp
    from ringpose.estimate.pose_errors import truth_at
    from ringpose.files.inputs import RECORDS_SUFFIX, Record
    from ringpose.files.inputs import inputs as named
    from ringpose.files.records import tracks
    from ringpose.files.records.poses import pose_line_of, recorded_status
    from ringpose.types.rig import reject_other_rig

    by_shot = {truth.shot: truth for truth in truths}
    estimates, unnamed = [], []
    for item in batch.valid_inputs(named(inputs, (RECORDS_SUFFIX,))):
        with batch.guarded():
            if not isinstance(item, Record):
                raise DataError(str(item), "holds no pose lines", "give the .jsonl output of ringpose pose or track")
            tracked = item.values.get("schema") == tracks.RECORD.version
            line = (tracks.pose_line_of_track if tracked else pose_line_of)(item.values, item.location)
            if tracked and item.values.get("frame") != "camera":
                raise DataError(item.location, "is in the base frame", "give a track without robot poses")
            if tracked and not line.shot:
                continue
            reject_other_rig(line.rig, rig, item.location, "give the rig of the poses, or leave out --rig")
            estimate = replace(estimate_of(line, item.location), status=recorded_status(item.values, line))
            if tracked and estimate.shot not in by_shot:
                unnamed.append(estimate)
                continue
            if estimate.shot in by_shot:  # rejects time stamps of another clock
                truth_at(by_shot[estimate.shot], estimate.stamp_s, line.stamp_s)
            estimates.append(estimate)
    return estimates + named_by_stamp(unnamed, truths)


def _truths(file: Path) -> "list[Truth]":
    from ringpose.files.records.truths import read_truths

    truths = list(read_truths(file))
    if not truths:
        raise DataError(str(file), "names no shot")
    return truths


def _scores_of_folders(
    folders: list[str], rig: Path | None, methods: list[Method], batch: Batch, quiet: bool, since_s: float = -inf
) -> "list[Score]":
    """Scores of data sets, of which this run detects the break points and estimates the poses by every method.

    In a folder that is still being filled, shots written before `since_s`, and shots not written yet, are left out.
    """
    from ringpose.bench.score import scores
    from ringpose.files.images.shots import read_shot
    from ringpose.files.rigs import read_rig
    from ringpose.measure.stream import Setup, Stream

    scored = []
    for folder in map(Path, folders):
        if str(folder) == STDOUT or folder.is_file():
            raise UsageError("", f"{folder} is not a data set folder", "give --truth FILE to compare pose lines")
        with batch.guarded():
            _require_data_set(folder, rig)
            of_shots = read_rig(rig or folder / "rig.yaml")
            truths = _truths(folder / "truth.jsonl")
            if since_s > -inf:
                shots = {path.stem: path.stat().st_mtime for path in (folder / "shots").glob("*.npz")}
                truths = [truth for truth in truths if shots.get(truth.shot, -inf) >= since_s]
            estimates: list[PoseEstimate] = []
            streams = [Stream(Setup(rig=of_shots, method=method)) for method in methods]
            for truth in with_progress(truths, "shots", quiet):
                with batch.guarded():
                    shot = read_shot(folder / "shots" / f"{truth.shot}.npz", rig=of_shots)
                    estimates += _estimates_of(shot, streams)
            scored += scores(estimates, truths, of_shots.camera)
    return scored


def _require_data_set(folder: Path, rig: Path | None) -> None:
    """Reject a folder that does not hold a data set."""
    if not folder.exists():
        raise NoInputError(str(folder), "does not exist")
    required = ("truth.jsonl", "shots") if rig is not None else ("rig.yaml", "truth.jsonl", "shots")
    missing = [name for name in required if not (folder / name).exists()]
    if missing:
        remedy = "a data set holds rig.yaml, truth.jsonl and the folder shots; give --truth FILE to compare pose lines"
        raise NoInputError(str(folder), f"is not a data set: it has no {' and no '.join(missing)}", remedy)


def _estimates_of(shot: "Shot", streams: "Sequence[Stream]") -> "Iterator[PoseEstimate]":
    """The estimates of the methods; the first one detects for all of them, which counts in the latency of each.

    But for `paper-detector`, which has break points of its own.
    """
    from ringpose.bench.score import estimate_of

    source: Shot | Detection = shot
    detect_s = 0.0
    for stream in streams:
        has_own = stream.setup.method is Method.PAPER_DETECTOR
        measured = stream.measure(shot if has_own else source)
        line = measured.line
        if not has_own and measured.shot is not None and measured.detection is not None:
            source, detect_s = measured.detection, line.stage_s["detect"]
        elif not has_own:
            line = replace(line, latency_s=line.latency_s + detect_s)
        yield replace(estimate_of(line, shot.name), method=stream.setup.method.value)


def group_names(scores: "list[Score]", by: str | None) -> list[str]:
    """The groups of `--by`; by default those of `DEFAULT_GROUPS` that the shots have."""
    names = list(DEFAULT_GROUPS) if by is None else [name.strip() for name in by.split(",") if name.strip()]
    known = {name for score in scores for name in score.groups}
    unknown = [name for name in names if name not in known]
    if by is not None and unknown:
        raise UsageError("--by", f'no shot has a group "{unknown[0]}"')
    return [name for name in names if name not in unknown]
