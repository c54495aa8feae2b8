"""Prints how the package is cut into modules, and how many of them one measurement passes through (`make structure`).

Sizes are read from the source; the paths of a shot and of a board calibration are traced while `ringpose` runs on the
small data sets in tests/data.
"""

import ast
import io
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "ringpose"
DATA = ROOT / "tests" / "data"
ORDER = ("--laser-order", "right,middle,left")
SHORT_LINES = 60
SHOTS = ("B_z0500_p01_dim", "B_z0500_p01_normal")
"""Two shots of tests/data/rig_b; the second, which is traced, shows the ring's edges in ambient light."""


def main() -> None:
    """Print all tables."""
    modules = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
    print_sizes(modules)
    print_small_modules(modules)
    print_private_functions(modules)
    print_path("the second of two shots through `ringpose pose`", trace_of_shot())
    print_path("`ringpose calibrate-planes` on board shots", trace_of_planes())


def module_name(path: Path) -> str:
    """The dotted name of a module of the package."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def lines_of(path: Path) -> int:
    """Lines of a source file, blank ones and docstrings included."""
    return len(path.read_text().splitlines())


def print_sizes(modules: dict[str, Path]) -> None:
    """Modules and lines by folder, C sources beside them."""
    print(f"{'folder':28}{'modules':>8}{'lines':>8}{'C files':>9}{'C lines':>9}")
    folders = sorted({path.parent for path in [*modules.values(), *PACKAGE.rglob("*.c")]})
    totals = Counter[str]()
    for folder in folders:
        python = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
        sources = [path for pattern in ("*.c", "*.h") for path in folder.glob(pattern)]
        row = {
            "modules": len(python),
            "lines": sum(map(lines_of, folder.glob("*.py"))),
            "C files": len(sources),
            "C lines": sum(map(lines_of, sources)),
        }
        totals.update(row)
        print_row(str(folder.relative_to(ROOT)), row)
    print_row("all", totals)
    print(f"\nlines in all: {totals['lines'] + totals['C lines']}")


def print_row(name: str, row: dict[str, int]) -> None:
    """One folder's numbers in columns."""
    print(f"{name:28}{row['modules']:8}{row['lines']:8}{row['C files']:9}{row['C lines']:9}")


def print_small_modules(modules: dict[str, Path]) -> None:
    """Short modules that a single other module imports: candidates for a merge."""
    importers = defaultdict(set)
    for name, path in modules.items():
        for imported in imported_modules(ast.parse(path.read_text()), modules):
            importers[imported].add(name)
    small = [
        name
        for name, path in modules.items()
        if path.name != "__init__.py" and len(importers[name]) == 1 and lines_of(path) < SHORT_LINES
    ]
    print(f"\nmodules under {SHORT_LINES} lines with a single importer: {len(small)}")
    for name in small:
        print(f"  {name} <- {min(importers[name])}")


def imported_modules(tree: ast.Module, modules: Iterable[str]) -> set[str]:
    """Modules of the package that a source imports, at any depth."""
    known = set(modules)
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return names & known


def print_private_functions(modules: dict[str, Path]) -> None:
    """How many private functions of modules are referenced exactly once."""
    private, once = 0, 0
    for path in modules.values():
        tree = ast.parse(path.read_text())
        uses = Counter(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))
        names = [node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("_")]
        private += len(names)
        once += sum(uses[name] == 1 for name in names)
    print(f"\nprivate functions: {private}, referenced once: {once}")


def trace_of_shot() -> list[str]:
    """The module of each call while a lit shot is processed after another one: up to its line on stdout."""
    shots = [str(DATA / "rig_b" / "shots" / f"{name}.npz") for name in SHOTS]
    output = io.StringIO()
    arguments = ["pose", *shots, "--rig", str(DATA / "rig_b" / "rig.yaml"), "--quiet"]
    return trace(arguments, output, wanted=lambda: output.getvalue().count("\n") == 1)


def trace_of_planes() -> list[str]:
    """The module of each call during a calibration of the light planes after another one, which imports the modules."""
    board = DATA / "calib_b"
    shots = sorted(map(str, (board / "planes").glob("*.npz")))
    with tempfile.TemporaryDirectory() as folder:
        known = ["--board", str(board / "plane_board.yaml"), "--camera", str(DATA / "rig_b" / "rig.yaml")]
        rig = str(Path(folder) / "rig.yaml")
        words = ["calibrate-planes", *shots, *known, *ORDER, "--output", rig, "--quiet", "--force"]
        run(words, io.StringIO())
        return trace(words, io.StringIO())


def run(arguments: Sequence[str], output: io.StringIO) -> None:
    """Run one command line of ringpose; its messages are dropped unless it fails."""
    from ringpose.cli.main import main as ringpose

    messages = io.StringIO()
    with redirect_stdout(output), redirect_stderr(messages):
        status = ringpose(arguments)
    if status not in (0, 3):
        raise SystemExit(f"ringpose {' '.join(arguments)}: status {status}\n{messages.getvalue()}")


def trace(arguments: Sequence[str], output: io.StringIO, wanted: Callable[[], bool] = lambda: True) -> list[str]:
    """The module of each Python function of the package that is entered, in order, while `wanted` holds."""
    entered: list[str] = []
    prefix = str(PACKAGE)

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(prefix) and wanted():
            entered.append(str(frame.f_globals["__name__"]))

    sys.setprofile(note)
    try:
        run(arguments, output)
    finally:
        sys.setprofile(None)
    return entered


def print_path(title: str, entered: Sequence[str]) -> None:
    """Modules and switches of a trace, and the modules in the order of their first entry."""
    order = list(dict.fromkeys(entered))
    pairs = switches(entered)
    print(f"\n{title}: {len(entered)} calls, {len(order)} modules, {len(pairs)} switches, ", end="")
    print(f"{without_loops(pairs)} with alternations of one pair counted once")
    print("  " + " > ".join(name.removeprefix("ringpose.") for name in order))


def switches(entered: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of modules between which the trace changes."""
    return [(a, b) for a, b in pairwise(entered) if a != b]


def without_loops(pairs: Sequence[tuple[str, str]]) -> int:
    """Number of switches if a run that goes to and fro between the same two modules counts as one."""
    count, last = 0, frozenset[str]()
    for pair in map(frozenset, pairs):
        count += pair != last
        last = pair
    return count


if __name__ == "__main__":
    main()
