"""Halves and doubles each named number of detection and estimation, and prints what changes (`make ablation`).

    python tests/benchmarks/ablation.py [--folder detect] [--only NAME] [--wide] [--results FILE]

The numbers are those that `make structure` counts: constants of modules, and defaults of the fields of classes, in
ringpose/detect, ringpose/estimate and ringpose/kernels/lines, from where the parameters of the kernels come. Each
number is changed in the source of its module, in a process of its own that has not imported it yet, so that what is
derived from it changes, too. The shots are decoded once, before. A run goes on where the last one stopped: each number
has one line in the results, which is taken over if number and shots are the same.

The columns: poses and `ok` lines (of all shots), shots with a wrong quantity (against the truth; gross ones after a
slash), how many lines differ at all, and how many by a status, a flag, or 0.1 sigmas of a quantity; the ratio of the
mean centre, normal and grasp errors to those of the unchanged numbers, over the shots that have them in both; the
processor time.
"""

import argparse
import ast
import hashlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import math
import os
import pickle
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.special
import scipy.stats  # noqa: F401

sys.path.insert(0, str(Path(__file__).parents[1]))

from composed_ghosts import with_ghost

from ringpose.files.images.shots import read_shot
from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig
from ringpose.types.image import Shot
from ringpose.types.rig import Rig
from ringpose.types.truth import Truth

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared" / "data"
RESULTS = ROOT / "build" / "ablation.jsonl"
FOLDERS = ("detect", "kernels/lines", "estimate")
NOT_MEASURING = ("pose_errors",)
"""Modules that judge poses, with which the changed ones are compared."""

FACTORS = (0.5, 2.0)
TIME_LIMIT_S = 300
CHANGED_SIGMAS = 0.1
"""A quantity that moves by less is unchanged."""

SOME = {
    "rig_a": ("A_z0500_p05_dim", "A_z1000_p00_dim", "A_z1000_p00_normal"),
    "rig_b": (
        "B_z0200_p00_dim",
        "B_z0300_p00_normal",
        "B_z0500_p01_dim",
        "B_z1000_p01_dim",
        "B_z1000_p00_normal",
        "B_z1000_p05_dim",
    ),
    "variants_a": ("V14_chamfer_A500_normal", "V16_lowpower_A1000_dim"),
    "variants_b": ("V03_occl_B500_dim", "V12_glare_B500_glare", "V18_tilt_B500_dim"),
    "sizes_b": (
        "B_z0300_r0110_p00_dim",
        "B_z0500_r0150_p00_normal",
        "B_z0500_r0280_p00_dim",
        "B_z0700_r1600_p00_dim",
    ),
    "surfaces_b": tuple(f"W_{kind}_B500_dim_sw" for kind in ("bolts", "cable", "cone", "gap", "groove", "specular")),
    "moving_b": ("mov_0_x", "mov_1_turn_y", "mov_0_still"),
}
"""The shots of the first pass: each kind, size and light once."""

ALL = ("rig_a", "rig_b", "variants_a", "variants_b", "sizes_b", "surfaces_b", "moving_b")
TRACKED = ("seq_0_00", "seq_0_01")
GHOSTS = ((0.1, 15.0), (0.2, 30.0))
PHOTOGRAPHS = ("P1020171",)


# The numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """A named number, or one element of several that have one name."""

    path: Path
    """Of its module, from the root."""
    name: str
    place: tuple[int, ...]
    """Which element of its value; () for all of it."""

    def __str__(self) -> str:
        place = "".join(f"[{each}]" for each in self.place)
        return f"{self.path.relative_to('ringpose').with_suffix('')}.{self.name}{place}"

    @property
    def module(self) -> str:
        """Dotted name of its module."""
        return ".".join(self.path.with_suffix("").parts).removesuffix(".__init__")


def named_numbers(folders: Sequence[str]) -> Iterator[Number]:
    """The named numbers of some folders of the package, in the order of the source."""
    for folder in folders:
        for path in sorted((ROOT / "ringpose" / folder).rglob("*.py")):
            if path.stem in NOT_MEASURING:
                continue
            for name, value in assignments(ast.parse(path.read_text())):
                for place in places(value):
                    yield Number(path=path.relative_to(ROOT), name=name, place=place)


