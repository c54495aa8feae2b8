"""Session folders: `session.yaml` beside one NPZ a shot."""

import tempfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

from ringpose.errors import CannotCreateError, DataError, RingposeError
from ringpose.files.atomic import make_folder, output_error, replacing
from ringpose.files.provenance import provenance, sha256
from ringpose.files.schema import Fields
from ringpose.files.shots import write_shot
from ringpose.files.yaml import read_yaml, write_yaml
from ringpose.types.image import Shot
from ringpose.types.sequence import MAX_LASERS
from ringpose.types.session import Capture, CaptureState, Session

if TYPE_CHECKING:
    from filelock import BaseFileLock

SCHEMA = "session/1"

FILE = "session.yaml"

LOCK = ".lock"
"""Held while a capture writes into the folder."""

ASIDE = ".*.part"
"""What a process that was killed while it wrote a file leaves behind."""

Existing = Literal["refuse", "replace", "append"]
"""What to do with a folder that is there already."""

_KEYS = (
    "camera",
    "camera_name",
    "lasers",
    "laser_count",
    "laser_names",
    "sequence",
    "exposure_s",
    "rate_hz",
    "state",
    "shots",
    "provenance",
)


def folder_of_now() -> Path:
    """`session-20260101T000000Z`, in the working directory."""
    return Path(f"session-{datetime.now(UTC):%Y%m%dT%H%M%SZ}")


def read_session(folder: Path) -> Session:
    """The session in a folder; that its shots are there is for their reader to see."""
    fields = read_yaml(folder / FILE, ("ringpose", "captures"))
    fields.choice("ringpose", (SCHEMA,))
    return Session(captures=tuple(_capture(each) for each in fields.each("captures", _KEYS)))


def write_session(folder: Path, session: Session) -> None:
    """Write `session.yaml`, in the place of the one that is there."""
    captures = [_record(capture) for capture in session.captures]
    with replacing(folder / FILE, force=True) as stream:
        write_yaml(stream, {"ringpose": SCHEMA, "captures": captures})


class SessionWriter:
    """A session that is being captured: whatever ends the block, the finished shots and `session.yaml` stay valid.

    Nothing that lies in the folder is touched before there is a shot to take its place, and nobody else may write into
    it meanwhile.
    """

    def __init__(self, folder: Path, capture: Capture, existing: Existing = "refuse") -> None:
        self.folder = folder
        self._capture = capture
        self._existing = existing
        self._earlier: tuple[Capture, ...] = ()
        self._outdated: tuple[Path, ...] = ()
        """Shots of the session that this one replaces."""
        self.names: set[str] = set()
        """Of the shots that lie in the folder."""
        self._shots: list[str] = []
        self._inputs: dict[str, str] = {}
        self._has_begun = False

    def __enter__(self) -> None:
        is_free = self._is_free()
        if not is_free:
            self._refuse()
        self._lock = _locked(make_folder(self.folder))
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
            if error is None:
                self._begin()
                self._write("finished")
            elif self._has_begun:
                with suppress(RingposeError):  # what has ended the capture is worth more than why it cannot be noted
                    self._write("stopped")
        finally:
            self._unlock()
            if not self._has_begun:
                with suppress(OSError):  # not empty: an earlier session, or files of the user's
                    self.folder.rmdir()

    def add(self, shot: Shot) -> Path:
        """Write a shot and return the path of its file; a name that the session has already is bad data."""
        if shot.name in self.names:
            raise DataError(shot.name, f"{self.folder} has a shot of this name already", "give each shot its own name")
        self._begin()
        path = self.folder / f"{shot.name}.npz"
        write_shot(path, shot)
        self.names.add(shot.name)
        self._shots.append(shot.name)
        return path

    def name_camera(self, name: str | None) -> None:
        """What the camera calls itself, which it says only when it is open."""
        self._capture = replace(self._capture, camera_name=name)

    def read_from(self, path: Path) -> None:
        """Remember an input by its hash."""
        self._inputs[str(path)] = sha256(path)

    def _refuse(self) -> None:
        """What is there may have to stay as it is."""
        if self._existing == "refuse":
            remedy = "add --append to go on with it, or --force to replace it"
            raise CannotCreateError(str(self.folder), "exists already", remedy)
        if not (self.folder / FILE).exists():
            raise CannotCreateError(str(self.folder), f"has no {FILE}, so it is no session", "choose another --output")

    def _take_over(self, is_free: bool) -> None:
        """See to what is in the folder already; that it can be written to shows at once."""
        try:
            with tempfile.TemporaryFile(dir=self.folder):
                pass
        except OSError as error:
            raise output_error(self.folder, error) from error
        for path in self.folder.glob(ASIDE):
            path.unlink(missing_ok=True)
        there = sorted(self.folder.glob("*.npz"))
        earlier = () if is_free else read_session(self.folder).captures
        listed = {shot for capture in earlier for shot in capture.shots}
        unlisted = [path.stem for path in there if path.stem not in listed]
        closed = tuple(_closed(capture, unlisted) for capture in earlier)
        if self._existing == "append":
            self._earlier = closed
        else:
            replaced = {shot for capture in closed for shot in capture.shots}
            self._outdated = tuple(path for path in there if path.stem in replaced)
        self.names = {path.stem for path in there if path not in self._outdated}

    def _begin(self) -> None:
        """Before the first shot: the session that is replaced goes, and `session.yaml` says who is at work."""
        if self._has_begun:
            return
        for path in self._outdated:
            path.unlink(missing_ok=True)
        self._write("capturing")
        self._has_begun = True

    def _is_free(self) -> bool:
        """Whether the folder is not there yet, or empty."""
        try:
            return not self.folder.exists() or (
                self.folder.is_dir() and all(path.name == LOCK for path in self.folder.iterdir())
            )
        except OSError as error:
            raise output_error(self.folder, error) from error

    def _unlock(self) -> None:
        """Remove the lock file before the lock is released: whoever opened it meanwhile notices and opens it anew."""
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
        found = "another capture is writing into it"
        raise CannotCreateError(str(folder), found, "end that first, or choose another output") from error
    except OSError:  # a file system without locks; if the folder is read-only, the writer reports that next
        pass
    return lock


def _closed(capture: Capture, unlisted: Iterable[str]) -> Capture:
    """A capture that was cut off has the shots that no list names."""
    return replace(capture, state="stopped", shots=tuple(unlisted)) if capture.state == "capturing" else capture


def _capture(fields: Fields) -> Capture:
    return Capture(
        camera=fields.text("camera"),
        camera_name=fields.text("camera_name") if fields.has("camera_name") else None,
        lasers=fields.text("lasers"),
        laser_count=fields.integer("laser_count", least=1, most=MAX_LASERS) if fields.has("laser_count") else None,
        laser_names=fields.texts("laser_names") if fields.has("laser_names") else None,
        sequence=fields.text("sequence") if fields.has("sequence") else None,
        exposure_s=fields.number("exposure_s", least=0) if fields.has("exposure_s") else None,
        rate_hz=fields.number("rate_hz", least=0) if fields.has("rate_hz") else None,
        state=cast(CaptureState, fields.choice("state", get_args(CaptureState))),
        shots=fields.texts("shots"),
        provenance=fields.fields("provenance").values if fields.has("provenance") else {},
    )


def _record(capture: Capture) -> dict[str, Any]:
    values = asdict(capture)
    said = {key: values[key] for key in _KEYS if values[key] is not None}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in said.items()}
