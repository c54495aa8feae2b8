"""Point clouds as PLY or NPZ files: written shot by shot, and read for a picture.

Both have the same values for each point (`POINT`); a PLY file states frame, lasers and shots in comments. The points
go into a temporary file until their number is known, so that the memory does not depend on it. The PLY libraries of
Python hold a whole cloud in memory, or are not free for every use (plyfile: GPL); the header is a few lines.
"""

import json
import shutil
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.files import atomic, records
from ringpose.files.io import opened, provenance
from ringpose.files.npz import Archive
from ringpose.files.records.points import RECORD
from ringpose.types.arrays import Array
from ringpose.types.options import PoseFrame
from ringpose.types.points import PointCloud, ShotPoints

PLY, NPZ = ".ply", ".npz"

_DOUBLES = (
    "x", "y", "z", "intensity_dn", "stamp_s", "noise_x", "noise_y", "noise_z",
    "cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz", "u_px", "v_px",
)  # fmt: skip

POINT = np.dtype([(name, "<f8") for name in _DOUBLES] + [("laser", "u1"), ("shot", "<i4")])
"""The properties of a vertex: metres, square metres, seconds, pixels, and numbers of laser and shot from 0."""

_PLY_TYPES = {"<f8": "double", "|u1": "uchar", "<i4": "int"}

_ROWS, _COLUMNS = np.triu_indices(3)
"""Elements of a symmetric matrix in the order of `cov_xx` to `cov_zz`."""

_CHUNK = 8192
"""Points that are held in memory at a time."""

_MAX_HEADER_BYTES = 2**26

_COMMENT = "comment "

_REMEDY = "give a file that ringpose detect --points has written"


def check_name(path: Path) -> None:
    """Reject a name that does not show the format."""
    if path.suffix.lower() not in (PLY, NPZ):
        raise UsageError(
            "--points", f"{path} is neither a .ply nor an .npz file", "give such a name, or - for JSON lines"
        )


class PointCloudFile:
    """Collects the points of shots, which all are in one frame and of one rig."""

    def __init__(self, frame: PoseFrame, lasers: tuple[str, ...], spool: IO[bytes]) -> None:
        self._about = {"frame": frame.value, "lasers": list(lasers)}
        self._shots: list[str] = []
        self._spool = spool
        self.count = 0

    def add(self, of_shot: ShotPoints) -> None:
        """Add the points of the next shot."""
        points = of_shot.points
        rows = np.empty(len(points.laser), dtype=POINT)
        columns = [
            points.position_m,
            points.intensity_dn[:, None],
            points.stamp_s[:, None],
            points.noise_m,
            points.covariance_m2[:, _ROWS, _COLUMNS],
            points.position_px,
        ]
        for name, column in zip(_DOUBLES, np.concatenate(columns, axis=1).T, strict=True):
            rows[name] = column
        rows["laser"], rows["shot"] = points.laser, len(self._shots)
        self._spool.write(rows.tobytes())
        self._shots.append(of_shot.shot)
        self.count += len(rows)

    def write_ply(self, stream: IO[bytes]) -> None:
        """Write the cloud as binary PLY."""
        about = {**self._about, "covariance": RECORD.version}
        comments = [f"ringpose {json.dumps(about)}", *(f"shot {json.dumps(name)}" for name in self._shots)]
        properties = [f"property {_PLY_TYPES[POINT[name].str]} {name}" for name in POINT.names or ()]
        header = [
            "ply",
            "format binary_little_endian 1.0",
            *(_COMMENT + text for text in comments),
            f"element vertex {self.count}",
            *properties,
            "end_header",
        ]
        stream.write("".join(f"{line}\n" for line in header).encode("ascii"))  # json.dumps escapes other characters
        self._spool.seek(0)
        shutil.copyfileobj(self._spool, stream)

    def write_npz(self, stream: IO[bytes], inputs: list[Path]) -> None:
        """Write the cloud as NPZ, with the keys of the record and a number for each point's shot."""
        texts = {
            "schema": RECORD.version,
            "frame": self._about["frame"],
            "lasers": self._about["lasers"],
            "shots": self._shots,
            "provenance": records.line_of(provenance(inputs)).strip(),
        }
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as z:
            for key, value in texts.items():
                with z.open(f"{key}.npy", "w") as member:
                    np.lib.format.write_array(member, np.array(value, dtype=np.str_), allow_pickle=False)
            for key, (shape, dtype) in _ARRAYS.items():
                with z.open(f"{key}.npy", "w", force_zip64=True) as member:
                    described = {"descr": dtype, "fortran_order": False, "shape": (self.count, *shape)}
                    np.lib.format.write_array_header_1_0(member, described)
                    for rows in self._chunks():
                        member.write(_array_of(key, rows).astype(dtype).tobytes())

    def _chunks(self) -> Iterator[Array]:
        self._spool.seek(0)
        while encoded := self._spool.read(_CHUNK * POINT.itemsize):
            yield np.frombuffer(encoded, dtype=POINT)


_ARRAYS: Mapping[str, tuple[tuple[int, ...], str]] = {
    "position_m": ((3,), "<f8"),
    "covariance_m2": ((3, 3), "<f8"),
    "noise_m": ((3,), "<f8"),
    "intensity_dn": ((), "<f8"),
    "laser": ((), "<i8"),
    "shot": ((), "<i8"),
    "stamp_s": ((), "<f8"),
    "position_px": ((2,), "<f8"),
}
"""Shape of each point's values, and type, by the keys of the record."""