def assignments(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Names that are given numbers in a module, and what they are given."""
    bodies = [("", tree.body)] + [(f"{node.name}.", node.body) for node in tree.body if isinstance(node, ast.ClassDef)]
    for prefix, body in bodies:
        for node in body:
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            if any(_is_number(each) for each in ast.walk(node.value)):
                yield prefix + ast.unparse(target), node.value


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool)


def places(value: ast.expr) -> Iterator[tuple[int, ...]]:
    """The elements of a value that are scaled one by one; `linspace` has its range and its number of elements."""
    if isinstance(value, ast.Call) and ast.unparse(value.func) in ("slice", "Rates", "Fault", "Hypothesis"):
        return
    if isinstance(value, ast.Call) and ast.unparse(value.func) == "np.linspace":
        yield from ((0,), (2,))
    elif isinstance(value, ast.Tuple | ast.Dict):
        for number, each in enumerate(value.elts if isinstance(value, ast.Tuple) else value.values):
            if any(map(_is_number, ast.walk(each))):
                yield from ((number, *place) for place in places(each))
    else:
        yield ()


def scaled(value: Any, factor: float) -> Any:
    """The number times a factor; a whole number stays whole and at least 1."""
    if isinstance(value, int) and not isinstance(value, bool):
        return int(math.copysign(max(round(abs(value) * factor), 1), value))
    return value * factor


def _wrapped(value: ast.expr, place: tuple[int, ...]) -> ast.expr:
    if isinstance(value, ast.Call) and place:
        if place == (0,):
            arguments = [_wrapped(value.args[0], ()), _wrapped(value.args[1], ()), value.args[2]]
        else:
            arguments = [*value.args[:2], _wrapped(value.args[2], ())]
        return ast.Call(func=value.func, args=arguments, keywords=value.keywords)
    if place and isinstance(value, ast.Tuple):
        elements = list(value.elts)
        elements[place[0]] = _wrapped(elements[place[0]], place[1:])
        return ast.Tuple(elts=elements, ctx=ast.Load())
    if place and isinstance(value, ast.Dict):
        values = list(value.values)
        values[place[0]] = _wrapped(values[place[0]], place[1:])
        return ast.Dict(keys=value.keys, values=values)
    call = ast.parse(f"__scaled__(({ast.unparse(value)}))", mode="eval").body
    assert isinstance(call, ast.expr)
    return call


def changed_source(number: Number) -> ast.Module:
    """The module with the number scaled by `__scaled__`."""
    tree = ast.parse((ROOT / number.path).read_text())
    for name, value in assignments(tree):
        if name == number.name:
            for node in ast.walk(tree):
                if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is value:
                    node.value = _wrapped(value, number.place)
    return ast.fix_missing_locations(tree)


class ChangedModule(importlib.abc.MetaPathFinder):
    """Imports one module with a number scaled."""

    def __init__(self, number: Number, factor: float) -> None:
        self._number = number
        tree, path = changed_source(number), str(ROOT / number.path)

        class Loader(importlib.machinery.SourceFileLoader):
            def get_code(self, fullname: str) -> Any:
                return compile(tree, path, "exec", dont_inherit=True)

            def exec_module(self, module: Any) -> None:
                module.__dict__["__scaled__"] = lambda value: scaled(value, factor)
                super().exec_module(module)

        self._loader = Loader(number.module, path)

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        if fullname != self._number.module:
            return None
        return importlib.util.spec_from_file_location(fullname, ROOT / self._number.path, loader=self._loader)


# The shots


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Item:
    """A shot, its rig and its truth."""

    shot: Shot
    rig: Rig
    truth: Truth
    paper: bool = False
    """Whether its ends are those of the paper's line detector."""
    tracked: bool = False


def truth_of_rig_b(name: str) -> Truth:
    """The truth of a shot of rig B."""
    truths = read_truths(SHARED / "rendered" / "rig_b" / "truth.jsonl")
    return next(truth for truth in truths if truth.shot == name)


def items(*, wide: bool) -> list[Item]:
    """The shots, decoded: some of each kind, or all."""
    chosen: list[Item] = []
    for name in ALL:
        folder = SHARED / "rendered" / name
        rig, truths = (
            read_rig(folder / "rig.yaml"),
            {truth.shot: truth for truth in read_truths(folder / "truth.jsonl")},
        )
        for path in sorted((folder / "shots").glob("*.npz")):
            if wide or path.stem in SOME[name] or (name == "moving_b" and path.stem in TRACKED):
                item = Item(shot=read_shot(path), rig=rig, truth=truths[path.stem])
                chosen.append(replace(item, tracked=path.stem in TRACKED))
    by_name = {item.shot.name: item for item in chosen}
    if not wide:  # with a ghost only
        item = by_name["B_z1000_p05_dim"]
        path = SHARED / "rendered" / "rig_b" / "shots" / "B_z0500_p05_strong.npz"
        by_name["B_z0500_p05_strong"] = replace(item, shot=read_shot(path), truth=truth_of_rig_b("B_z0500_p05_strong"))
    ghostly = ("B_z0500_p05_strong", "B_z0500_p01_dim", "B_z1000_p05_dim")[: 3 if wide else 1]
    for name in ghostly:
        for ratio, rows in GHOSTS[: 2 if wide else 1]:
            item = by_name[name]
            chosen.append(replace(item, shot=with_ghost(item.shot, ratio, rows)))
    for name in ("B_z0500_p01_dim", "B_z0300_p00_normal")[: 2 if wide else 1]:
        chosen.append(replace(by_name[name], paper=True))
    return [*chosen, *photographs(by_name["B_z0500_p01_dim"].rig, wide=wide)]


def photographs(rig: Rig, *, wide: bool) -> Iterator[Item]:
    """Photographs without a ring, as shots with all lasers on."""
    images = sorted((SHARED / "real" / "yorkurban" / "images").glob("*.jpg"))
    for path in images if wide else [path for path in images if path.stem in PHOTOGRAPHS]:
        height, width = rig.camera.image_height, rig.camera.image_width
        photograph = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert photograph is not None, path
        image = cv2.resize(photograph, (width, height))
        shot = Shot(
            name=path.stem,
            images=image[None],
            lasers=np.array([7], np.uint8),
            stamp_s=np.zeros(1),
            exposure_s=np.zeros(1),
        )
        yield Item(shot=shot, rig=rig, truth=Truth(shot=path.stem, expect="no_target"))


# What is measured


def outcome(chosen: Sequence[Item], detected: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The lines of the shots in a few numbers, by shot, and the processor time of the detections in seconds.

    `detected`: an outcome that is taken over for shots with the same detection, by a number that only detects.
    """
    from ringpose.bench.score import estimate_of, score
    from ringpose.measure.stream import Setup, Stream, track_options
    from ringpose.types.assumptions import USUAL
    from ringpose.types.options import Method

    streams: dict[int, Stream] = {}
    time_s, shots, digests = 0.0, {}, {}
    for number, item in enumerate(chosen):
        name = f"{number} {item.shot.name}"
        setup = Setup(rig=item.rig, method=Method.PAPER_DETECTOR if item.paper else Method.ML)
        if item.tracked:
            stream = streams.setdefault(id(item.rig), Stream(setup, track_options(USUAL)))
            line = stream.measure(item.shot).line
        else:
            start_s = time.process_time()
            detection = setup.detection(item.shot)
            time_s += time.process_time() - start_s
            digests[name] = hashlib.sha256(pickle.dumps(detection)).hexdigest()
            if detected is not None and detected["digests"][name] == digests[name]:
                shots[name] = detected["shots"][name]
                continue
            line = setup.measure(item.shot) if item.paper else setup.measure(detection)
        judged = score(item.truth, estimate_of(line, ""), "x", item.rig.camera)
        pose = line.pose
        row: dict[str, Any] = {"status": str(line.status), "flags": int(line.flags), "reason": line.reason}
        row |= {"wrong": list(judged.wrong), "gross": list(judged.gross)}
        if pose is not None:
            row |= {"center": pose.center_m.tolist(), "normal": pose.normal.tolist(), "grasp": pose.grasp_m.tolist()}
            row["sd"] = np.sqrt(np.diag(pose.covariance)).tolist() if pose.covariance is not None else None
            row["sd_grasp"] = (
                math.sqrt(float(np.diag(pose.covariance_grasp_m2).max()))
                if pose.covariance_grasp_m2 is not None
                else None
            )
            row["sd_center"] = (
                math.sqrt(float(np.diag(pose.covariance_center_m2).max()))
                if pose.covariance_center_m2 is not None
                else None
            )
            row["errors"] = {name: value for name, value in judged.errors.items() if name in ERRORS}
        shots[name] = row
    return {"shots": shots, "digests": digests, "time_s": time_s}


ERRORS = ("center_m", "normal_rad", "grasp_m")


def in_child(
    chosen: Sequence[Item], number: Number | None, factor: float, reference: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The outcome with a number scaled, in a forked process; an `error` if there is none."""
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(TIME_LIMIT_S)
        try:
            if number is not None:
                sys.meta_path.insert(0, ChangedModule(number, factor))
            detects = number is not None and not number.module.startswith("ringpose.estimate")
            result = outcome(chosen, reference if detects else None)
        except BaseException as error:
            result = {"error": f"{type(error).__name__}: {error}"[:200]}
        with os.fdopen(sender, "w") as stream:
            json.dump(result, stream)
        os._exit(0)
    os.close(sender)
    with os.fdopen(receiver) as stream:
        text = stream.read()
    os.waitpid(child, 0)
    return json.loads(text) if text else {"error": "ended"}


def summary(result: Mapping[str, Any], reference: Mapping[str, Any]) -> dict[str, Any]:
    """What an outcome has in other numbers than the reference."""
    if "error" in result:
        return dict(result)
    shots, before = result["shots"], reference["shots"]
    moved = {name: _moved(before[name], shots[name]) for name in shots}
    changed = sorted(name for name, sigmas in moved.items() if sigmas >= CHANGED_SIGMAS)
    return {
        "poses": sum("center" in row for row in shots.values()),
        "ok": sum(row["status"] == "ok" for row in shots.values()),
        "wrong": sum(bool(row["wrong"]) for row in shots.values()),
        "gross": sum(bool(row["gross"]) for row in shots.values()),
        "new_wrong": sorted(name for name in shots if set(shots[name]["wrong"]) - set(before[name]["wrong"])),
        "touched": sum(sigmas > 0.0 for sigmas in moved.values()),
        "changed": [f"{name}: {_step(before[name], shots[name])}" for name in changed],
        **{name: _error_ratio(before, shots, name) for name in ERRORS},
        "time": round(result["time_s"] / reference["time_s"], 2),
    }


def _moved(before: Mapping[str, Any], after: Mapping[str, Any]) -> float:
    """By how many sigmas a line has moved; infinitely far with another status, flag or reason."""
    if any(before[key] != after[key] for key in ("status", "flags", "reason")) or ("center" in before) != (
        "center" in after
    ):
        return 1e9
    if "center" not in before:
        return 0.0
    away = [0.0]
    for key, sd in (("center", "sd_center"), ("grasp", "sd_grasp")):
        off = np.abs(np.subtract(before[key], after[key])).max()
        if before[sd]:
            away.append(float(np.nan_to_num(off / before[sd])))
    if before["sd"]:
        off = np.linalg.norm(np.subtract(before["normal"], after["normal"]))
        away.append(float(np.nan_to_num(off / max(before["sd"][:2]))))
    return max(away)


def _step(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """How a line has changed, in a word."""
    if before["status"] != after["status"]:
        return f"{before['status']} -> {after['status']}"
    return (
        "flags" if before["flags"] != after["flags"] else "reason" if before["reason"] != after["reason"] else "moved"
    )


def _error_ratio(before: Mapping[str, Any], after: Mapping[str, Any], name: str) -> float:
    """The ratio of the errors of a quantity, as the mean of its logarithm over the shots that have it in both."""
    logs = [
        math.log((after[shot]["errors"][name] + 1e-9) / (before[shot]["errors"][name] + 1e-9))
        for shot in before
        if name in before[shot].get("errors", {})
        and name in after[shot].get("errors", {})
        and all(math.isfinite(rows[shot]["errors"][name]) for rows in (before, after))
    ]
    return round(math.exp(float(np.mean(logs))), 3) if logs else math.nan


def is_idle(row: Mapping[str, Any]) -> bool:
    """Whether a number changes nothing, neither halved nor doubled."""
    return all("error" not in each and not each["changed"] for each in row["by_factor"].values())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", action="append", choices=FOLDERS, help="numbers of this folder only")
    parser.add_argument("--only", action="append", help="numbers whose names contain this")
    parser.add_argument("--wide", action="store_true", help="all shots, for the numbers that change nothing on some")
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args()
    options.results.parent.mkdir(exist_ok=True)
    rows = [json.loads(line) for line in options.results.read_text().splitlines()] if options.results.exists() else []
    done = {(row["number"], row["wide"]): row for row in rows}
    chosen = items(wide=options.wide)
    reference = in_child(chosen, None, 1.0)
    if "error" in reference:
        sys.exit(f"ablation: nothing changed: {reference['error']}")
    print(json.dumps({"reference": summary(reference, reference)}), flush=True)
    with options.results.open("a") as stream:
        numbers = list(named_numbers(options.folder or FOLDERS))
        if options.only:
            numbers = list(dict.fromkeys(each for word in options.only for each in numbers if word in str(each)))
        for number in numbers:
            narrow = done.get((str(number), False))
            if options.wide and narrow is not None and not is_idle(narrow):
                continue
            row = done.get((str(number), options.wide))
            if row is None:
                by_factor = {
                    str(factor): summary(in_child(chosen, number, factor, reference), reference) for factor in FACTORS
                }
                row = {"number": str(number), "wide": options.wide, "by_factor": by_factor}
                stream.write(json.dumps(row) + "\n")
                stream.flush()
            print(line_of(row), flush=True)


def line_of(row: Mapping[str, Any]) -> str:
    """A row of the table."""
    cells = [
        each["error"][:40]
        if "error" in each
        else f"{each['poses']:3} {each['ok']:3} {each['wrong']:2}/{each['gross']} {each['touched']:3} "
        f"{len(each['changed']):3} {each['center_m']:6.3f} {each['normal_rad']:6.3f} {each['grasp_m']:6.3f} "
        f"{each['time']:5.2f}"
        for each in row["by_factor"].values()
    ]
    return f"{row['number']:60} | " + " | ".join(cells)


if __name__ == "__main__":
    main()
