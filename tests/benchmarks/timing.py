"""Times of calls taken in turns, a call of solvePnP as reference, and starts of the command."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from statistics import median
from subprocess import PIPE, Popen
from time import process_time

import cv2
import numpy as np

from ringpose.detect.pipeline import detect
from ringpose.files.images.shots import write_shot
from ringpose.files.records import line_of
from ringpose.files.records.detections import detection_record
from ringpose.files.rigs import read_rig, write_rig
from ringpose.types.detection import BreakPoints
from ringpose.types.image import Shot
from ringpose.types.rig import Camera, Rig

COMMAND = "import sys; from ringpose.cli.main import run; run()"

POSES_PER_ROUND = 20
"""A pose takes about a millisecond, so it is timed more often than a detection."""


def median_times_s(
    calls: Mapping[str, Callable[[], object]], rounds: int, clock: Callable[[], float] = process_time
) -> dict[str, float]:
    """Median seconds of each call, after one call to warm up, in rounds in which each runs once.

    The default clock is the processor time of all threads of this process: other processes have no influence, and
    additional threads do not shorten it.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(rounds):
        for name, call in calls.items():
            start = clock()
            call()
            times[name].append(clock() - start)
    return {name: median(every) for name, every in times.items()}


@contextmanager
def one_core() -> Iterator[None]:
    """Run OpenCV in the calling thread only while the block runs."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def solve_pnp(points: BreakPoints, camera: Camera) -> Callable[[], object]:
    """A function that calls solvePnP with the break points as image points.

    The object points are the same points in a plane parallel to the image.
    """
    pixels = points.position_px.reshape(-1, 2)
    flat = (pixels - camera.camera_matrix[:2, 2]) / camera.camera_matrix[0, 0]
    objects = np.column_stack([flat, np.zeros(len(flat))])
    return lambda: cv2.solvePnP(objects, pixels, camera.camera_matrix, camera.distortion_coefficients)


def start_calls(folder: Path, shot: Shot, rig: Rig) -> dict[str, Callable[[], str]]:
    """Calls that start a process and return its first line; a folder takes the input files and the byte code."""
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


def _first_line(words: Sequence[str], bytecode: Path) -> str:
    """Run Python until it writes a line or ends.

    Byte code is kept in a folder of its own from the first run on, as in an installation: the byte code of an editable
    installation may be out of date or not writable.
    """
    environment = os.environ | {"PYTHONPYCACHEPREFIX": str(bytecode), "PYTHONDONTWRITEBYTECODE": ""}
    with Popen([sys.executable, *words], stdout=PIPE, text=True, env=environment) as process:
        line = process.stdout.readline() if process.stdout else ""
        if line:
            process.kill()
    if not line and process.returncode:
        raise RuntimeError(f"{' '.join(words[2:])}: ended with status {process.returncode}")
    return line
