"""A rig, detections of a ring that is exactly known, shots that show nothing, and small studies."""

import csv
import hashlib
import json
import math
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
import yaml
from forked import Forked
from plane_views import copy_views
from schemas import validated
from served_scene import small_scene

from ringpose.cli.main import main
from ringpose.types.study import TIMES

WIDTH, HEIGHT, FOCAL = 640, 480, 500.0
CENTER = np.array([0.58, 0.02, 0.9])
RADII = (0.567, 0.597)
ROWS_M = (-0.1, 0.03, 0.15)
"""Where the three stripes cross the ring's plane, which stands across the optical axis."""


def laser(name: str, row_m: float, tilt_rad: float) -> dict[str, Any]:
    """A light plane that meets the plane z = CENTER[2] in the line y = row_m."""
    normal = [0.0, math.cos(tilt_rad), -math.sin(tilt_rad)]
    return {"name": name, "normal": normal, "distance_m": normal[1] * row_m + normal[2] * float(CENTER[2])}


RIG: dict[str, Any] = {
    "ringpose": "rig/1",
    "camera": {
        "image_width": WIDTH,
        "image_height": HEIGHT,
        "camera_matrix": {"rows": 3, "cols": 3, "data": [FOCAL, 0, 319.5, 0, FOCAL, 239.5, 0, 0, 1]},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0, 0, 0, 0, 0]},
    },
    "lasers": [laser(f"l{number}", row, 0.2 * (number - 1)) for number, row in enumerate(ROWS_M)],
    "mount": {"tool_from_camera": [[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, -0.3], [0, 0, 0, 1]]},
}


def break_points_px() -> list[Any]:
    """Pixels where the stripes end on a ring of the known centre and radii."""
    points = [[(CENTER[0] - math.sqrt(r**2 - (y - CENTER[1]) ** 2), y) for r in RADII] for y in ROWS_M]
    return [[[319.5 + FOCAL * x / CENTER[2], 239.5 + FOCAL * y / CENTER[2]] for x, y in edges] for edges in points]


def detection(shot: str) -> dict[str, Any]:
    """The record of a shot with all six break points."""
    points = break_points_px()
    parts = {
        "position_px": points,
        "covariance_px2": [[[[0.01, 0], [0, 0.01]]] * 2] * 3,
        "flags": [[0, 0]] * 3,
        "face_start_px": [edges[0] for edges in points],
        "face_end_px": [edges[1] for edges in points],
        "face_sigma_px": [[0.1, 0.1]] * 3,
        "labelled": True,
    }
    return {"schema": "ringpose/detection/1", "shot": shot, "stamp_s": 1.7e9, "reason": None, "break_points": parts}


def line(shot: str) -> str:
    """The record as a line of JSON."""
    return json.dumps(detection(shot)) + "\n"


_boards_found: dict[tuple[bytes, str], Any] = {}


@pytest.fixture(autouse=True, scope="module")
def _each_board_found_once() -> Iterator[None]:
    """Search an image for a board once for all tests of the commands; the search is tested in tests/calibrate/boards.

    It takes most of the time of a calibration, and the tests share the carried views.
    """
    from ringpose.calibrate.boards.shots import BoardSearch
    from ringpose.calibrate.boards.views import find_board
    from ringpose.types.board import BoardView

    def found(_, image, board, name):
        key = (hashlib.sha256(image.tobytes()).digest(), f"{image.shape} {image.dtype} {board}")
        if key not in _boards_found:
            _boards_found[key] = find_board(image, board, name)
        view = _boards_found[key]
        return replace(view, name=name) if isinstance(view, BoardView) else view

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BoardSearch, "__call__", found)
        yield


class Run(NamedTuple):
    """What a command line has returned and written."""

    status: int
    out: list[str]
    """Lines on standard output."""
    messages: list[str]
    """Lines on standard error."""

    @property
    def records(self) -> list[dict[str, Any]]:
        """The records on standard output; those with a schema fit it."""
        records = [json.loads(line) for line in self.out]
        return [validated(record) if "schema" in record else record for record in records]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Run]:
    """Runs a command line in this process."""

    def run(*words: Any) -> Run:
        capsys.readouterr()
        status = main(list(map(str, words)))
        streams = capsys.readouterr()
        return Run(status, streams.out.splitlines(), streams.err.splitlines())

    return run


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A good rig file."""
    file = tmp_path / "rig.yaml"
    file.write_text(yaml.safe_dump(RIG))
    return file


@pytest.fixture
def detections(tmp_path: Path) -> Path:
    """A file of three detections."""
    file = tmp_path / "detections.jsonl"
    file.write_text(line("a") + line("b") + line("c"))
    return file


@pytest.fixture
def plane_folder(carried_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the true camera and the carried views of the four-marker board, all lasers on."""
    monkeypatch.chdir(tmp_path)
    copy_views(carried_data, tmp_path)
    return tmp_path


