"""Golden lines: what the commands wrote for the rendered shots when they were last looked at, and how to compare.

    python tests/golden_lines.py            compare; status 3 if a line has changed
    python tests/golden_lines.py --renew    show the lines that have changed, and keep them as the golden ones

`tests/data/golden` holds a compressed file of JSON lines for each stream of shots, without times. Every key of a line
must be equal. A number may differ by `TOLERANCE` of its standard deviation; one that has none, of its `scale`.
"""

import argparse
import io
import json
import lzma
import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ringpose.cli.main import main

CARRIED = Path(__file__).parent / "data"
GOLDEN = CARRIED / "golden"
RENDERED = Path(__file__).resolve().parents[2] / "shared" / "data" / "rendered"

TOLERANCE = 1e-6
"""Largest difference of a number, in its standard deviations or of its scale."""

DIGITS, PRECISE_DIGITS = 9, 13
"""Significant digits that are stored: 9, and more where a millionth of the standard deviation needs them."""

LEFT_OUT = ("latency_s", "stage_s", "software")
"""Keys that differ in every run, or in every version."""

SETS = ("rig_a", "rig_b", "variants_a", "variants_b", "sizes_b", "surfaces_b", "moving_b")

Record = dict[str, Any]


# What is written today


def pose_lines(folder: Path, pattern: str = "*", *options: str) -> list[Record]:
    """The lines of `ringpose pose` for the shots of a data set, measured as one stream."""
    shots = sorted(map(str, (folder / "shots").glob(f"{pattern}.npz")))
    lines = written(["pose", *shots, "--rig", str(folder / "rig.yaml"), "--quiet", *options])
    return [
        {key: value for key, value in json.loads(line).items() if key not in LEFT_OUT} for line in lines.splitlines()
    ]


def calibrations(boards: Path) -> list[Record]:
    """What camera.yaml and rig.yaml state after a calibration by board views, but for where it came from."""
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / name) for name in ("camera.yaml", "rig.yaml")]
        words = [str(boards / "camera"), "--board", str(boards / "camera_board.yaml"), "--output", files[0]]
        written(["calibrate-camera", *words, "--quiet"])
        words = [str(boards / "planes"), "--board", str(boards / "plane_board.yaml"), "--camera", files[0]]
        written(["calibrate-planes", *words, "--output", files[1], "--quiet"])
        return [_calibration(yaml.safe_load(Path(file).read_text())) for file in files]


def _calibration(record: Record) -> Record:
    camera = record.get("camera", record)
    return {
        "shot": record["ringpose"],
        "camera_matrix": camera["camera_matrix"]["data"],
        "distortion_coefficients": camera["distortion_coefficients"]["data"],
        "lasers": record.get("lasers"),
        "covariance": record["covariance"],
        "verdict": record["quality"]["verdict"],
    }


def written(words: list[str]) -> str:
    """What a command of ringpose writes to its standard output."""
    messages = io.StringIO()
    with redirect_stdout(io.StringIO()) as stream, redirect_stderr(messages):
        status = main(words)
    if status not in (0, 3):  # 3: a shot has no pose
        raise RuntimeError(f"ringpose {words[0]}: status {status}\n{messages.getvalue()}")
    return stream.getvalue()


STREAMS: Mapping[str, Callable[[], list[Record]]] = {
    "carried": lambda: pose_lines(CARRIED / "rig_b"),
    "carried_track": lambda: pose_lines(CARRIED / "rig_b", "*", "--track"),
    **{name: (lambda name=name: pose_lines(RENDERED / name)) for name in SETS},
    **{
        f"track_{number}": (lambda number=number: pose_lines(RENDERED / "moving_b", f"seq_{number}_*", "--track"))
        for number in (0, 1)
    },
    "calibrations": lambda: calibrations(RENDERED / "calib_b"),
}
"""The golden files; those whose names begin with `carried` are of the shots in tests/data."""


# How two lines are compared


def changes(golden: list[Record], now: list[Record]) -> Iterator[str]:
    """A line of text for each line that has changed: its shot, and what is different."""
    before, after = ({str(record["shot"]): record for record in records} for records in (golden, now))
    for shot in dict.fromkeys([*before, *after]):
        if shot not in before or shot not in after:
            yield f"{shot}: {'is new' if shot in after else 'is missing'}"
        elif found := differences(before[shot], after[shot]):
            rest = f"; and {len(found) - 5} more" if len(found) > 5 else ""
            yield f"{shot}: {'; '.join(found[:5])}{rest}"


