"""Prints how the package is cut into modules, and how many of them one measurement passes through (`make structure`).

Sizes are read from the source; the paths of a shot and of a board calibration are traced while `ringpose` runs on the
small data sets in tests/data.
"""

import ast
import io
import re
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path
from types import CodeType, FrameType
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
    sources = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
    trees = {name: ast.parse(path.read_text()) for name, path in sources.items()}
    print_sizes()
    print_c_order()
    print_small_modules(sources, trees)
    print_private_functions(trees)
    print_numbers(trees)
    print_flags(trees)
    print_record_keys()
    of_shot = trace_of_shot()
    print_path("the second of two shots through `ringpose pose`", of_shot)
    print_solves(of_shot)
    print_path("`ringpose calibrate-planes` on board shots", trace_of_planes())


def module_name(path: Path) -> str:
    """The dotted name of a module of the package."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def lines_of(path: Path) -> int:
    """Lines of a source file, blank ones and docstrings included."""
    return len(path.read_text().splitlines())


def print_sizes() -> None:
    """Modules and lines by folder, C sources beside them."""
    columns = ("modules", "lines", "C files", "C lines")
    totals = Counter[str]()
    print(f"{'folder':28}" + "".join(f"{name:>9}" for name in columns))
    for folder in sorted({path.parent for suffix in ("py", "c") for path in PACKAGE.rglob(f"*.{suffix}")}):
        python, sources = list(folder.glob("*.py")), [*folder.glob("*.c"), *folder.glob("*.h")]
        sizes = (sum(map(lines_of, files)) for files in (python, sources))
        modules = sum(path.name != "__init__.py" for path in python)
        row = dict(zip(columns, (modules, next(sizes), len(sources), next(sizes)), strict=True))
        totals.update(row)
        print(f"{folder.relative_to(ROOT)!s:28}" + "".join(f"{row[name]:9}" for name in columns))
    print(f"{'all':28}" + "".join(f"{totals[name]:9}" for name in columns))
    print(f"\nlines in all: {totals['lines'] + totals['C lines']}")


def print_c_order() -> None:
    """The C files in an order in which each calls only files before it."""
    order = TopologicalSorter(c_calls()).static_order()
    print(f"\nC files, each calls only those before it: {', '.join(path.name for path in order)}")


C_DEFINITION = re.compile(r"^(?!static\b|typedef\b|else\b)[A-Za-z_][\w \*]*?\b(\w+)\([^;{]*\) \{", re.MULTILINE)
"""A function that is not static, at its definition; its name."""

C_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


C_CALL = re.compile(r"(?<![\w.>])(\w+)\(")


def c_calls() -> dict[Path, set[Path]]:
    """Of each C file the others whose functions it calls."""
    texts = {path: C_COMMENT.sub("", path.read_text()) for path in sorted(PACKAGE.rglob("*.c"))}
    defined = {name: path for path, text in texts.items() for name in C_DEFINITION.findall(text)}
    called = {path: set(C_CALL.findall(text)) for path, text in texts.items()}
    return {path: {defined[name] for name in called[path] & defined.keys()} - {path} for path in texts}


def print_small_modules(sources: dict[str, Path], trees: dict[str, ast.Module]) -> None:
    """Short modules that a single other module imports: candidates for a merge."""
    importers = defaultdict(set)
    for name, tree in trees.items():
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module, *(f"{node.module}.{each}" for each in names)]
            for imported in names:
                importers[imported].add(name)
    short = {name for name, path in sources.items() if path.name != "__init__.py" and lines_of(path) < SHORT_LINES}
    small = {name: min(importers[name]) for name in sorted(short) if len(importers[name]) == 1}
    print(f"\nmodules under {SHORT_LINES} lines with a single importer: {len(small)}")
    for name, importer in small.items():
        print(f"  {name} <- {importer}")


def print_private_functions(trees: dict[str, ast.Module]) -> None:
    """How many private functions of modules are referenced exactly once."""
    private, once = 0, 0
    for tree in trees.values():
        uses = Counter(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))
        names = [node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("_")]
        private += len(names)
        once += sum(uses[name] == 1 for name in names)
    print(f"\nprivate functions: {private}, referenced once: {once}")


def print_numbers(trees: dict[str, ast.Module]) -> None:
    """How many numbers have a name: constants of modules, and defaults of the fields of classes, by folder."""
    counts = Counter[str]()
    for name, tree in trees.items():
        fields = [node for each in tree.body if isinstance(each, ast.ClassDef) for node in each.body]
        counts[name.split(".")[1] if "." in name else name] += sum(map(named_numbers, [*tree.body, *fields]))
    by_folder = ", ".join(f"{folder} {count}" for folder, count in counts.most_common() if count)
    print(f"\nnamed numbers: {counts.total()} ({by_folder})")


def named_numbers(node: ast.stmt) -> int:
    """The number of names that an assignment gives to numbers; an enumeration's members are none."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return 0
    literals = [each.value for each in ast.walk(node.value) if isinstance(each, ast.Constant)]
    if not any(isinstance(each, int | float) and not isinstance(each, bool) for each in literals):
        return 0
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return sum(len(each.elts) if isinstance(each, ast.Tuple) else 1 for each in targets)


def print_flags(trees: dict[str, ast.Module]) -> None:
    """Modules that decide which flags a line has."""
    deciding = [name for name, tree in trees.items() if decides_flags(tree)]
    print(f"\nmodules that decide flags: {len(deciding)} ({', '.join(deciding)})")


