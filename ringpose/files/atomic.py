"""Atomic writing: a file is written under a temporary name and then renamed, so that it is never incomplete."""

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
    """A stream whose contents replace `path` when the block ends without an exception, and are discarded otherwise.

    If `path` is a symbolic link, its target is replaced.
    """
    import tempfile  # imported here, since commands that only read import this module too

    reject_existing(path, force)
    try:
        target = path.resolve()
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part")
    except OSError as error:
        raise output_error(path, error) from error
    try:
        with os.fdopen(handle, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        mask = os.umask(0)
        os.umask(mask)
        Path(temporary).chmod(0o666 & ~mask)
        Path(temporary).replace(target)
    except BaseException as error:
        Path(temporary).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise output_error(path, error) from error
        raise


def reject_existing(path: Path, force: bool) -> None:
    """Reject an output that exists already, unless `force` is set; commands call this before long computations.

    Folders, devices and pipes are never replaced. The folder of the output must exist.
    """
    try:
        path.parent.stat()
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            kind = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
            raise CannotCreateError(str(path), f"is {kind}, must be a file", "choose another output")
    except FileNotFoundError as error:
        if not path.parent.is_dir():
            raise output_error(path, error) from error
        return
    except OSError as error:
        raise output_error(path, error) from error
    if not force:
        raise CannotCreateError(str(path), "exists already", "add --force to replace it")


def reject_inputs(outputs: Iterable[Path | None], read: Iterable[Path]) -> None:
    """Reject outputs that are also inputs, under any name, even with --force."""
    written = {_identity(output): output for output in outputs if output is not None}
    for identity in map(_identity, read):
        if identity is not None and identity in written:
            raise CannotCreateError(str(written[identity]), "is an input, too", "choose another output")


def make_folder(path: Path) -> Path:
    """The folder, created if necessary."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise CannotCreateError(str(path), "is not a folder, must be one", "choose another output") from error
    except OSError as error:
        raise output_error(path, error) from error
    return path


def output_error(path: Path | str, error: OSError) -> RingposeError:
    """The error to raise if the operating system reports an error on an output."""
    reason = (error.strerror or str(error)).lower()
    if error.errno in _FULL:
        return InputOutputError(str(path), f"writing broke off: {reason}", "free space and run again")
    return CannotCreateError(str(path), f"cannot be written: {reason}", "choose another output")


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and inode number, which identify a file under any name; None if it does not exist or is inaccessible."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino
