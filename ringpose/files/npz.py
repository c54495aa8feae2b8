"""NPZ archives: named arrays, never a pickled object."""

import io
import math
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.io import read_bytes
from ringpose.files.schema import EXCHANGED, FREE_PREFIX, MAX_VALUE, hint, kind_of_data, kind_of_text, unusable
from ringpose.types.arrays import Array

MAX_BYTES = 2**26
"""Total size of the arrays of an archive without its images: 50 times a 12-megapixel detection with eight stripes."""

_HEADER_BYTES = 2**14
"""Bytes read for an array's header, of which NumPy accepts at most 10,000."""

_PIECE_BYTES = 2**20
"""Bytes that are decompressed at once, while other threads run: pieces four times smaller, which numpy.load takes, wait
four times as often for the interpreter's lock, and with larger ones than the processor's cache each takes longer."""

_ZIP = b"PK"
_REMEDY = "copy it again, or write it with numpy.savez, from arrays without objects"
_SEE_MANUAL = "ringpose-conventions(7) documents the keys of shots, ringpose-records(5) those of detections"
_DTYPE_KINDS = {"f": "floating point", "i": "integers", "u": "unsigned integers", "U": "a text", "b": "true or false"}


class Member(NamedTuple):
    """One array of an archive, as its header declares it."""

    info: zipfile.ZipInfo
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    columns_first: bool
    """Whether the first index varies fastest."""
    header_bytes: int


