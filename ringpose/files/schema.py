"""Validation of the mappings in files and records, key by key, with the location of each error.

What a file or a record is, is recognised by its contents, for messages about one that is given in place of another.
"""

import difflib
import json
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import STAMP_S, Range

FREE_PREFIX = "x_"
"""Prefix of the user's own keys, which are never read and never rejected."""

MAX_VALUE = 1e30
"""Largest absolute value of a number in a file; squares of larger numbers could overflow in later products."""

ROUNDED = 1e-6
"""Tolerance of the length of a unit vector and of the orthogonality of a rotation, for values rounded in a file."""

_UNIT_ROUNDING = 4 * float(np.finfo(np.float64).eps)
"""Largest deviation from 1 of the computed length of a vector of 3 or 4 numbers that was divided by its length."""

MAX_QUATERNION_ERROR = 1e-3
"""Tolerance of the length of a quaternion, of which robots give few digits."""

_TOLERANCE = 1e-9
"""Rounding errors of a correlation matrix: asymmetry, and negative eigenvalues per row."""

Value = TypeVar("Value")


NOT_KNOWN = ("has null or NaN among its numbers", "leave out what is not known")
"""Finding and remedy where numbers are missing, in files of any format."""


class Fields:
    """A mapping with its location, such as `rig.yaml: lasers[1]`; unknown keys are rejected if `known` is given."""

    def __init__(self, file: str, values: object, known: Iterable[str] | None = None, path: str = "") -> None:
        self.file = file
        self.path = path
        if not isinstance(values, Mapping):
            raise DataError(self.location(), f"is {kind(values)}, must be a mapping of keys to values")
        self.values: Mapping[str, Any] = values
        self.known = () if known is None else tuple(known)
        """Valid keys, which are never suggested as the misspelling of another key."""
        if known is not None:
            self.reject_unknown(self.known)

    def location(self, key: str = "") -> str:
        """`rig.yaml: lasers[1].normal`."""
        where = ".".join(part for part in (self.path, key) if part)
        return f"{self.file}: {where}" if where else self.file

    def problem(self, key: str, finding: str, remedy: str = "") -> DataError:
        """The error to raise for this key."""
        return DataError(self.location(key), finding, remedy)

    def has(self, key: str) -> bool:
        """Whether the key is present and not null."""
        return self.values.get(key) is not None

    def given(self, keys: Iterable[str], read: Callable[[str], Value]) -> dict[str, Value]:
        """Values by key, for those of the keys that are present; each is read by `read`."""
        return {key: read(key) for key in keys if self.has(key)}

    def optional(self, key: str, read: Callable[[str], Value]) -> Value | None:
        """The value of a key, read by `read`; None if it is missing or null."""
        return read(key) if self.has(key) else None

    def raw(self, key: str) -> Any:
        """The value as it was read; a missing key or null is rejected."""
        if key not in self.values:
            raise self.missing(key)
        if self.values[key] is None:
            raise self.problem(key, "is null, must have a value")
        return self.values[key]

    def missing(self, key: str) -> DataError:
        """The error to raise for a key that is missing; a similar one that is there may be its misspelling."""
        unknown = [other for other in self.values if isinstance(other, str) and other not in self.known]
        similar = difflib.get_close_matches(key, unknown, n=1)
        remedy = f"did you mean {key!r} instead of {similar[0]!r}?" if similar else ""
        return self.problem("", f"has no key {key!r}", remedy)

    def text(self, key: str) -> str:
        """A string that is not empty."""
        value = self.raw(key)
        if not isinstance(value, str) or not value:
            raise self.problem(key, f"is {kind(value)}, must be a text")
        return value

    def choice(self, key: str, allowed: Iterable[str]) -> str:
        """One of the allowed words."""
        value, words = self.text(key), tuple(allowed)
        if value not in words:
            raise self.problem(key, f"is {value!r}, must be one of {', '.join(words)}", hint(value, words))
        return value

    def boolean(self, key: str) -> bool:
        """True or false."""
        value = self.raw(key)
        if not isinstance(value, bool):
            raise self.problem(key, f"is {kind(value)}, must be true or false")
        return value

    def scalar(self, key: str) -> str | float | int | bool:
        """A text, a finite number, true or false."""
        value = self.values[key]
        if not isinstance(value, str | float | int):
            raise self.problem(key, f"is {kind(value)}, must be a text, a number, true or false")
        if not isinstance(value, str):
            self._check_range(key, value, (-math.inf, math.inf))
        return value

    def integer(self, key: str, least: int | float = -math.inf, most: int | float = math.inf) -> int:
        """A whole number between two bounds, both included."""
        value = self.raw(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.problem(key, f"is {kind(value)}, must be a whole number")
        self._check_range(key, value, (least, most))
        return value

    def number(
        self, key: str, least: int | float = -math.inf, most: int | float = math.inf, missing: float | None = None
    ) -> float:
        """A finite number between two bounds, both included; `missing`, if given, for a key that is absent or null."""
        if missing is not None and not self.has(key):
            return missing
        value = self.raw(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.problem(key, f"is {kind(value)}, must be a number")
        self._check_range(key, value, (least, most))
        return float(value)

    def quantity(self, key: str, plausible: Range) -> float:
        """A number in the range of a quantity."""
        value = self.number(key)
        self.check(key, np.array([value]), plausible)
        return value

    def array(self, key: str, shape: tuple[int | None, ...], allow_nan: bool = False) -> Float64[Array, "..."]:
        """Nested lists of finite numbers as an array; None in `shape` allows any length, null in the lists is NaN."""
        value = self.raw(key)
        expected = " x ".join("n" if length is None else str(length) for length in shape)
        try:
            array = np.array(_numbers(value) if isinstance(value, list) else value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError, RecursionError):
            raise self.problem(key, f"must be {expected} numbers") from None
        if array.size == 0 and not all(shape):
            array = array.reshape([length or 0 for length in shape])
        if array.ndim != len(shape) or any(w not in (None, n) for w, n in zip(shape, array.shape, strict=True)):
            given = " x ".join(map(str, array.shape)) or "one"
            raise self.problem(key, f"has {given} numbers, must have {expected}")
        if not allow_nan and np.isnan(array).any():
            raise self.problem(key, *NOT_KNOWN)
        if finding := unusable(array, allow_nan):
            raise self.problem(key, finding)
        return array

    def vector(self, key: str, length: int) -> Float64[Array, "n"]:
        """A list of `length` finite numbers."""
        return self.array(key, (length,))

    def quantities(self, key: str, length: int, plausible: Range) -> Float64[Array, "n"]:
        """A list of `length` numbers in the range of a quantity."""
        values = self.vector(key, length)
        self.check(key, values, plausible)
        return values

    def sized(self, key: str, plausible: Range) -> Float64[Array, "xyz=3"]:
        """A vector, such as a position, whose length is in the range of a quantity."""
        vector = self.vector(key, 3)
        length = float(np.linalg.norm(vector))
        if not plausible.holds(length):
            finding, remedy = plausible.finding(length)
            raise self.problem(key, f"has a length that {finding}", remedy)
        return vector

    def unit_vector(self, key: str, remedy: str = "") -> Float64[Array, "xyz=3"]:
        """A vector of length 1 within `ROUNDED`, normalised."""
        vector = self.vector(key, 3)
        length = float(np.linalg.norm(vector))
        if abs(length - 1) > ROUNDED:
            raise self.problem(key, f"has length {length:.6g}, must be 1", remedy if length > 0 else "")
        return _normalised(vector, length)

    def quaternion(self, key: str) -> Float64[Array, "xyzw=4"]:
        """A quaternion x, y, z, w of length 1 within `MAX_QUATERNION_ERROR`, normalised."""
        quaternion = self.vector(key, 4)
        length = float(np.linalg.norm(quaternion))
        if abs(length - 1.0) > MAX_QUATERNION_ERROR:
            remedy = "give a unit quaternion x, y, z, w; this looks like degrees" if length > 2.0 else "normalize it"
            raise self.problem(key, f"has length {length:.6g}, must be 1", remedy)
        return _normalised(quaternion, length)

    def check(self, key: str, values: Float64[Array, "..."], plausible: Range) -> None:
        """Reject values outside the range of a quantity; the one that is farthest from zero is named."""
        outside = values[~((values >= plausible.lowest) & (values <= plausible.highest))]
        if outside.size:
            raise self.problem(key, *plausible.finding(float(outside[np.argmax(np.abs(outside))])))

    def schema(self, versions: Collection[str], wanted: "Kind") -> str:
        """The schema of a record, which must be one of the versions; another record is named for what it is."""
        schema = self.values.get("schema")
        if schema is None:
            other = kind_of(self.values)
            if other is None or other is wanted:
                raise self.problem("", "has no key 'schema'", wanted.remedy)
            raise self.problem("", *wanted.instead_of(other))
        if schema not in versions:
            allowed = " or ".join(map(repr, versions))
            raise self.problem("schema", f"is {str(schema)[:60]!r}, must be {allowed}", wanted.remedy)
        return str(schema)

    def stamp_s(self, key: str) -> float:
        """A stamp in seconds, at most that of the year 2100."""
        stamp_s = self.number(key)
        if stamp_s > STAMP_S.highest:
            raise self.problem(key, *late_stamp(stamp_s))
        return stamp_s

    def fields(self, key: str, known: Iterable[str] | None = None) -> "Fields":
        """The mapping at a key."""
        return Fields(self.file, self.raw(key), known, self._below(key))

    def each(self, key: str, known: Iterable[str] | None = None) -> Iterator["Fields"]:
        """The mappings in the list at a key."""
        for name, item in self.listed(key).values.items():
            yield Fields(self.file, item, known, self._below(name))

    def listed(self, key: str) -> "Fields":
        """The items of the list at a key, named `key[0]` and so on."""
        items = self.raw(key)
        if not isinstance(items, list):
            raise self.problem(key, f"is {kind(items)}, must be a list")
        return Fields(self.file, {f"{key}[{number}]": item for number, item in enumerate(items)}, path=self.path)

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of strings."""
        items = self.raw(key)
        if not isinstance(items, list) or not all(isinstance(item, str) for item in items):
            raise self.problem(key, "must be a list of texts")
        return tuple(items)

    def reject_unknown(self, known: tuple[str, ...]) -> None:
        """Reject keys that are neither known nor the user's own (`FREE_PREFIX`)."""
        for key in self.values:
            if not isinstance(key, str):
                raise self.problem("", f"has the key {key!r}, which is not a text")
            if key not in known and not key.startswith(FREE_PREFIX):
                other = None if self.path else in_place_of_another(self.values, known)
                if other is not None:
                    raise self.problem("", *other)
                remedy = hint(key, known) or f"begin it with {FREE_PREFIX} if it is your own"
                raise self.problem("", f"unknown key {key!r}", remedy)

    def _below(self, key: str) -> str:
        return f"{self.path}.{key}" if self.path else key

    def _check_range(self, key: str, value: int | float, bounds: tuple[int | float, int | float]) -> None:
        if value != value or abs(value) == math.inf:
            raise self.problem(key, f"is {value}, must be finite")
        if abs(value) > MAX_VALUE:
            raise self.problem(key, f"is larger than {MAX_VALUE:g}")
        if not bounds[0] <= value <= bounds[1]:
            most = f" and at most {bounds[1]:g}" if bounds[1] < math.inf else ""
            least = f"at least {bounds[0]:g}" if bounds[0] > -math.inf else ""
            raise self.problem(key, f"is {value:g}, must be {least}{most}".replace("be  and", "be"))


def _normalised(vector: Float64[Array, "n"], length: float) -> Float64[Array, "n"]:
    """The unit vector; a vector that was normalised before is unchanged, so that records are read as written."""
    return vector if abs(length - 1) <= _UNIT_ROUNDING else vector / length


def unusable(array: Float64[Array, "..."], allow_nan: bool) -> str:
    """The finding if an array has numbers that are not finite or too large; empty if it has none."""
    if np.isinf(array).any() or (np.isnan(array).any() and not allow_nan):
        return "has a number that is not finite"
    if array.size and np.nanmax(np.abs(array), initial=0.0) > MAX_VALUE:
        return f"has a number larger than {MAX_VALUE:g}"
    return ""


def hint(word: str, known: Iterable[str]) -> str:
    """The remedy `did you mean ...?`, or an empty text if no known word is similar."""
    similar = difflib.get_close_matches(word, list(known), n=1)
    return f"did you mean {similar[0]!r}?" if similar else ""


def kind(value: object) -> str:
    """Description of a value for messages, in the terms of YAML."""
    if value is None:
        return "empty"
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    return f"the text {value[:40]!r}" if isinstance(value, str) else f"{value!r:.40}"


def _numbers(value: object) -> Any:
    """Nested lists with every number as a float, and null as NaN; TypeError for any other value."""
    if isinstance(value, list):
        return [_numbers(item) for item in value]
    if isinstance(value, bool) or not isinstance(value, int | float | None):
        raise TypeError(value)
    return math.nan if value is None else float(value)


def checked_covariance(fields: Fields, key: str, data: Float64[Array, "n n"]) -> Float64[Array, "n n"]:
    """The covariance at a key, made exactly symmetric; rejected unless symmetric and positive semidefinite."""
    variance = np.diag(data)
    if (variance < 0).any():
        raise fields.problem(key, "has a negative variance on its diagonal")
    sigma = np.sqrt(np.where(variance > 0, variance, 1.0))
    correlation = data / np.outer(sigma, sigma)
    if np.abs(correlation - correlation.T).max(initial=0.0) > _TOLERANCE:
        raise fields.problem(key, "is not symmetric")
    if len(data) and np.linalg.eigvalsh(correlation).min() < -_TOLERANCE * len(data):
        raise fields.problem(key, "is not positive semidefinite")
    return (data + data.T) / 2


def late_stamp(stamp_s: float) -> tuple[str, str]:
    """Finding and remedy for a stamp after the year 2100."""
    return f"is {stamp_s:.6g}, which is after the year 2100", "give seconds, not milliseconds or nanoseconds"


class Kind(NamedTuple):
    """A kind of file or record that ringpose reads or writes."""

    name: str
    schema: str
    """Beginning of its key `ringpose` (in YAML) or `schema` (in a record)."""
    keys: frozenset[str]
    """Keys that only this kind has all at its top level."""
    remedy: str
    """What to give where one is needed."""

    def instead_of(self, other: "Kind") -> tuple[str, str]:
        """Finding and remedy if another kind is given."""
        return f"is {other.name}, not {self.name}", self.remedy


CAMERA = Kind(
    "a camera", "camera/", frozenset({"camera_matrix"}), "give a camera.yaml, which ringpose calibrate-camera writes"
)
RIG = Kind("a rig", "rig/", frozenset({"camera", "lasers"}), "give a rig.yaml, which ringpose calibrate-planes writes")
SCENE = Kind("a scene", "scene/", frozenset({"rig", "trajectory"}), "give a scene.yaml (ringpose-simulate(1))")
STUDY = Kind("a study", "study/", frozenset({"vary"}), "give a study.yaml (ringpose-study(5))")
BOARD = Kind("a board", "board/", frozenset({"kind"}), "give a board file (ringpose-conventions(7))")
RINGS = Kind("a catalogue of rings", "rings/", frozenset({"rings"}), "give a catalogue (ringpose-pose(1))")
SESSION = Kind("a session", "session/", frozenset({"captures"}), "give the folder that ringpose capture wrote")
TRUTH = Kind("a truth", "ringpose/truth/", frozenset({"expect"}), "give truth.jsonl (ringpose-conventions(7))")
ROBOT_POSE = Kind(
    "a robot pose", "ringpose/robot", frozenset({"base_from_tool"}), "give the robot's poses (ringpose-conventions(7))"
)
DETECTION = Kind(
    "a detection", "ringpose/detection/", frozenset({"break_points"}), "give the output of ringpose detect"
)
POINTS = Kind(
    "points", "ringpose/points/", frozenset({"points", "left_out"}), "give the output of ringpose detect --points -"
)
TRACK_LINE = Kind("a track line", "ringpose/track/", frozenset({"validity"}), "give the output of ringpose track")
POSE_LINE = Kind("a pose line", "ringpose/pose/", frozenset({"pose", "flags"}), "give the output of ringpose pose")
CAPTURE_LINE = Kind(
    "a capture", "ringpose/capture/", frozenset({"closed_s"}), "give captures.jsonl of ringpose bench study"
)

_FILES = (CAMERA, RIG, SCENE, STUDY, BOARD, RINGS, SESSION)
_RECORDS = (TRUTH, ROBOT_POSE, DETECTION, POINTS, TRACK_LINE, POSE_LINE, CAPTURE_LINE)
_KINDS = (*_FILES, *_RECORDS)

EXCHANGED = "see whether two files of the command are exchanged"
"""Remedy for a file of another kind."""

_SIGNATURES = {
    b"PK\x03": "an NPZ archive, as shots and detections are",
    b"\x89PNG": "an image",
    b"\xff\xd8\xff": "an image",
    b"II*\0": "an image",
    b"MM\0*": "an image",
    b"P5\n": "an image",
    b"%PDF": "a PDF file",
    b"\x1f\x8b": "a compressed file",
}
"""Kinds of binary files by their first bytes."""

_HEAD_BYTES = 1 << 16
"""Bytes of a text in which its keys are looked for."""


def kind_of(values: Mapping[Any, Any]) -> Kind | None:
    """The kind of a mapping, by its schema, else by its keys."""
    schema = str(values.get("ringpose") or values.get("schema") or "")
    by_schema = (kind for kind in _KINDS if schema.startswith(kind.schema))
    return next(by_schema, next((kind for kind in _KINDS if kind.keys <= values.keys()), None))


def in_place_of_another(values: Mapping[Any, Any], known: Collection[str]) -> tuple[str, str] | None:
    """Finding and remedy for a mapping of another kind than the one that has the `known` keys; None if it is not."""
    by_keys = (kind for kind in _KINDS if kind.keys <= values.keys())
    given = (kind for kind in (kind_of(values), *by_keys) if kind is not None)
    other = next((kind for kind in given if not kind.keys <= set(known)), None)
    if other is None:
        return None
    wanted = next((kind for kind in _KINDS if kind.keys <= set(known)), None)
    return (f"is {other.name}", "give another file") if wanted is None else wanted.instead_of(other)


def kind_of_data(content: bytes) -> str:
    """What a file is that is not YAML: an archive, an image, records; empty if it is none of these."""
    for signature, name in _SIGNATURES.items():
        if content.startswith(signature):
            return name
    with suppress(ValueError, RecursionError):
        record = json.loads(content.lstrip()[:_HEAD_BYTES].partition(b"\n")[0])
        kind = kind_of(record) if isinstance(record, dict) else None
        return f"a file of records ({kind.name} each)" if kind in _RECORDS and kind is not None else ""
    return ""


def kind_of_text(content: bytes) -> str:
    """What a YAML file is, by its keys; empty if it is of no kind that ringpose reads."""
    keys = re.findall(rb"^([A-Za-z_]\w*):[ \t]*(\S*)", content[:_HEAD_BYTES], re.MULTILINE)
    kind = kind_of({key.decode(): value.decode(errors="replace") for key, value in keys})
    return "" if kind is None else kind.name
