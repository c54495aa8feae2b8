"""The generated C++ header, compiled in the example that uses it: it reads what is written, or names what is wrong."""

import copy
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from needed import missing, needed_program
from schemas import SCHEMAS
from whole_records import complete_line, complete_track, record_of

from ringpose.files.cpp_header import cpp_header
from ringpose.files.records.poses import pose_record
from ringpose.files.records.tracks import track_record

pytestmark = pytest.mark.slow  # to compile the example takes four seconds of CPU time

EXAMPLE = Path(__file__).parents[2] / "examples" / "read_lines.cpp"
RNG = np.random.default_rng(0)
POSE, TRACK = record_of(pose_record(complete_line(RNG))), record_of(track_record(complete_track(RNG)))


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Path:
    """The example, compiled without a warning."""
    compiler = needed_program("g++", "g++")
    if not Path("/usr/include/nlohmann/json.hpp").exists():
        missing("nlohmann/json is not installed (apt install nlohmann-json3-dev)")
    folder = tmp_path_factory.mktemp("cpp")
    (folder / "ringpose.hpp").write_text(cpp_header(SCHEMAS))
    warnings = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror")
    subprocess.run([compiler, "-std=c++17", *warnings, f"-I{folder}", EXAMPLE, "-o", folder / "read"], check=True)
    return folder / "read"


def read(program: Path, lines: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program], input="\n".join(lines), capture_output=True, text=True, timeout=100)


def places(values: Any, path: tuple = ()) -> Iterator[tuple]:
    """The path of each key of an object, and of the first object in each list."""
    if isinstance(values, dict):
        for key, value in values.items():
            yield (*path, key)
            yield from places(value, (*path, key))
    elif isinstance(values, list) and values:
        yield from places(values[0], (*path, 0))


def place_of(path: tuple) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).removeprefix(".")


def changed(record: dict, path: tuple) -> str:
    """The line with a value of another type at one place."""
    record = copy.deepcopy(record)
    place = record
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = 1.5 if isinstance(place[path[-1]], bool) else True
    return json.dumps(record)


def test_the_example_prints_grasp_point_and_its_sigma(program):
    done = read(program, [json.dumps(POSE), json.dumps(TRACK), json.dumps(POSE | {"pose": None, "new_key": [1]})])

    assert (done.returncode, done.stderr) == (0, "")
    for line, record in zip(done.stdout.splitlines()[:2], (POSE, TRACK), strict=True):
        shot, status, x, y, z, _, sd_m, _, _, frame, *flags = line.split()
        assert (shot, status, frame, flags) == (record["shot"], record["status"], record["frame"], record["flags"])
        assert np.allclose([float(x), float(y), float(z)], record["pose"]["grasp_m"], rtol=1e-5)
        assert np.isclose(float(sd_m), np.sqrt(np.trace(record["pose"]["covariance"]["grasp"])), rtol=1e-5)
    assert done.stdout.splitlines()[2].split() == [POSE["shot"], POSE["status"], *POSE["flags"]]


@pytest.mark.parametrize("record", [POSE, TRACK], ids=["pose", "track"])
def test_each_key_is_read_as_the_type_that_its_schema_states(program, record):
    paths = list(places(record))

    done = read(program, [changed(record, path) for path in paths])

    errors = done.stderr.splitlines()
    assert len(errors) == len(paths) > 40
    for path, error in zip(paths, errors, strict=True):
        assert error.startswith(f"read_lines: {place_of(path)}: is "), error
    assert done.returncode == 65


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "is array, must be an object"),
        ('{"schema": "ringpose/pose/1"}', "schema: is ringpose/pose/1, must be ringpose/pose/2 or ringpose/track/1"),
        ("{}", "schema: is missing"),
        (json.dumps({key: value for key, value in POSE.items() if key != "flags"}), "flags: is missing"),
        (
            json.dumps(POSE | {"pose": POSE["pose"] | {"grasp_m": [0.0, 1.0]}}),
            "pose.grasp_m: is array, must be a list of 3",
        ),
    ],
)
def test_what_cannot_be_read_is_named(program, line, message):
    done = read(program, [line])

    assert message in done.stderr
    assert done.returncode == 65
