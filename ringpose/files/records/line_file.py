"""A file of lines that has its name once it is complete; until then, the lines are in `NAME.part`."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from ringpose.errors import CannotCreateError, DataError
from ringpose.files import atomic, records


class LineFile:
    """Writes a line at a time; a run that ends early leaves `NAME.part`, which `resume` continues.

    A line that was cut off when its program was killed is removed.
    """

    def __init__(self, path: Path, *, force: bool, resume: bool) -> None:
        atomic.reject_existing(path, force)
        self.path, self.part = path, path.with_name(f"{path.name}.part")
        if self.part.exists() and not (resume or force):
            remedy = "continue that run with --resume, or replace it with --force"
            raise CannotCreateError(str(self.part), "is left of a run that ended early", remedy)
        if self.part.is_symlink() or (self.part.exists() and not self.part.is_file()):
            raise CannotCreateError(str(self.part), "is not a file, must be one", "remove it")
        try:
            self._stream: IO[bytes] = self.part.open("r+b" if resume and self.part.exists() else "w+b")
        except OSError as error:
            raise atomic.output_error(self.part, error) from error

    def earlier(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Location and record of each line that the interrupted run has written; called once, before `write`."""
        end = 0
        for number, line in enumerate(self._stream, start=1):
            if not line.endswith(b"\n"):
                break
            end += len(line)
            yield f"{self.part}:{number}", records.parsed_record(line, f"{self.part}:{number}")
        self._stream.seek(end)
        self._stream.truncate()

    def write(self, record: Mapping[str, Any]) -> None:
        """Append one record."""
        try:
            self._stream.write(records.line_of(record).encode())
            self._stream.flush()
        except OSError as error:
            raise atomic.output_error(self.part, error) from error

    def __enter__(self) -> "LineFile":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the complete file its name; after an exception the lines stay in `NAME.part`."""
        try:
            with self._stream:
                if kind is None:
                    os.fsync(self._stream.fileno())
            if kind is None:
                self.part.replace(self.path)
        except OSError as failed:
            if error is None:
                raise atomic.output_error(self.part, failed) from failed


def not_of_these_inputs(location: str, shot: object) -> DataError:
    """The error that an interrupted run was of other inputs."""
    finding = f"is of the shot {shot!r}, which is not the next of the inputs"
    return DataError(
        location, finding, "resume with the inputs of the interrupted run, or use --force without --resume"
    )
