"""Session folders: `session.yaml` and one NPZ file per shot."""

import tempfile
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Literal

from ringpose.errors import CannotCreateError, DataError, RingposeError
from ringpose.files.atomic import make_folder, output_error, replacing
from ringpose.files.images.shots import write_shot
from ringpose.files.io import provenance, sha256
from ringpose.files.records.codec import RecordType
from ringpose.files.schema import SESSION
from ringpose.files.yaml import read_yaml, write_yaml
from ringpose.types.image import Shot
from ringpose.types.session import SESSION_FILE, Capture, CaptureState, Session

if TYPE_CHECKING:
    from filelock import BaseFileLock

RECORD = RecordType(
    cls=Session,
    kind=SESSION,
    version="session/1",
    description="session.yaml: the captures in a session folder, the oldest first, and the shots of each.",
    is_file=True,
    strict=True,
)

LOCK = ".lock"
"""Lock file, held while a capture writes into the folder."""

TEMPORARY_FILES = ".*.part"
"""Pattern of the temporary files that a killed process leaves behind."""

Existing = Literal["refuse", "replace", "append"]
"""What to do with a folder that exists already."""


def folder_of_now() -> Path:
    """The default name, such as `session-20260101T000000Z`, in the working directory."""
    return Path(f"session-{datetime.now(UTC):%Y%m%dT%H%M%SZ}")


def read_session(folder: Path) -> Session:
    """The session in a folder; whether its shots exist is checked when they are read."""
    fields = read_yaml(folder / SESSION_FILE)
    return RECORD.read(fields.values, fields.file)


def write_session(folder: Path, session: Session) -> None:
    """Write `session.yaml`, replacing an existing one."""
    with replacing(folder / SESSION_FILE, force=True) as stream:
        write_yaml(stream, RECORD.write(session))