@pytest.fixture
def picture(tmp_path: Path) -> Callable[..., Path]:
    """Writes an image of one grey value, with rows of another."""

    def written(name: str, grey: int = 0, rows: tuple[int, ...] = (), size: tuple[int, int] = (HEIGHT, WIDTH)) -> Path:
        image = np.full(size, grey, np.uint8)
        for row in rows:
            image[row - 1 : row + 2, 100:540] = np.array([[90], [200], [90]])
        cv2.imwrite(str(tmp_path / name), image)
        return tmp_path / name

    return written


@pytest.fixture
def forked(forker: socket.socket) -> Callable[..., Forked]:
    """Starts the command as a process that has its modules already, whose import takes 0.3 s of CPU time."""
    return partial(Forked, forker)


@pytest.fixture
def started() -> Callable[..., "subprocess.Popen[str]"]:
    """Starts the command as a process of its own."""

    def start(*arguments: str | Path, before: str = "", **options: Any) -> "subprocess.Popen[str]":
        program = f"{before}\nfrom ringpose.cli.main import run\nrun()"
        # a signal may arrive between the opening of a file and its `with` block; byte code would be cut off where a
        # test limits the size of files, and later processes could not read it
        flags = ("-B", "-W", "error", "-W", "ignore::ResourceWarning")
        words = [sys.executable, *flags, "-c", program, *map(str, arguments)]
        pipe = subprocess.PIPE
        return subprocess.Popen(words, **({"stdin": pipe, "stdout": pipe, "stderr": pipe, "text": True} | options))

    return start


@pytest.fixture
def serving(tmp_path, monkeypatch, forker):
    """Start `ringpose simulate serve`, of a small scene if there is none; the process and its URIs."""
    monkeypatch.chdir(tmp_path)
    processes = []

    def started(*words):
        if not Path("scene.yaml").exists():
            small_scene(tmp_path)
        process = Forked(forker, ["simulate", "serve", *words])
        processes.append(process)
        return process, json.loads(process.stdout.readline())

    yield started
    for process in processes:
        with process:
            if process.returncode is None:
                process.send_signal(signal.SIGTERM)
                assert process.wait(300) == 143


@pytest.fixture
def serve(serving, loopback_address):
    """Start virtual devices and return their URIs."""

    def started(*options: str, scene: str = "scene.yaml") -> dict[str, str]:
        return serving("--scene", scene, "--camera", loopback_address, "--log", "log.jsonl", *options)[1]

    return started


STUDY = """\
ringpose: study/1
title: small
scene: scene.yaml
level: features
count: {count}
seed: 1
vary: {{distance_m: [0.3, 0.5], light: {light}}}
methods: {methods}
"""


@pytest.fixture
def study_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Makes a working folder with a small study, study.yaml, of the example scene."""

    def made(count: int = 2, light: str = "[dim, normal]", methods: str = "[ml]") -> Path:
        for name in ("scene.yaml", "scene-rig.yaml"):
            shutil.copy(Path(__file__).parents[2] / "examples" / name, tmp_path)
        (tmp_path / "study.yaml").write_text(STUDY.format(count=count, light=light, methods=methods))
        monkeypatch.chdir(tmp_path)
        return tmp_path

    return made


@pytest.fixture
def study_process(started: Callable[..., "subprocess.Popen[str]"]) -> Callable[..., "subprocess.Popen[str]"]:
    """Starts `ringpose bench study` of study.yaml as a process of its own; `before` is run in it first."""

    def start(output: str, *words: str, before: str = "") -> "subprocess.Popen[str]":
        arguments = ("bench", "study", "study.yaml", "--output", output, "--quiet", *words)
        return started(*arguments, before=before, stdout=subprocess.DEVNULL)

    return start


@pytest.fixture
def study_rows() -> Callable[[str], list[dict[str, str]]]:
    """The rows of a study's results.csv without the times."""

    def read(output: str) -> list[dict[str, str]]:
        with Path(output, "results.csv").open() as stream:
            return [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(stream)]

    return read