_COLUMNS_OF = {
    "position_m": ("x", "y", "z"),
    "noise_m": ("noise_x", "noise_y", "noise_z"),
    "position_px": ("u_px", "v_px"),
}


def _array_of(key: str, rows: Array) -> Array:
    if key in _COLUMNS_OF:
        return np.stack([rows[name] for name in _COLUMNS_OF[key]], axis=1)
    if key != "covariance_m2":
        return np.asarray(rows[key])
    matrices = np.empty((len(rows), 3, 3))
    for name, row, column in zip(_DOUBLES[8:14], _ROWS, _COLUMNS, strict=True):
        matrices[:, row, column] = matrices[:, column, row] = rows[name]
    return matrices


@contextmanager
def point_cloud_file(
    path: Path, frame: PoseFrame, lasers: tuple[str, ...], *, force: bool, inputs: list[Path]
) -> Iterator[PointCloudFile]:
    """A cloud that is written into a PLY or NPZ file, by its name, when the block ends without an exception."""
    check_name(path)
    with atomic.replacing(path, force) as stream, TemporaryFile(dir=path.resolve().parent) as spool:
        cloud = PointCloudFile(frame, lasers, spool)
        yield cloud
        if path.suffix.lower() == PLY:
            cloud.write_ply(stream)
        else:
            cloud.write_npz(stream, inputs)


def read_point_cloud(path: Path, max_points: int) -> PointCloud:
    """The points in a file, at most so many: of a larger cloud every second, third, ... one."""
    check_name(path)
    return _read_npz(path, max_points) if path.suffix.lower() == NPZ else _read_ply(path, max_points)


def _read_ply(path: Path, max_points: int) -> PointCloud:
    with opened(path) as stream:
        about, shots, count = _ply_header(path, stream)
        if path.stat().st_size != stream.tell() + count * POINT.itemsize:
            raise DataError(str(path), f"has not the {count} points that its header declares", _REMEDY)
        step = max(-(-count // max_points), 1)
        parts = []
        for first in range(0, count, _CHUNK):
            encoded = stream.read(min(_CHUNK, count - first) * POINT.itemsize)
            parts.append(np.frombuffer(encoded, dtype=POINT)[-first % step :: step].copy())
    rows = np.concatenate(parts) if parts else np.empty(0, dtype=POINT)
    arrays = {key: _array_of(key, rows) for key in ("position_m", "laser", "shot")}
    return _cloud(path, about, shots, arrays, step)


def _ply_header(path: Path, stream: IO[bytes]) -> tuple[dict[str, Any], list[str], int]:
    """What the header states about the cloud, its shots, and the number of points."""
    about: dict[str, Any] = {}
    shots: list[str] = []
    rest: list[str] = []
    try:
        while (line := stream.readline(_MAX_HEADER_BYTES).decode("ascii").rstrip("\r\n")) != "end_header":
            if line.startswith(f"{_COMMENT}ringpose "):
                about = json.loads(line.removeprefix(f"{_COMMENT}ringpose "))
            elif line.startswith(f"{_COMMENT}shot "):
                shots.append(str(json.loads(line.removeprefix(f"{_COMMENT}shot "))))
            elif not line or stream.tell() > _MAX_HEADER_BYTES:
                raise ValueError
            else:
                rest.append(line)
        count = int(rest[2].removeprefix("element vertex "))
    except (ValueError, IndexError):
        raise DataError(str(path), "is not a PLY file that ringpose has written", _REMEDY) from None
    properties = [f"property {_PLY_TYPES[POINT[name].str]} {name}" for name in POINT.names or ()]
    if rest[:2] != ["ply", "format binary_little_endian 1.0"] or rest[3:] != properties or count < 0:
        raise DataError(str(path), "has other properties than a cloud of ringpose", _REMEDY)
    return about, shots, count


def _read_npz(path: Path, max_points: int) -> PointCloud:
    archive = Archive(path)
    kinds = {key: "f" if dtype == "<f8" else "iu" for key, (_, dtype) in _ARRAYS.items()}
    needed = ("position_m", "laser", "shot")
    lengths = {archive.declared(key, kinds[key], (None, *_ARRAYS[key][0]))[1][0] for key in needed}
    if len(lengths) > 1:
        raise DataError(str(path), "has arrays of different lengths", _REMEDY)
    step = max(-(-lengths.pop() // max_points), 1)
    about = {"frame": archive.text("frame")}
    shots = [str(name) for name in archive.array("shots", "U", (None,))]
    arrays = {key: archive.loaded(key)[::step].copy() for key in needed}
    return _cloud(path, about, shots, arrays, step)


def _cloud(
    path: Path, about: Mapping[str, Any], shots: list[str], arrays: Mapping[str, Array], step: int
) -> PointCloud:
    position_m, laser, shot = arrays["position_m"], arrays["laser"].astype(np.int64), arrays["shot"].astype(np.int64)
    if about.get("frame") not in [each.value for each in PoseFrame]:
        raise DataError(str(path), "does not state its frame", _REMEDY)
    if not np.isfinite(position_m).all() or min(laser.min(initial=0), shot.min(initial=0)) < 0:
        raise DataError(str(path), "has a point that is not one", _REMEDY)
    if shot.max(initial=-1) >= len(shots):
        raise DataError(str(path), "has a point of a shot that it does not name", _REMEDY)
    return PointCloud(
        frame=PoseFrame(about["frame"]),
        shots=tuple(shots),
        position_m=position_m,
        laser=laser,
        shot=shot,
        thinned_by=step,
    )
