"""Files that are whole or not there: written aside, then renamed."""

import errno
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ringpose.errors import CannotCreateError, InputOutputError, RingposeError

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


@contextmanager
def replacing(path: Path, force: bool) -> Iterator[IO[bytes]]:
    """A file to write into that takes the place of `path` when the block ends well, and vanishes if it does not.

    A symbolic link stays: what it points to is replaced.
    """
    import tempfile  # here, because commands that only read import this module too

    refuse_existing(path, force)
    try:
        target = path.resolve()
        handle, aside = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part")
    except OSError as error:
        raise output_error(path, error) from error
    try:
        with os.fdopen(handle, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        Path(aside).chmod(0o666 & ~_umask())
        Path(aside).replace(target)
    except BaseException as error:
        Path(aside).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise output_error(path, error) from error
        raise


def refuse_existing(path: Path, force: bool) -> None:
    """Refuse an output that exists already, unless it may be replaced; before long work, this tells it in time.

    A folder, a device or a pipe is never replaced; nor is there an output in a folder that does not exist.
    """
    try:
        path.parent.stat()
        if not stat.S_ISREG(path.stat().st_mode):
            raise CannotCreateError(str(path), "is a folder, a device or a pipe, no file", "choose another output")
    except FileNotFoundError as error:
        if not path.parent.is_dir():
            raise output_error(path, error) from error
        return
    except OSError as error:
        raise output_error(path, error) from error
    if not force:
        raise CannotCreateError(str(path), "exists already", "add --force to replace it")


def refuse_inputs(outputs: Iterable[Path | None], read: Iterable[Path]) -> None:
    """Refuse outputs that are read as well, by whatever name: no wish to replace them means that."""
    there = {_identity(output): output for output in outputs if output is not None}
    for identity in map(_identity, read):
        if identity is not None and identity in there:
            raise CannotCreateError(str(there[identity]), "is an input, too", "choose another output")


def make_folder(path: Path) -> Path:
    """The folder, made if need be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(path, error) from error
    return path


def output_error(path: Path | str, error: OSError) -> RingposeError:
    """What an operating-system error on an output means to the user."""
    reason = (error.strerror or str(error)).lower()
    if error.errno in _FULL:
        return InputOutputError(str(path), f"writing broke off: {reason}", "free space and run again")
    return CannotCreateError(str(path), f"cannot be written: {reason}", "choose another output")


def _identity(path: Path) -> tuple[int, int] | None:
    """What a file is, whatever its name; None if it is not there, or cannot be seen."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