class Archive:
    """The arrays of one NPZ file, each checked and decompressed on access."""

    def __init__(self, path: Path) -> None:
        encoded = read_bytes(path)
        self.path = path
        self._bytes_left = MAX_BYTES
        if not encoded.startswith(_ZIP) and (kind := kind_of_text(encoded) or kind_of_data(encoded)):
            raise DataError(str(path), f"is {kind}, must be an NPZ archive", EXCHANGED)
        if not encoded.startswith(_ZIP):
            raise DataError(str(path), "is not an NPZ archive", "give one that numpy.savez or ringpose wrote")
        with self._reporting_damage():
            self._zip = zipfile.ZipFile(io.BytesIO(encoded))
            self._members = {info.filename.removesuffix(".npy"): self._member(info) for info in self._zip.infolist()}
        if len(self._members) < len(self._zip.infolist()):
            raise DataError(str(path), "has two arrays of the same name", _REMEDY)

    def __contains__(self, key: str) -> bool:
        return key in self._members

    @property
    def keys(self) -> Iterable[str]:
        """Names of the arrays."""
        return self._members.keys()

    def problem(self, key: str, finding: str, remedy: str = "") -> DataError:
        """The error to raise for this key."""
        return DataError(f"{self.path}: {key}", finding, remedy)

    def reject_unknown(self, known: Iterable[str]) -> None:
        """Reject keys that are neither known nor the user's own (`FREE_PREFIX`)."""
        known = tuple(known)
        for key in self._members:
            if key not in known and not key.startswith(FREE_PREFIX):
                raise DataError(
                    str(self.path), f"unknown key {key!r}", hint(key, known) or f"begin your own with {FREE_PREFIX}"
                )

    def declared(
        self, key: str, kinds: str, shape: tuple[int | str | None, ...]
    ) -> tuple[np.dtype[Any], tuple[int, ...]]:
        """Type and shape of an array as its header declares them, checked before it is decompressed.

        The type must be one of `kinds` (letters of `numpy.dtype.kind`); None or a name in `shape` allows any length.
        """
        if key not in self._members:
            raise DataError(str(self.path), f"has no key {key!r}", hint(key, self._members) or _SEE_MANUAL)
        member = self._members[key]
        if member.dtype.kind not in kinds:
            expected = " or ".join(_DTYPE_KINDS[kind] for kind in kinds)
            raise self.problem(key, f"has type {member.dtype}, must be {expected}")
        lengths = member.shape
        fixed = [None if isinstance(length, str) else length for length in shape]
        if len(lengths) != len(shape) or any(w not in (None, n) for w, n in zip(fixed, lengths, strict=True)):
            expected = " x ".join("n" if length is None else str(length) for length in shape)
            given = " x ".join(map(str, lengths))
            raise self.problem(key, f"has shape {given or 'of one value'}, must have {expected or 'one value'}")
        return member.dtype, lengths

    def array(self, key: str, kinds: str, shape: tuple[int | None, ...]) -> Array:
        """An array with checked type and shape (see `declared`); the total of all arrays is limited to `MAX_BYTES`."""
        self.declared(key, kinds, shape)
        return self.value(key)

    def value(self, key: str) -> Array:
        """An array of any type and shape; the total of all arrays is limited to `MAX_BYTES`."""
        member = self._members[key]
        self._bytes_left -= max(member.dtype.itemsize, 1) * math.prod(member.shape)
        if self._bytes_left < 0:
            finding = f"declares {' x '.join(map(str, member.shape))} values of type {member.dtype}"
            raise self.problem(key, f"{finding}: more than {MAX_BYTES >> 20} MiB in all", _REMEDY)
        return self.loaded(key)

    def loaded(self, key: str) -> Array:
        """An array whose declared size the caller has checked."""
        member = self._members[key]
        with self._reporting_damage(), cast("zipfile.ZipExtFile", self._zip.open(member.info)) as stream:
            stream.seek(member.header_bytes)
            values = bytearray(member.dtype.itemsize * math.prod(member.shape))
            pieces = (memoryview(values)[at : at + _PIECE_BYTES] for at in range(0, len(values), _PIECE_BYTES))
            if sum(map(stream.readinto, pieces)) < len(values) or stream.read(1):  # its end has the check sum
                raise ValueError(f"{member.info.filename} does not hold the bytes that its header declares")
            return np.ndarray(member.shape, member.dtype, values, order="F" if member.columns_first else "C")

    def _member(self, info: zipfile.ZipInfo) -> Member:
        """Type and shape in the header of an array; only the header is decompressed.

        Compression methods other than deflate are rejected: NumPy does not write them, and zipfile decompresses them
        without a limit of size.
        """
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{info.filename} is compressed by a method that is not deflation")
        with self._zip.open(info) as stream:
            header = io.BytesIO(stream.read(_HEADER_BYTES))
        version = np.lib.format.read_magic(header)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
        if read is None:
            raise ValueError(f"{info.filename} has version {version} of the format")
        shape, columns_first, dtype = read(header)
        if dtype.hasobject:
            raise ValueError(f"{info.filename} holds pickled objects, which are never loaded")
        if min(shape, default=0) < 0 or info.file_size != header.tell() + math.prod(shape) * dtype.itemsize:
            raise ValueError(f"{info.filename} has {info.file_size} bytes, which is not what its header declares")
        return Member(info, dtype, shape, columns_first, header.tell())

    @contextmanager
    def _reporting_damage(self) -> Iterator[None]:
        """Convert all exceptions that the parsers of zip, zlib and NumPy headers raise into `DataError`."""
        try:
            yield
        except Exception as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise DataError(str(self.path), f"is a broken or foreign NPZ archive: {reason}", _REMEDY) from error

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """An array of finite numbers, float64."""
        array = self.array(key, "fiu", shape).astype(np.float64)
        if not (np.abs(array) <= MAX_VALUE).all():  # NaN neither
            raise self.problem(key, unusable(array, allow_nan=False))
        return array

    def integers(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """An array of whole numbers, int64."""
        return self.array(key, "iu", shape).astype(np.int64)

    def text(self, key: str) -> str:
        """One text."""
        return str(self.array(key, "U", ()))


def write_archive(path: Path, arrays: Mapping[str, Any], *, force: bool) -> None:
    """Write an NPZ file with zlib's fastest compression."""
    with (
        atomic.replacing(path, force) as stream,
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as z,
    ):
        for key, array in arrays.items():
            with z.open(f"{key}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)
