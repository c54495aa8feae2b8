"""`ringpose bench speed`: times of detection, pose estimation and start-up on this machine."""

import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ringpose.cli.options.common import STDOUT, Force, JsonFile

if TYPE_CHECKING:
    from ringpose.types.image import Shot
    from ringpose.types.rig import Rig

COMMAND = "import sys; from ringpose.cli.main import run; run()"

Rounds = Annotated[int, typer.Option("--rounds", metavar="N", min=1, help="Repetitions of each time; medians count.")]


def speed(rounds: Rounds = 11, json: JsonFile = None, force: Force = False) -> None:
    """Measure the times of detection, pose estimation and start-up, as ratios to reference functions."""
    from ringpose.bench.speed import detection_times_s, pose_times_s
    from ringpose.bench.table import aligned
    from ringpose.files import records
    from ringpose.files.io import provenance, write_result

    rows = [row for times in (detection_times_s, pose_times_s, start_times_s) for row in _rows(times(rounds))]
    if json != STDOUT:
        cells = [[row["name"], f"{row['time_s'] * 1e3:.2f}", f"{row['ratio']:.3g}", row["reference"]] for row in rows]
        records.write_text("\n".join(aligned([["", "ms", "ratio to", "reference"], *cells], left=1)) + "\n")
    if json is not None:
        record = {"ringpose": "bench_speed/2", "times": rows, "provenance": provenance([])}
        write_result(json, records.line_of(record), force=force)


def start_times_s(rounds: int) -> dict[str, float]:
    """Wall times of `import numpy, cv2`, the reference, of `pose --help`, and until the first pose of a shot."""
    from tempfile import TemporaryDirectory
    from time import perf_counter

    from ringpose.bench.speed import median_times_s, rendered_shot

    with TemporaryDirectory() as folder:
        return median_times_s(start_calls(Path(folder), *rendered_shot()), rounds, perf_counter)


def start_calls(folder: Path, shot: "Shot", rig: "Rig") -> dict[str, Callable[[], object]]:
    """Calls that start a process and wait for its first line; a folder takes the input files and the byte code."""
    from ringpose.detect.pipeline import detect
    from ringpose.files.images.shots import write_shot
    from ringpose.files.records import line_of
    from ringpose.files.records.detections import detection_record
    from ringpose.files.rigs import read_rig, write_rig

    rig_file, shot_file, detection_file = folder / "rig.yaml", folder / "shot.npz", folder / "detection.jsonl"
    write_rig(rig_file, rig)
    write_shot(shot_file, shot)
    detection_file.write_text(line_of(detection_record(detect(shot, read_rig(rig_file)), full=False)))
    pose = ["-c", COMMAND, "pose", "--rig", str(rig_file)]
    return {
        "import numpy, cv2": partial(_first_line, ["-c", "import numpy, cv2"], folder),
        "ringpose pose --help": partial(_first_line, ["-c", COMMAND, "pose", "--help"], folder),
        "first pose of a detection": partial(_first_line, [*pose, str(detection_file)], folder),
        "first pose of a shot": partial(_first_line, [*pose, str(shot_file)], folder),
    }


def _rows(times_s: dict[str, float]) -> list[dict[str, Any]]:
    """A row for each time; the first one is the reference of the ratios."""
    reference = next(iter(times_s))
    return [
        {"name": name, "time_s": time_s, "ratio": time_s / times_s[reference], "reference": reference}
        for name, time_s in times_s.items()
    ]


def _first_line(words: Sequence[str], bytecode: Path) -> str:
    """Run Python until it writes a line or ends.

    Byte code is kept in a folder of its own from the first run on, as in an installation: the byte code of an editable
    installation may be out of date or not writable.
    """
    from subprocess import PIPE, Popen

    from ringpose.errors import InputOutputError

    environment = os.environ | {"PYTHONPYCACHEPREFIX": str(bytecode), "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, *words]
    with Popen(command, stdout=PIPE, text=True, env=environment) as process:  # noqa: S603 (our own arguments)
        line = process.stdout.readline() if process.stdout else ""
        if line:
            process.kill()
    if not line and process.returncode:
        raise InputOutputError(" ".join(words[2:]), f"ended with status {process.returncode}")
    return line
