"""Cameras of MATLAB in .mat files: Calib_Results of the camera calibration toolbox, `toStruct` of cameraParameters.

The toolbox counts pixels from 0, as ringpose does; cameraParameters count from 1.
"""

import io
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files.cameras.ros import pinhole_camera
from ringpose.files.schema import Fields
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera

MAX_BYTES = 2**26
"""Maximum size of a .mat file with a calibration."""

_VERSION_5, _VERSION_7_3 = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
_REMEDY = "give a Calib_Results.mat, or toStruct(cameraParameters) saved as .mat with -v7"
_TOOLBOX = ("fc", "cc", "kc", "nx", "ny")
_STRUCT = ("ImageSize", "RadialDistortion", "TangentialDistortion")

_LOAD = """
import io, json, resource, sys
from scipy.io import loadmat

resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31))
values = loadmat(io.BytesIO(sys.stdin.buffer.read()), simplify_cells=True)
json.dump(values, sys.stdout, default=lambda value: value.tolist() if hasattr(value, "tolist") else None)
"""
"""SciPy's reader runs in a separate process with limited memory and time, since it crashes on damaged files (1.17: a
segmentation fault for one of 50 files with three wrong bytes), or allocates the memory that a wrong size requires."""

_LIMIT_S = 60.0


def is_mat(content: bytes) -> bool:
    """Whether a file is a .mat file, of version 5 to 7.2 or 7.3 (HDF5)."""
    return content.startswith((_VERSION_5, _VERSION_7_3))


def mat_variables(content: bytes, file: str) -> dict[str, Any]:
    """Variables in a .mat file of version 5 to 7.2: numbers, nested lists, and mappings for structures."""
    if content.startswith(_VERSION_7_3):
        raise DataError(file, "is a .mat file of version 7.3, must be of version 5 to 7.2", "save it again with -v7")
    if len(content) > MAX_BYTES:
        raise DataError(file, f"has {len(content)} bytes, a camera has at most {MAX_BYTES}", _REMEDY)
    command, environment = [sys.executable, "-P", "-c", _LOAD], {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    try:
        loaded = subprocess.run(  # noqa: S603 (a constant command)
            command, input=content, capture_output=True, timeout=_LIMIT_S, check=True, env=environment
        )
        values = json.loads(loaded.stdout)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired, ValueError):
        raise DataError(file, "is not a valid .mat file of version 5 to 7.2", "save it again with -v7") from None
    return dict(values)


def camera_of(values: Mapping[str, Any], file: str, name: str) -> Camera:
    """The camera among the variables of a .mat file."""
    for candidate in (values, *(value for value in values.values() if isinstance(value, dict))):
        if all(key in candidate for key in _STRUCT):
            return _camera_of_struct(candidate, file, name)
    return _camera_of_toolbox(values, file, name)


def mat(camera: Camera) -> bytes:
    """A Calib_Results.mat; uncertainties as the toolbox gives them, three standard deviations."""
    from scipy.io import savemat

    stream: Any = io.BytesIO()
    savemat(stream, {key: np.reshape(value, (-1, 1)) for key, value in _toolbox_values(camera).items()})
    return bytes(stream.getvalue())


def _camera_of_toolbox(values: Mapping[str, Any], file: str, name: str) -> Camera:
    for key in _TOOLBOX:
        if key not in values:
            raise DataError(file, f"has no {key}", _REMEDY)
    if np.any(_numbers(values.get("alpha_c", 0.0), file, "alpha_c") != 0):
        raise DataError(file, "has a skew (alpha_c)", "calibrate with est_alpha = 0")
    fc, cc, kc = (_numbers(values[key], file, key) for key in ("fc", "cc", "kc"))
    size = (_numbers(values["nx"], file, "nx"), _numbers(values["ny"], file, "ny"))
    return _camera(
        file, name, (size[0][0], size[1][0]), _of_length(fc, 2, file, "fc"), _of_length(cc, 2, file, "cc"), kc
    )


def _camera_of_struct(values: Mapping[str, Any], file: str, name: str) -> Camera:
    """MATLAB's first pixel is 1, OpenCV's is 0; IntrinsicMatrix is the transpose of K."""
    key = "K" if "K" in values else "IntrinsicMatrix"
    if key not in values:
        raise DataError(file, "has neither K nor IntrinsicMatrix", _REMEDY)
    matrix = _of_length(_numbers(values[key], file, key), 9, file, key).reshape(3, 3)
    if key == "IntrinsicMatrix":
        matrix = matrix.T
    fx, skew, cx, _, fy, cy = matrix.ravel()[:6].tolist()
    if skew:
        raise DataError(file, f"has a skew of {skew:g}", "calibrate without skew")
    radial, tangential = (_numbers(values[key], file, key) for key in _STRUCT[1:])
    radial = np.concatenate([radial, np.zeros(3)])[:3]
    kc = np.array([*radial[:2], *_of_length(tangential, 2, file, _STRUCT[2]), radial[2]])
    height, width = _of_length(_numbers(values["ImageSize"], file, "ImageSize"), 2, file, "ImageSize")
    return _camera(file, name, (width, height), np.array([fx, fy]), np.array([cx, cy]) - 1, kc)


def _camera(
    file: str,
    name: str,
    size: tuple[float, float],
    focal_px: Float64[Array, "2"],
    center_px: Float64[Array, "2"],
    coefficients: Float64[Array, "_"],
) -> Camera:
    if len(coefficients) > 5:
        raise DataError(file, f"has {len(coefficients)} distortion coefficients, must have at most 5")
    (fx, fy), (cx, cy) = focal_px, center_px
    fields = Fields(file, {"image_width": int(size[0]), "image_height": int(size[1])})
    return pinhole_camera(fields, name, np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), coefficients)


def _toolbox_values(camera: Camera) -> dict[str, Any]:
    matrix, coefficients = camera.camera_matrix, camera.distortion_coefficients
    if np.any(coefficients[5:] != 0):
        remedy = "calibrate with --distortion-model plumb_bob"
        raise DataError("matlab", "the toolbox has only k1, k2, p1, p2, k3", remedy)
    values: dict[str, Any] = {
        "fc": matrix[[0, 1], [0, 1]],
        "cc": matrix[:2, 2],
        "alpha_c": 0.0,
        "kc": coefficients[:5],
        "nx": float(camera.image_width),
        "ny": float(camera.image_height),
    }
    if camera.covariance is not None:
        triple = {key: 3 * sigma for key, sigma in camera.covariance.standard_deviations.items()}
        for key, names in (("fc", "fx fy"), ("cc", "cx cy"), ("kc", "k1 k2 p1 p2 k3")):
            values[f"{key}_error"] = np.array([triple.get(name, 0.0) for name in names.split()])
    return values


def _numbers(value: Any, file: str, key: str) -> Float64[Array, "_"]:
    try:
        numbers = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise DataError(file, f"has a {key} that is not a list of numbers", _REMEDY) from None
    if not len(numbers) or not np.isfinite(numbers).all():
        raise DataError(file, f"has a {key} that is not finite", _REMEDY)
    return numbers


def _of_length(numbers: Float64[Array, "_"], length: int, file: str, key: str) -> Float64[Array, "_"]:
    if len(numbers) != length:
        raise DataError(file, f"has {len(numbers)} numbers in {key}, must have {length}", _REMEDY)
    return numbers
