"""`ringpose bench speed`: what it takes and how fine it is on this machine, beside the limits."""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.options import STDOUT, Force, JsonFile, PoseFrame
from ringpose.types.options import Method

if TYPE_CHECKING:
    from ringpose.bench.speed_gates import GateSection
    from ringpose.types.image import Shot
    from ringpose.types.rig import Rig


COMMAND = "import sys; from ringpose.cli.main import run; run()"

Seeds = Annotated[
    int, typer.Option("--seeds", metavar="N", min=1, help="Synthetic images of each kind for the accuracy.")
]
Rounds = Annotated[int, typer.Option("--rounds", metavar="N", min=1, help="Turns in which each time is taken.")]


def speed(seeds: Seeds = 40, rounds: Rounds = 11, json: JsonFile = None, force: Force = False) -> None:
    """Measure what detection and pose take and how fine they are, each beside the limit it is meant to keep."""
    from ringpose.bench.speed_gates import section_record, section_text
    from ringpose.files import records
    from ringpose.files.io import write_result
    from ringpose.files.provenance import provenance

    measured: list[GateSection] = []
    for section in _sections(seeds, rounds):
        apart = "\n" if measured else ""
        measured.append(section)
        if json != STDOUT:
            records.write_text(apart + section_text(section))
    if json is not None:
        sections = [section_record(section) for section in measured]
        noted = {"ringpose": "bench_speed/1", "sections": sections, "provenance": provenance([])}
        write_result(json, records.line_of(noted), force=force)


def _sections(seeds: int, rounds: int) -> "Iterator[GateSection]":
    from tempfile import TemporaryDirectory

    from ringpose.bench.speed import detection_sections, start_gates

    yield from detection_sections(seeds, rounds, _pose_stream)
    with TemporaryDirectory() as folder:
        yield start_gates(_starts(Path(folder)), rounds)


def _pose_stream(shot: "Shot", rig: "Rig") -> str:
    """What `ringpose pose` writes about a shot."""
    from ringpose.files.poses import pose_record
    from ringpose.files.records import line_of
    from ringpose.pose.record import pose_line

    return line_of(pose_record(pose_line(shot, rig, Method.ML, PoseFrame.CAMERA)))


def _starts(folder: Path) -> dict[str, Callable[[], object]]:
    """Processes that end, or say their first line, as soon as they can."""
    from ringpose.bench.detectors import shot_of
    from ringpose.bench.stripe_images import Kind, stripe_image
    from ringpose.detect.pipeline import detect
    from ringpose.files.detections import detection_record
    from ringpose.files.records import line_of
    from ringpose.files.rigs import write_rig
    from ringpose.files.shots import write_shot

    image = stripe_image(Kind.DARK, 0)
    rig, shot, record = folder / "rig.yaml", folder / "shot.npz", folder / "detection.jsonl"
    write_rig(rig, image.rig)
    write_shot(shot, shot_of(image))
    record.write_text(line_of(detection_record(detect(shot_of(image), image.rig), full=False)))
    pose = ["-c", COMMAND, "pose", "--rig", str(rig)]
    started = partial(_first_line, bytecode=folder)
    return {
        "import numpy, cv2": lambda: started(["-c", "import numpy, cv2"]),
        "ringpose pose --help": lambda: started(["-c", COMMAND, "pose", "--help"]),
        "first pose line of a detection": lambda: started([*pose, str(record)]),
        "first pose line of a shot": lambda: started([*pose, str(shot)]),
    }


def _first_line(words: Sequence[str], bytecode: Path) -> str:
    """Run Python until it says something, or ends; it has its byte code there from the second time on.

    In the place of an installation that is edited it may be out of date, or nobody may write it.
    """
    from subprocess import PIPE, Popen

    from ringpose.errors import InputOutputError

    environment = os.environ | {"PYTHONPYCACHEPREFIX": str(bytecode), "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, *words]
    with Popen(command, stdout=PIPE, text=True, env=environment) as process:  # noqa: S603 (words of our own)
        line = process.stdout.readline() if process.stdout else ""
        if line:
            process.kill()
    if not line and process.returncode:
        raise InputOutputError(" ".join(words[2:]), f"ended with status {process.returncode}")
    return line