class SessionWriter:
    """Writes a session while it is captured; the shots and `session.yaml` stay valid however the block ends.

    The folder is locked against other captures. A session that never gets a shot leaves nothing behind: neither a
    folder of its own, nor a change of the session that it continues or replaces.
    """

    def __init__(self, folder: Path, capture: Capture, existing: Existing = "refuse") -> None:
        self.folder = folder
        self._capture = capture
        self._existing = existing
        self._earlier: tuple[Capture, ...] = ()
        self._outdated: tuple[Path, ...] = ()
        """Shots of the session that this one replaces."""
        self.names: set[str] = set()
        """Names of the shots in the folder."""
        self._shots: list[str] = []
        self._inputs: dict[str, str] = {}
        self._has_begun = False

    def __enter__(self) -> None:
        is_free = self._is_free()
        make_folder(self.folder)
        if not is_free and self._existing == "refuse":
            remedy = "add --append to go on with it, or --force to replace it"
            raise CannotCreateError(str(self.folder), "exists already", remedy)
        if not is_free and not (self.folder / SESSION_FILE).exists():
            raise CannotCreateError(
                str(self.folder), f"is not a session: it has no {SESSION_FILE}", "choose another --output"
            )
        self._lock = _locked(self.folder)
        try:
            self._take_over(is_free)
        except BaseException:
            self._unlock()
            raise
        self._capture = replace(self._capture, provenance=provenance([]))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if not self._shots:
                self._undo()
            elif error is None:
                self._write("finished")
            else:
                with suppress(RingposeError):  # the error that ended the capture matters more
                    self._write("stopped")
        finally:
            self._unlock()
            if not self._shots:
                with suppress(OSError):  # not empty: an earlier session, or files of the user's
                    self.folder.rmdir()

    def add(self, shot: Shot) -> Path:
        """Write a shot and return the path of its file; a name that the session has already is bad data."""
        if shot.name in self.names:
            raise DataError(shot.name, f"{self.folder} has a shot of this name already", "give each shot its own name")
        path = self.folder / f"{shot.name}.npz"
        if not self._has_begun and self._existing != "replace":  # so that a killed capture leaves a valid session
            self._begin()
        write_shot(path, shot, force=path in self._outdated)
        self.names.add(shot.name)
        self._shots.append(shot.name)
        if not self._has_begun:
            self._begin()
        return path

    def name_camera(self, name: str | None) -> None:
        """Set the camera's own name, which is available only after it has been opened."""
        self._capture = replace(self._capture, camera_name=name)

    def read_from(self, path: Path) -> None:
        """Add an input file with its hash to the provenance."""
        self._inputs[str(path)] = sha256(path)

    def _take_over(self, is_free: bool) -> None:
        """Read the existing session, and check that the folder is writable."""
        try:
            with tempfile.TemporaryFile(dir=self.folder):
                pass
        except OSError as error:
            raise output_error(self.folder, error) from error
        for path in self.folder.glob(TEMPORARY_FILES):
            path.unlink(missing_ok=True)
        existing = sorted(self.folder.glob("*.npz"))
        earlier = () if is_free else read_session(self.folder).captures
        listed = {shot for capture in earlier for shot in capture.shots}
        unlisted = [path.stem for path in existing if path.stem not in listed]
        closed = tuple(  # an interrupted capture gets the shots that no capture lists
            replace(capture, state="stopped", shots=tuple(unlisted)) if capture.state == "capturing" else capture
            for capture in earlier
        )
        if self._existing == "append":
            self._earlier = closed
        else:
            replaced = {shot for capture in closed for shot in capture.shots}
            self._outdated = tuple(path for path in existing if path.stem in replaced)
        self.names = {path.stem for path in existing if path not in self._outdated}

    def _begin(self) -> None:
        """Set the state to `capturing`, and remove the shots of a replaced session, which the first new one ends."""
        self._has_begun = True
        self._write("capturing")
        for path in self._outdated:
            if path.stem not in self._shots:
                path.unlink(missing_ok=True)

    def _undo(self) -> None:
        """Without a shot: restore `session.yaml` as it was."""
        if not self._has_begun:
            return
        with suppress(RingposeError, OSError):  # the error that ended the capture matters more
            if self._earlier:
                write_session(self.folder, Session(captures=self._earlier))
            else:
                (self.folder / SESSION_FILE).unlink(missing_ok=True)

    def _is_free(self) -> bool:
        """Whether the folder does not exist yet, or holds nothing but what a capture killed before its first shot left.

        That is at most its lock, temporary files and a `session.yaml` without shots.
        """
        try:
            if not self.folder.exists():
                return True
            if not self.folder.is_dir():
                return False
            left = {path.name for path in self.folder.iterdir() if not path.match(TEMPORARY_FILES)} - {LOCK}
        except OSError as error:
            raise output_error(self.folder, error) from error
        return not left or (left == {SESSION_FILE} and self._has_no_shots())

    def _has_no_shots(self) -> bool:
        """Whether the folder has a valid session without shots."""
        try:
            return not read_session(self.folder).shots
        except RingposeError:
            return False

    def _unlock(self) -> None:
        """Remove the lock file before releasing the lock; a process that has opened it meanwhile opens it again."""
        with suppress(OSError):
            (self.folder / LOCK).unlink()
        self._lock.release()

    def _write(self, state: CaptureState) -> None:
        noted = {**self._capture.provenance, "inputs": self._inputs}
        current = replace(self._capture, state=state, shots=tuple(self._shots), provenance=noted)
        write_session(self.folder, Session(captures=(*self._earlier, current)))


def _locked(folder: Path) -> "BaseFileLock":
    """The lock of a folder; the kernel releases it when the process ends, even if it is killed."""
    from filelock import FileLock, Timeout

    lock = FileLock(folder / LOCK, blocking=False, thread_local=False)
    try:
        lock.acquire()
    except Timeout as error:
        finding = "another capture is writing into it"
        raise CannotCreateError(str(folder), finding, "end that first, or choose another output") from error
    except OSError:  # a file system without locks; if the folder is read-only, the writer reports that next
        pass
    return lock