def differences(golden: Record, now: Record) -> list[str]:
    """The keys in which two lines differ, each with both values or with the number of standard deviations."""
    scales = deviations(golden)
    found: list[str] = []

    def compare(path: str, before: Any, after: Any) -> None:
        if isinstance(before, dict) and isinstance(after, dict):
            for key in dict.fromkeys([*before, *after]):
                compare(f"{path}.{key}" if path else key, before.get(key), after.get(key))
        elif _is_numeric(before) and _is_numeric(after):
            found.extend(_numeric_difference(path, _array(before), _array(after), scales))
        elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
            for index, pair in enumerate(zip(before, after, strict=True)):
                compare(f"{path}.{index}", *pair)
        elif before != after:
            found.append(f"{path}: {_short(before)} -> {_short(after)}")

    compare("", golden, now)
    return found


def _is_numeric(value: Any) -> bool:
    """Whether it is a number, or an array of numbers of which some may be unknown, but not all."""
    if isinstance(value, list):
        flat = np.array(value, dtype=object).ravel().tolist()
        return bool(flat) and any(map(_is_numeric, flat)) and all(each is None or _is_numeric(each) for each in flat)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _array(value: Any) -> Any:
    return np.array(value, dtype=float)


ROWS = ("square_root", "rows", "regularization")
"""Keys of rows [J, r] that are known up to a rotation: J^T J, J^T r and r^T r are compared."""


def _numeric_difference(path: str, before: Any, after: Any, scales: Mapping[str, Any]) -> Iterator[str]:
    name = path.rpartition(".")[2]
    if name in ROWS and before.ndim == 2:
        before, after = before.T @ before, after.T @ after
    if before.shape != after.shape or bool((np.isnan(before) != np.isnan(after)).any()):
        yield f"{path}: has other elements"
        return
    known = np.where(np.isnan(before), 0.0, before)
    scale = scales.get(path)
    if scale is None:
        scale = _correlation_scale(known) if name in ROWS or "covariance" in path else _scale(known)
    off = np.nan_to_num(np.abs(after - before)) / scale
    if off.max() > TOLERANCE:
        place = np.unravel_index(int(off.argmax()), off.shape)
        unit = "sigmas" if path in scales else "of its scale"
        yield f"{path}: {before[place]:.9g} -> {after[place]:.9g} ({off.max():.2g} {unit})"


def _scale(values: Any) -> float:
    """The scale of numbers without a standard deviation: the largest of the array, 1 for small ones."""
    return max(float(np.abs(values).max()), 1.0) if values.ndim == 0 else float(np.abs(values).max()) or 1.0


ROUNDING = 1e-8
"""Numbers smaller than this share of the largest one beside them are what rounding has left of zero."""


def _correlation_scale(matrix: Any) -> Any:
    """The scale of the elements of a symmetric matrix: the roots of the products of its diagonal."""
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        return _scale(matrix)
    root = np.sqrt(np.abs(matrix.diagonal()))
    root = np.maximum(root, ROUNDING * root.max()) if root.any() else np.ones_like(root)
    return np.outer(root, root)


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) < 100 else f"{text[:97]}..."


def deviations(record: Record) -> dict[str, Any]:
    """Standard deviations by the path of the number or vector, as far as the line states them."""
    schema = str(record.get("schema", ""))
    if schema.startswith("ringpose/pose/"):
        return {**_of_pose(record), **_of_velocity(record)}
    return {**_of_pose(record), **_of_velocity(record), **_of_track(record)} if schema else _of_calibration(record)


def _sd(matrix: Any, *places: int) -> Any:
    """Standard deviations from a covariance; of all elements, or of some."""
    roots = np.sqrt(_array(matrix).diagonal())
    return roots[list(places)] if places else roots


def _of_pose(record: Record) -> dict[str, Any]:
    pose = record["pose"]
    covariance = pose and pose["covariance"]
    if not covariance:
        return {}
    found: dict[str, Any] = {}
    if covariance["center"]:
        found["center_m"] = _sd(covariance["center"])
    if covariance["grasp"]:
        found["grasp_m"] = _sd(covariance["grasp"]).max()  # it is chosen along the face, and has no error there
    if covariance["full"]:
        tilt, *_, inner_m, outer_m = _sd(covariance["full"])
        if tilt == tilt:
            found |= dict.fromkeys(("normal", "pitch_rad", "yaw_rad"), tilt)
        found |= {
            name: sd
            for name, sd in (("radius_inner_m", inner_m), ("radius_outer_m", outer_m))
            if sd == sd and pose[name] is not None
        }
    at = ("center_m", "normal", "radius_inner_m", "radius_outer_m")
    linearized = {f"measurement.linearized_at.{name}": found[name] for name in at if name in found}
    return {f"pose.{name}": sd for name, sd in found.items()} | linearized


