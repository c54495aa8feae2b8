"""The folder of a study's results: part files while it runs, then one table as CSV and Parquet.

    study.json        what the results are of: hashes of the study and of the code, version, seed, command line
    parts/*.jsonl     finished shots, one a line, {"shot": index, "rows": [...]}; each file is complete or absent
    results.csv       a row for each shot and method, in the order of the shots
    results.parquet   the same, with study.json in the metadata, if pyarrow is installed
    results.lock      exists while a process writes to the folder

A table in Parquet cannot be appended to, and is unreadable without its end: therefore part files.
"""

import csv
import heapq
import io
import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

from ringpose.errors import CannotCreateError, DataError
from ringpose.files import atomic
from ringpose.files.io import read_bytes, write_csv
from ringpose.files.records import line_of, parsed_record, plain
from ringpose.types.study import CASE, INTEGERS, SWITCHES, TEXT_COLUMNS, TEXTS, Row
from ringpose.types.table import Table

ROWS_PER_GROUP = 5_000
"""Rows of a table that are in memory at once while it is written."""


class ResultFolder:
    """A folder of results that this process writes to; see `opened`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.parts = folder / "parts"

    def finished(self, shots: int) -> set[int]:
        """Indices of the shots in the part files; a damaged part, or one of another study, is an error."""
        done: set[int] = set()
        for part in sorted(self.parts.glob("*.jsonl")):
            for number, (index, _) in enumerate(_read_part(part), start=1):
                if not 0 <= index < shots or index in done:
                    finding = f"has shot {index}, which is not one of {shots}, or occurs twice"
                    raise DataError(f"{part}:{number}", finding, "delete the file, its shots are computed again")
                done.add(index)
        return done

    def add(self, shots: Mapping[int, list[Row]]) -> None:
        """Write finished shots as a new part file, complete and on the disk when this returns.

        The rows have plain and finite values, so that they need no conversion, which would take most of the time.
        """
        first, last = min(shots), max(shots)
        name = f"{first:09d}-{last:09d}-{time.time_ns():x}-{os.getpid()}.jsonl"
        with atomic.replacing(self.parts / name, force=False) as stream:
            for index in sorted(shots):
                line = json.dumps({"shot": index, "rows": shots[index]}, allow_nan=False, separators=(",", ":"))
                stream.write(line.encode() + b"\n")

    def rows(self) -> Iterator[Row]:
        """All rows in the order of their shots; memory is needed only for parts whose shots overlap."""
        parts = sorted(self.parts.glob("*.jsonl"), key=lambda part: int(part.name.split("-")[0]))
        waiting: list[tuple[int, list[Row]]] = []
        for part in parts:
            first = int(part.name.split("-")[0])
            while waiting and waiting[0][0] < first:
                yield from heapq.heappop(waiting)[1]
            for entry in _read_part(part):
                heapq.heappush(waiting, entry)
        while waiting:
            yield from heapq.heappop(waiting)[1]

    def write_tables(self, columns: Mapping[str, type], metadata: Mapping[str, Any]) -> list[Path]:
        """Write results.csv, and results.parquet if pyarrow is installed; returns their paths."""
        paths = [self.folder / "results.csv"]
        with atomic.replacing(paths[0], force=True) as stream:
            text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=True)
            rows = ([row.get(name) for name in columns] for row in self.rows())
            write_csv(text, Table(headings=list(columns), rows=rows))
            text.detach()
        if find_spec("pyarrow") is not None:
            paths.append(self.folder / "results.parquet")
            self._write_parquet(paths[1], columns, metadata)
        return paths

    def _write_parquet(self, path: Path, columns: Mapping[str, type], metadata: Mapping[str, Any]) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        types = {int: pa.int64(), float: pa.float64(), bool: pa.bool_(), str: pa.string()}
        schema = pa.schema(
            [(name, types[kind]) for name, kind in columns.items()],
            metadata={"ringpose": json.dumps(plain(metadata))},
        )
        rows = self.rows()
        with atomic.replacing(path, force=True) as stream, parquet.ParquetWriter(stream, schema) as writer:
            while group := list(islice(rows, ROWS_PER_GROUP)):
                writer.write_table(pa.Table.from_pylist(group, schema=schema))


@contextmanager
def opened(folder: Path, metadata: Mapping[str, Any], *, force: bool, wait: bool) -> Iterator[ResultFolder]:
    """The folder for the results of a study, held by this process alone until the block ends.

    `metadata` identify the study: results of another one are an error, or with `force` discarded. If another process
    holds the folder, it is waited for, or named in the error; the lock of another host is never broken.
    """
    from filelock import SoftFileLock, Timeout

    results = ResultFolder(atomic.make_folder(folder))
    lock = SoftFileLock(folder / "results.lock")
    try:
        lock.acquire(timeout=-1 if wait else 0)
    except Timeout:
        holder = _holder(folder / "results.lock")
        raise CannotCreateError(str(folder), f"is in use by {holder}", "wait for it, or give --wait") from None
    except OSError as error:
        raise atomic.output_error(folder, error) from error
    try:
        _prepare(results, metadata, force)
        atomic.make_folder(results.parts)
        for stale in results.parts.glob(".*.part"):  # of a process that was killed while it wrote
            stale.unlink(missing_ok=True)
        yield results
    finally:
        lock.release()


def _prepare(results: ResultFolder, metadata: Mapping[str, Any], force: bool) -> None:
    """Reject or discard results of another study; describe a new study in study.json."""
    description = results.folder / "study.json"
    tables_and_parts = [*results.folder.glob("results.[cp]*"), *results.parts.glob("*")]
    for file in (description, *tables_and_parts) if force else ():
        file.unlink(missing_ok=True)
    if description.exists():
        recorded = parsed_record(read_bytes(description), str(description))
        for key, what in (("study_sha256", "another study"), ("code_sha256", "another version of ringpose")):
            if recorded.get(key) != metadata[key]:
                finding = f"holds results of {what} ({recorded.get('title')}, version {recorded.get('version')})"
                raise DataError(str(results.folder), finding, "choose another folder, or --force to discard them")
        return
    if tables_and_parts and not force:
        finding = "has results without study.json"
        raise CannotCreateError(str(results.folder), finding, "choose another folder, or --force")
    with atomic.replacing(description, force=True) as stream:
        stream.write(line_of(metadata).encode())


def holds_results(path: Path) -> bool:
    """Whether a path is the folder of a study's results, or a table in it."""
    return (path / "study.json").is_file() or path.name == "results.csv"