def decides_flags(tree: ast.Module) -> bool:
    """Whether a module sets flags: it names one elsewhere than in a question, a mask or a constant of its own."""
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}

    def is_read(node: ast.AST) -> bool:
        while not isinstance(node, ast.stmt):
            node = parents[node]
            if isinstance(node, ast.Compare) or (isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitAnd)):
                return True
            if isinstance(node, ast.keyword) and node.arg in ("flag", "flags"):
                return False
        return isinstance(node, ast.Assign | ast.AnnAssign) and node in tree.body

    named = (node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name))
    return any(node.value.id == "PoseFlag" and node.attr.isupper() and not is_read(node) for node in named)


def print_record_keys() -> None:
    """In how many places a key of a record is written: its definition, reader and writer, schema, list in the manual.

    Counted are the annotations with a `Key`, texts equal to the key in the modules that read and write records, and
    items of lists in the manual that are not made from the code.
    """
    from ringpose.files.records.codec import definition_of
    from ringpose.files.schemas import RECORDS

    defined, waiting = Counter[str](), [record.cls for record in RECORDS.values()]
    seen: set[type] = set()
    while waiting:
        cls = waiting.pop()
        if cls in seen:
            continue
        seen.add(cls)
        for each in definition_of(cls).attributes:
            defined[each.name] += 1
            waiting += [part.cls for part in each.slot.value.parts]
    records = [path for path in (PACKAGE / "files" / "records").glob("*.py") if path.name != "ros.py"]
    nodes = [node for path in records for node in ast.walk(ast.parse(path.read_text()))]
    others = Counter(node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str))
    page = (ROOT / "man" / "ringpose-records.5").read_text()
    by_hand = re.sub(r"beginning of the table.*?end of the table", "", page, flags=re.DOTALL)
    others.update(
        name for items in re.findall(r"^\.It Va (.*)", by_hand, re.MULTILINE) for name in items.split(" , Va ")
    )
    places = sorted(1 + others[name] for name, classes in defined.items() for _ in range(classes))
    more = ", ".join(f"{name} {1 + others[name]}" for name in sorted(defined) if others[name])
    print(
        f"\nplaces of a key of a record: median {places[len(places) // 2]}, most {places[-1]} ({len(places)} keys",
        end="",
    )
    print(f"; in more than one: {more})" if more else ")")


def trace_of_shot() -> list[CodeType]:
    """The code of each call while a lit shot is processed after another one: up to its line on stdout."""
    shots = [str(DATA / "rig_b" / "shots" / f"{name}.npz") for name in SHOTS]
    output = io.StringIO()
    arguments = ["pose", *shots, "--rig", str(DATA / "rig_b" / "rig.yaml"), "--quiet"]
    return trace(arguments, output, wanted=lambda: output.getvalue().count("\n") == 1)


def trace_of_planes() -> list[CodeType]:
    """The code of each call during a calibration of the light planes after another one, which imports the modules."""
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


def trace(arguments: Sequence[str], output: io.StringIO, wanted: Callable[[], bool] = lambda: True) -> list[CodeType]:
    """The code of each Python function of the package that is entered, in order, while `wanted` holds."""
    entered: list[CodeType] = []
    prefix = str(PACKAGE)

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(prefix) and wanted():
            entered.append(frame.f_code)

    sys.setprofile(note)
    try:
        run(arguments, output)
    finally:
        sys.setprofile(None)
    return entered


def lines_entered(entered: Sequence[CodeType]) -> int:
    """Lines of the functions of a trace; what stands within another function counts with it."""
    functions = {(code.co_filename, code.co_qualname.split(".<locals>")[0]) for code in entered}
    return sum(lines for path in {path for path, _ in functions} for lines in _lengths(path, functions))


def _lengths(path: str, functions: set[tuple[str, str]]) -> Iterator[int]:
    """The number of lines of each of these functions and methods in a source file."""
    body = ast.parse(Path(path).read_text()).body
    methods = [(f"{each.name}.", node) for each in body if isinstance(each, ast.ClassDef) for node in each.body]
    for prefix, node in [*(("", node) for node in body), *methods]:
        if isinstance(node, ast.FunctionDef) and (path, prefix + node.name) in functions:
            yield (node.end_lineno or node.lineno) - node.lineno + 1


def print_path(title: str, calls: Sequence[CodeType]) -> None:
    """Modules and switches of a trace, and the modules in the order of their first entry."""
    entered = [module_name(Path(code.co_filename)) for code in calls]
    order = list(dict.fromkeys(entered))
    pairs = [frozenset(pair) for pair in pairwise(entered) if len(set(pair)) == 2]
    once = sum(pair != before for before, pair in pairwise([frozenset[str](), *pairs]))
    print(f"\n{title}: {len(entered)} calls, {len(order)} modules, {len(pairs)} switches, ", end="")
    print(f"{once} with alternations of one pair counted once, {lines_entered(calls)} lines of functions entered")
    print("  " + " > ".join(name.removeprefix("ringpose.") for name in order))


def print_solves(calls: Sequence[CodeType]) -> None:
    """How often a trace of a shot estimates the ring, and with how many linearised problems, the pose's own apart."""
    names = [code.co_name for code in calls]
    after = names.index("most_likely_pose")
    solves, from_ring = names.count("gauss_newton"), names.count("linearized_at")
    print(f"rings solved from a guess: {solves - from_ring}, iterated from a known ring: {from_ring}")
    of_pose, of_both = names[after:].count("ring_residuals"), names.count("ring_residuals")
    print(f"linearisations of the ring: {of_both - of_pose} in detection, {of_pose} of the pose")


if __name__ == "__main__":
    main()