def _of_velocity(record: Record) -> dict[str, Any]:
    velocity = record["velocity"]
    if not velocity:
        return {}
    sd = _sd(velocity["covariance"])
    found = {"velocity.center_m_s": sd[:3], "velocity.rate_rad_s": sd[3:].max()}
    at = {"velocity_m_s": sd[:3], "rate_rad_s": sd[3:].max()}
    return found | {f"measurement.linearized_at.{name}": value for name, value in at.items()}


def _of_track(record: Record) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if record["grasp"]:
        sd = _sd(record["grasp"]["covariance"])
        found |= {"grasp.point_m": sd[:3].max(), "grasp.velocity_m_s": sd[3:].max()}
    if record["next"]:
        sd = _sd(record["next"]["covariance"])
        found |= {"next.grasp_m": sd[:3].max(), "next.normal": sd[3:].max()}
    return found


def _of_calibration(record: Record) -> dict[str, Any]:
    sd = dict(zip(record["covariance"]["parameters"], _sd(record["covariance"]["data"]), strict=True))
    fx, fy, cx, cy = (sd[name] for name in ("fx", "fy", "cx", "cy"))
    found: dict[str, Any] = {
        "camera_matrix": np.array([fx, 1.0, cx, 1.0, fy, cy, 1.0, 1.0, 1.0]),
        "distortion_coefficients": np.array([sd[name] for name in ("k1", "k2", "p1", "p2", "k3")]),
    }
    for number, laser in enumerate(record["lasers"] or ()):
        tilt = max(sd[f"{laser['name']}.tilt_{axis}"] for axis in (1, 2))
        found |= {f"lasers.{number}.normal": tilt, f"lasers.{number}.distance_m": sd[f"{laser['name']}.distance"]}
    return found


# The files


def stored(record: Record) -> Record:
    """The line as it is stored: rounded to `DIGITS`, or to `PRECISE_DIGITS` where it is measured more precisely."""
    precise = deviations(record)

    def rounded(path: str, value: Any, digits: int) -> Any:
        digits = PRECISE_DIGITS if path in precise or path.endswith("stamp_s") else digits
        if isinstance(value, dict):
            return {key: rounded(f"{path}.{key}" if path else key, each, digits) for key, each in value.items()}
        if isinstance(value, list):
            return [rounded(f"{path}.{index}", each, digits) for index, each in enumerate(value)]
        if isinstance(value, float) and math.isfinite(value):
            return float(f"{value:.{digits}g}")
        return value

    return dict(rounded("", record, DIGITS))


def read_lines(name: str) -> list[Record]:
    """The golden lines of a stream; none if there is no file."""
    file = GOLDEN / f"{name}.jsonl.xz"
    if not file.exists():
        return []
    return [json.loads(line) for line in lzma.decompress(file.read_bytes()).decode().splitlines()]


def renew(name: str, golden: list[Record], now: list[Record]) -> None:
    """Write the lines that have changed; the others stay as they were, and the same lines give the same bytes."""
    before = {str(record["shot"]): record for record in golden}
    kept = [
        before[shot] if shot in before and not differences(before[shot], record) else stored(record)
        for record in now
        for shot in [str(record["shot"])]
    ]
    text = "".join(json.dumps(record, allow_nan=False) + "\n" for record in kept)
    (GOLDEN / f"{name}.jsonl.xz").write_bytes(lzma.compress(text.encode(), preset=9))


def run() -> int:
    """Compare, or renew, the golden lines of all streams, or of those that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help=f"streams, default all: {', '.join(STREAMS)}")
    parser.add_argument("--renew", action="store_true", help="keep the lines of this version as the golden ones")
    options = parser.parse_args()
    if not RENDERED.is_dir():
        sys.exit(f"{RENDERED}: is not there; put the rendered data sets there")
    GOLDEN.mkdir(exist_ok=True)
    count = 0
    for name in options.names or STREAMS:
        golden, now = read_lines(name), STREAMS[name]()
        changed = list(changes(golden, now))
        count += len(changed)
        for line in changed:
            sys.stdout.write(f"{name}: {line}\n")
        if changed and options.renew:
            renew(name, golden, now)
    kept = ", and are kept" if options.renew else ""
    sys.stdout.write(f"{count} lines have changed{kept}\n" if count else "nothing changed\n")
    return 3 if count and not options.renew else 0


if __name__ == "__main__":
    sys.exit(run())
