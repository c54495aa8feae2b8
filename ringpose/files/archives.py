"""NPZ archives: named arrays, never a pickled object."""

import io
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.bytes import read_bytes
from ringpose.files.fields import FREE_PREFIX, hint, unusable
from ringpose.types.arrays import Array

_ZIP = b"PK"
_REMEDY = "copy it anew, or write it with numpy.savez, of arrays without objects"
_KEYS = "what a shot has stands in ringpose-conventions(7), a detection in ringpose-records(5)"
_KINDS = {"f": "floating point", "i": "integers", "u": "unsigned integers", "U": "a text", "b": "true or false"}


class Archive:
    """The arrays of one NPZ file, each checked when it is asked for."""

    def __init__(self, path: Path) -> None:
        encoded = read_bytes(path)
        self.path = path
        if not encoded.startswith(_ZIP):
            raise DataError(str(path), "is no NPZ archive", "give one that numpy.savez or ringpose wrote")
        try:
            with np.load(io.BytesIO(encoded), allow_pickle=False) as archive:
                self.arrays: dict[str, Array] = {key: archive[key] for key in archive.files}
        except Exception as error:  # whatever the parsers of a broken zip, zlib stream or header raise
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise DataError(str(path), f"is a broken or foreign NPZ archive: {reason}", _REMEDY) from error
        for key, array in self.arrays.items():
            if not isinstance(array, np.ndarray):
                raise self.problem(key, "is no array", _REMEDY)

    def __contains__(self, key: str) -> bool:
        return key in self.arrays

    def problem(self, key: str, found: str, remedy: str = "") -> DataError:
        """The error of this key, to be raised."""
        return DataError(f"{self.path}: {key}", found, remedy)

    def refuse_unknown(self, known: Iterable[str]) -> None:
        """No key but the known ones, and those that are the user's own."""
        known = tuple(known)
        for key in self.arrays:
            if key not in known and not key.startswith(FREE_PREFIX):
                raise DataError(
                    str(self.path), f"unknown key {key!r}", hint(key, known) or f"begin your own with {FREE_PREFIX}"
                )

    def array(self, key: str, kinds: str, shape: tuple[int | None, ...]) -> Array:
        """An array whose type is of one of the kinds (letters of NumPy) and whose shape is this; None is any length."""
        if key not in self.arrays:
            raise DataError(str(self.path), f"has no key {key!r}", hint(key, self.arrays) or _KEYS)
        array = self.arrays[key]
        if array.dtype.kind not in kinds:
            wanted = " or ".join(_KINDS[kind] for kind in kinds)
            raise self.problem(key, f"has type {array.dtype}, must be {wanted}")
        if array.ndim != len(shape) or any(w not in (None, n) for w, n in zip(shape, array.shape, strict=True)):
            wanted = " x ".join("n" if length is None else str(length) for length in shape)
            found = " x ".join(map(str, array.shape))
            raise self.problem(key, f"has shape {found or 'of one value'}, must have {wanted or 'one value'}")
        return array

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """An array of finite numbers, float64."""
        array = self.array(key, "fiu", shape).astype(np.float64)
        if finding := unusable(array, allow_nan=False):
            raise self.problem(key, finding)
        return array

    def integers(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """An array of whole numbers, int64."""
        return self.array(key, "iu", shape).astype(np.int64)

    def text(self, key: str) -> str:
        """One text."""
        return str(self.array(key, "U", ()))


def write_archive(path: Path, arrays: Mapping[str, Any], *, force: bool) -> None:
    """Write an NPZ file, compressed as quickly as zlib can."""
    with (
        atomic.replacing(path, force) as stream,
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as z,
    ):
        for key, array in arrays.items():
            with z.open(f"{key}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)
