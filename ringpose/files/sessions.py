"""Session folders: `session.yaml` beside one NPZ a shot."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, cast, get_args

from ringpose.errors import CannotCreateError, DataError
from ringpose.files.atomic import make_folder, output_error, replacing
from ringpose.files.fields import Fields
from ringpose.files.provenance import provenance, sha256
from ringpose.files.shots import write_shot
from ringpose.files.yaml import read_yaml, write_yaml
from ringpose.types.frame import Shot
from ringpose.types.sequence import MOST_LASERS
from ringpose.types.session import Capture, CaptureState, Session

SCHEMA = "session/1"

FILE = "session.yaml"

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
    """A session that is being captured: whatever ends the block, the finished shots and `session.yaml` stay valid."""

    def __init__(self, folder: Path, capture: Capture, existing: Existing = "refuse") -> None:
        self.folder = folder
        self._capture = capture
        self._existing = existing
        self._earlier: tuple[Capture, ...] = ()
        self.names: set[str] = set()
        """Of the shots that lie in the folder."""
        self._shots: list[str] = []
        self._inputs: dict[str, str] = {}

    def __enter__(self) -> None:
        self._take_over()
        self.names = {path.stem for path in make_folder(self.folder).glob("*.npz")}
        self._capture = replace(self._capture, provenance=provenance([]))
        self._write("capturing")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None and not self._shots and not self._earlier:
            self._remove()
        else:
            self._write("finished" if error is None else "stopped")

    def add(self, shot: Shot) -> Path:
        """Write a shot and return the path of its file; a name that the session has already is bad data."""
        if shot.name in self.names:
            raise DataError(shot.name, f"{self.folder} has a shot of this name already", "give each shot its own name")
        path = self.folder / f"{shot.name}.npz"
        write_shot(path, shot)
        self.names.add(shot.name)
        self._shots.append(shot.name)
        return path

    def name_camera(self, name: str | None) -> None:
        """What the camera calls itself, which it says only when it is open."""
        self._capture = replace(self._capture, camera_name=name)
        self._write("capturing")

    def read_from(self, path: Path) -> None:
        """Remember an input by its hash."""
        self._inputs[str(path)] = sha256(path)

    def _take_over(self) -> None:
        """See to what is in the folder already."""
        if self._is_free():
            return
        if self._existing == "refuse":
            remedy = "add --append to go on with it, or --force to replace it"
            raise CannotCreateError(str(self.folder), "exists already", remedy)
        if not (self.folder / FILE).exists():
            raise CannotCreateError(str(self.folder), f"has no {FILE}, so it is no session", "choose another --output")
        earlier = read_session(self.folder)
        there = sorted(self.folder.glob("*.npz"))
        if self._existing == "append":
            unlisted = [path.stem for path in there if path.stem not in earlier.shots]
            self._earlier = tuple(_closed(capture, unlisted) for capture in earlier.captures)
        else:
            for path in there:
                path.unlink()

    def _remove(self) -> None:
        """A session that broke off before its first shot leaves nothing behind, so that it may simply be begun anew."""
        (self.folder / FILE).unlink(missing_ok=True)
        with suppress(OSError):  # other files of the user's
            self.folder.rmdir()

    def _is_free(self) -> bool:
        """Whether the folder is not there yet, or empty."""
        try:
            return not self.folder.exists() or (self.folder.is_dir() and not any(self.folder.iterdir()))
        except OSError as error:
            raise output_error(self.folder, error) from error

    def _write(self, state: CaptureState) -> None:
        noted = {**self._capture.provenance, "inputs": self._inputs}
        current = replace(self._capture, state=state, shots=tuple(self._shots), provenance=noted)
        write_session(self.folder, Session(captures=(*self._earlier, current)))


def _closed(capture: Capture, unlisted: Iterable[str]) -> Capture:
    """A capture that was cut off has the shots that no list names."""
    return replace(capture, state="stopped", shots=tuple(unlisted)) if capture.state == "capturing" else capture


def _capture(fields: Fields) -> Capture:
    return Capture(
        camera=fields.text("camera"),
        camera_name=fields.text("camera_name") if fields.has("camera_name") else None,
        lasers=fields.text("lasers"),
        laser_count=fields.integer("laser_count", least=1, most=MOST_LASERS) if fields.has("laser_count") else None,
        laser_names=fields.texts("laser_names") if fields.has("laser_names") else None,
        sequence=fields.text("sequence") if fields.has("sequence") else None,
        exposure_s=fields.number("exposure_s", least=0) if fields.has("exposure_s") else None,
        rate_hz=fields.number("rate_hz", least=0) if fields.has("rate_hz") else None,
        state=cast(CaptureState, fields.choice("state", get_args(CaptureState))),
        shots=fields.texts("shots"),
        provenance=fields.fields("provenance").values if fields.has("provenance") else {},
    )


def _record(capture: Capture) -> dict[str, Any]:
    values = {key: value for key in _KEYS if (value := asdict(capture)[key]) is not None}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}
