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
    matrix = np.eye(3)
    if struct is None:
        fields = Fields(file, values)
        for key in _TOOLBOX:
            if key not in values:
                raise DataError(file, f"has no {key}", _REMEDY)
        matrix[[0, 1], [0, 1]], matrix[:2, 2] = fields.vector("fc", 2), fields.vector("cc", 2)
        matrix[0, 1] = fields.number("alpha_c", missing=0.0)
        coefficients = fields.array("kc", (None,))
        width, height = fields.number("nx"), fields.number("ny")
    else:
        fields = Fields(file, struct)
        # IntrinsicMatrix is the transpose of K; MATLAB's first pixel is 1, OpenCV's is 0.
        matrix = fields.array("K", (3, 3)) if fields.has("K") else fields.array("IntrinsicMatrix", (3, 3)).T
        matrix = matrix - np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
        k1, k2, k3 = np.pad(fields.array("RadialDistortion", (None,)), (0, 3))[:3]
        coefficients = np.array([k1, k2, *fields.vector("TangentialDistortion", 2), k3])
        height, width = fields.vector("ImageSize", 2)
    if matrix[0, 1]:
        raise DataError(file, f"has a skew of {matrix[0, 1]:g}", "calibrate without skew (est_alpha = 0)")
    if len(coefficients) > 5:
        raise DataError(file, f"has {len(coefficients)} distortion coefficients, must have at most 5")
    size = Fields(file, {"image_width": int(width), "image_height": int(height)})
    return pinhole_camera(size, name, matrix, coefficients)


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
