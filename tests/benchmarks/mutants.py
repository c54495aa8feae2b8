"""Makes small changes to the package, one at a time, and runs the tests of the changed folder (`make mutants`).

The changes, called mutants, are drawn at random with a fixed seed over the folders that measure. A mutant that fails
no test survives: either it changes nothing that matters, or a test is missing. All runs take place in a copy of the
tree. To compare tests before and after a change of theirs, `--tests REVISION` takes them from that revision.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDERS = ("detect", "estimate", "track", "calibrate", "capture")
COUNT, SEED = 100, 35
TIME_LIMIT_S = 1800
OPPOSITE: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """A changed expression or statement of a module."""

    path: Path
    """From the root."""
    operator: str
    node: ast.expr | ast.stmt
    """What is replaced."""
    text: str
    """What it is replaced by."""

    def __str__(self) -> str:
        old = " ".join(ast.unparse(self.node).split())
        return f"{self.path}:{self.node.lineno} {self.operator}: {old[:60]} -> {' '.join(self.text.split())[:60]}"

    def applied_to(self, source: bytes) -> bytes:
        """The module's text with the change."""
        lines = source.splitlines(keepends=True)
        start = sum(map(len, lines[: self.node.lineno - 1])) + self.node.col_offset
        end = sum(map(len, lines[: (self.node.end_lineno or 0) - 1])) + (self.node.end_col_offset or 0)
        return source[:start] + self.text.encode() + source[end:]


def main() -> None:
    """Run the chosen mutants and print which of them survive; status 3 if one does."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", default="", help="some of the mutants, as 1,2,10-20")
    parser.add_argument("--folder", choices=FOLDERS, action="append", help="those of this folder only")
    parser.add_argument("--list", action="store_true", help="print them and run nothing")
    parser.add_argument("--tests", metavar="REVISION", help="take the tests from this revision of the repository")
    parser.add_argument("--shapes", action="store_true", help="check shapes and types in the first calls of a function")
    chosen = parser.parse_args()
    mutants = dict(enumerate(drawn_mutants(chosen.seed), start=1))
    numbers = [int(n) for part in filter(None, chosen.only.split(",")) for n in _range(part)] or [*mutants]
    folders = chosen.folder or FOLDERS
    mutants = {number: mutants[number] for number in numbers if mutants[number].path.parts[1] in folders}
    if chosen.list:
        for number, mutant in mutants.items():
            print(f"{number:3} {mutant}")
        return
    with tempfile.TemporaryDirectory() as folder:
        tree = copied_tree(Path(folder), chosen.tests)
        for name in sorted({mutant.path.parts[1] for mutant in mutants.values()}):
            if outcome(tree, name, chosen.shapes) != "survived":
                sys.exit(f"mutants: the tests of {name} fail without any change")
        outcomes = {}
        for number, mutant in mutants.items():
            module = tree / mutant.path
            source = module.read_bytes()
            module.write_bytes(mutant.applied_to(source))
            outcomes[number] = outcome(tree, mutant.path.parts[1], chosen.shapes)
            module.write_bytes(source)
            print(f"{number:3} {outcomes[number]:8} {mutant}", flush=True)
    counts = Counter(outcomes.values())
    print(f"{len(outcomes)} mutants: " + ", ".join(f"{count} {name}" for name, count in sorted(counts.items())))
    sys.exit(3 if counts["survived"] else 0)


def _range(part: str) -> range:
    first, _, last = part.partition("-")
    return range(int(first), int(last or first) + 1)


def drawn_mutants(seed: int) -> list[Mutant]:
    """As many of each folder, each operator as likely as any other."""
    generator = random.Random(seed)
    drawn = []
    for folder in FOLDERS:
        modules = sorted((ROOT / "ringpose" / folder).rglob("*.py"))
        possible = [mutant for module in modules for mutant in possible_mutants(module)]
        operators = sorted({mutant.operator for mutant in possible})
        for _ in range(COUNT // len(FOLDERS)):
            operator = generator.choice(operators)
            mutant = generator.choice([each for each in possible if each.operator == operator])
            possible.remove(mutant)
            drawn.append(mutant)
    return drawn


def possible_mutants(module: Path) -> Iterator[Mutant]:
    """All changes of a module, by their places."""
    for node in _code(ast.parse(module.read_text())):
        for operator, changed in _changes(node):
            text = f"({ast.unparse(changed)})" if isinstance(changed, ast.expr) else ast.unparse(changed)
            assert isinstance(node, ast.expr | ast.stmt)
            yield Mutant(path=module.relative_to(ROOT), operator=operator, node=node, text=text)


def _code(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes below one that run: no annotations, no imports, nothing within texts."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr | ast.Import | ast.ImportFrom):
                yield child
                yield from _code(child)


def _changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:  # noqa: C901 - a table
    """What a node can be changed to, by the name of the operator."""
    new: Any = deepcopy(node)
    match node:
        case ast.Compare(ops=[operation]):
            new.ops = [OPPOSITE[type(operation)]()]
            yield "comparison", new
        case ast.BinOp(op=operation) | ast.BoolOp(op=operation) if type(operation) in OPPOSITE:
            new.op = OPPOSITE[type(operation)]()
            yield "sign" if isinstance(node, ast.BinOp) else "condition", new
        case ast.IfExp():
            new.test = ast.UnaryOp(ast.Not(), new.test)
            yield "condition", new
        case ast.UnaryOp(op=ast.Not()):
            yield "condition", new.operand
        case ast.Constant(value=value) if type(value) in (int, float):
            new.value = value * 3 // 2 + (value < 2) if type(value) is int else value * 1.5 or 1.0
            yield "constant", new
        case ast.Return(value=value) if value is not None and ast.unparse(value) != "None":
            new.value = ast.Constant(None)
            yield "return", new
        case ast.Call():
            for kept in combinations(new.keywords, len(new.keywords) - 1) if new.keywords else ():
                yield "argument", ast.Call(new.func, new.args, list(kept))


def copied_tree(folder: Path, revision: str | None) -> Path:
    """A copy of the repository's files with the compiled kernels, beside the shared data."""
    tree = folder / "tree"
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    compiled = [str(path.relative_to(ROOT)) for path in (ROOT / "ringpose").rglob("*.so")]
    for name in [*filter(None, names.split("\0")), *compiled]:
        if (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, tree / name)
    if revision:
        shutil.rmtree(tree / "tests")
        files = subprocess.run(["git", "archive", revision, "tests"], cwd=ROOT, capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x"], cwd=tree, input=files, check=True)
    if (ROOT.parent / "shared").exists():
        (folder / "shared").symlink_to((ROOT.parent / "shared").resolve())
    # by its content, not by its time: two changes may be made within a second
    words = [sys.executable, "-m", "compileall", "-q", "--invalidation-mode", "checked-hash", "ringpose"]
    subprocess.run(words, cwd=tree, check=True)
    return tree


def outcome(tree: Path, folder: str, shapes: bool) -> str:
    """Whether the fast tests of a folder fail (killed), end (survived) or go on for too long (endless)."""
    words = ["-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", f"tests/{folder}"]
    if not shapes:
        words.append("--jaxtyping-packages=")
    environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, *words], cwd=tree, env=environment, capture_output=True, timeout=TIME_LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return "endless"
    return "killed" if done.returncode else "survived"


if __name__ == "__main__":
    main()