def read_results(path: Path) -> tuple[dict[str, Any], Iterator[Row]]:
    """The description of a study (study.json) and the rows of its results.csv, in a folder or at the table's path."""
    if path.is_dir():
        path = path / "results.csv"
    description = path.with_name("study.json")
    return parsed_record(read_bytes(description), str(description)), _read_csv(path)


def _holder(lock: Path) -> str:
    """Process, host and start time of a lock file's holder; `?` for a process or host that the file does not name."""
    try:
        lines = lock.read_text(errors="replace").split()
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(lock.stat().st_mtime))
    except OSError:
        return "another process"
    process, host = [*lines, "?", "?"][:2]
    return f"process {process} on {host} since {since}"


def _read_part(part: Path) -> Iterator[tuple[int, list[Row]]]:
    with part.open(encoding="utf-8") as stream:
        for number, line in enumerate(stream, start=1):
            try:
                record = json.loads(line)
                yield int(record["shot"]), list(record["rows"])
            except (ValueError, KeyError, TypeError):
                finding = "is damaged: this line is not a shot"
                raise DataError(f"{part}:{number}", finding, "delete the file, its shots are computed again") from None


def _read_csv(path: Path) -> Iterator[Row]:
    reader = csv.reader(read_bytes(path).decode(errors="replace").splitlines())
    heading = next(reader, [])
    if "shot" not in heading or "method" not in heading:
        raise DataError(str(path), "is not a table of ringpose bench study", "give its results.csv")
    for number, cells in enumerate(reader, start=2):
        if len(cells) != len(heading):
            finding = f"has {len(cells)} cells, must have {len(heading)}"
            raise DataError(f"{path}:{number}", finding, "the file is cut off")
        yield {name: _value(f"{path}:{number}", name, cell) for name, cell in zip(heading, cells, strict=True)}


def _value(place: str, name: str, cell: str) -> str | float | int | bool | None:
    if name in (*TEXT_COLUMNS, *TEXTS, CASE):
        return cell
    if cell == "":
        return None
    if name in SWITCHES:
        return cell == "true"
    try:
        return int(cell) if name in INTEGERS else float(cell)
    except ValueError:
        raise DataError(place, f"{name} is {cell!r}, must be a number") from None
