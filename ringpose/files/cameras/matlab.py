"""Cameras of MATLAB in .mat files: Calib_Results of the camera calibration toolbox, `toStruct` of cameraParameters.

The toolbox counts pixels from 0, as ringpose does; cameraParameters count from 1.
"""

import io
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from ringpose.errors import DataError
from ringpose.files.cameras.ros import pinhole_camera
from ringpose.files.schema import Fields
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Camera

MAX_BYTES = 2**26
"""Maximum size of a .mat file with a calibration."""

_VERSION_7_3 = b"MATLAB 7.3 MAT-file"
SIGNATURES = (b"MATLAB 5.0 MAT-file", _VERSION_7_3)
"""First bytes of a .mat file of version 5 to 7.2, and of version 7.3 (HDF5)."""

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
    candidates = (values, *(value for value in values.values() if isinstance(value, dict)))
    struct = next((candidate for candidate in candidates if all(key in candidate for key in _STRUCT)), None)
    parameters = _toolbox_parameters(values, file) if struct is None else _struct_parameters(struct, file)
    (width, height), (fx, fy), (cx, cy), coefficients = parameters
    if len(coefficients) > 5:
        raise DataError(file, f"has {len(coefficients)} distortion coefficients, must have at most 5")
    fields = Fields(file, {"image_width": int(width), "image_height": int(height)})
    return pinhole_camera(fields, name, np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), coefficients)


_Parameters: TypeAlias = tuple[tuple[float, float], Float64[Array, "2"], Float64[Array, "2"], Float64[Array, "_"]]
"""Width and height, focal lengths, principal point (0 is the centre of the first pixel), and k1, k2, p1, p2, k3."""


def _toolbox_parameters(values: Mapping[str, Any], file: str) -> _Parameters:
    for key in _TOOLBOX:
        if key not in values:
            raise DataError(file, f"has no {key}", _REMEDY)
    if np.any(_numbers(values.get("alpha_c", 0.0), file, "alpha_c") != 0):
        raise DataError(file, "has a skew (alpha_c)", "calibrate with est_alpha = 0")
    fc, cc = (_numbers(values[key], file, key, length=2) for key in ("fc", "cc"))
    kc, nx, ny = (_numbers(values[key], file, key) for key in ("kc", "nx", "ny"))
    return (nx[0], ny[0]), fc, cc, kc


def _struct_parameters(values: Mapping[str, Any], file: str) -> _Parameters:
    """MATLAB's first pixel is 1, OpenCV's is 0; IntrinsicMatrix is the transpose of K."""
    key = "K" if "K" in values else "IntrinsicMatrix"
    if key not in values:
        raise DataError(file, "has neither K nor IntrinsicMatrix", _REMEDY)
    matrix = _numbers(values[key], file, key, length=9).reshape(3, 3)
    if key == "IntrinsicMatrix":
        matrix = matrix.T
    if matrix[0, 1]:
        raise DataError(file, f"has a skew of {matrix[0, 1]:g}", "calibrate without skew")
    radial = np.concatenate([_numbers(values["RadialDistortion"], file, "RadialDistortion"), np.zeros(3)])[:3]
    tangential = _numbers(values["TangentialDistortion"], file, "TangentialDistortion", length=2)
    height, width = _numbers(values["ImageSize"], file, "ImageSize", length=2)
    coefficients = np.concatenate([radial[:2], tangential, radial[2:]])
    return (width, height), matrix[[0, 1], [0, 1]], matrix[:2, 2] - 1, coefficients


def _numbers(value: Any, file: str, key: str, length: int | None = None) -> Float64[Array, "_"]:
    try:
        numbers = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise DataError(file, f"has a {key} that is not a list of numbers", _REMEDY) from None
    if not len(numbers) or not np.isfinite(numbers).all():
        raise DataError(file, f"has a {key} that is not finite", _REMEDY)
    if length is not None and len(numbers) != length:
        raise DataError(file, f"has {len(numbers)} numbers in {key}, must have {length}", _REMEDY)
    return numbers


def mat(camera: Camera) -> bytes:
    """A Calib_Results.mat; uncertainties as the toolbox gives them, three standard deviations."""
    from scipy.io import savemat

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
    stream: Any = io.BytesIO()
    savemat(stream, {key: np.reshape(value, (-1, 1)) for key, value in values.items()})
    return bytes(stream.getvalue())
