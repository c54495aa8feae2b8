"""Cameras of MATLAB: the camera calibration toolbox's Calib_Results (.m, .mat), and `toStruct` of cameraParameters.

The toolbox counts pixels from 0, as ringpose does; cameraParameters count from 1.
"""

import io
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files.camera_matrices import checked_matrix
from ringpose.files.fields import Fields
from ringpose.files.mat_file import HEADER, NEWER_HEADER, mat_variables
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera

_REMEDY = "give a Calib_Results file, or toStruct(cameraParameters) saved as .mat"
_ASSIGNED = re.compile(r"^\s*(\w+)\s*=\s*\[?([^\]\n%]*?)\]?\s*;[ \t\r]*(?:%.*)?$", re.MULTILINE)
_TOOLBOX = ("fc", "cc", "kc", "nx", "ny")
_STRUCT = ("ImageSize", "RadialDistortion", "TangentialDistortion")


def is_mat(content: bytes) -> bool:
    """Whether a file is a .mat file; one of version 7.3 is HDF5 inside."""
    return content.startswith((HEADER, NEWER_HEADER))


def is_script(content: bytes) -> bool:
    """Whether a file is the toolbox's Calib_Results.m."""
    return re.search(rb"^\s*fc\s*=\s*\[", content, re.MULTILINE) is not None


def camera_of_mat(content: bytes, file: str, name: str) -> Camera:
    """The camera in a .mat file."""
    values = mat_variables(content, file)
    for candidate in (values, *(value for value in values.values() if isinstance(value, dict))):
        if all(key in candidate for key in _STRUCT):
            return _camera_of_struct(candidate, file, name)
    return _camera_of_toolbox(values, file, name)


def camera_of_script(content: bytes, file: str, name: str) -> Camera:
    """The camera in a Calib_Results.m."""
    try:
        found = _ASSIGNED.findall(content.decode("utf-8", errors="replace"))
        values = {
            key: np.array([float(word) for word in re.split(r"[;,\s]+", text.strip()) if word])
            for key, text in found
            if key in (*_TOOLBOX, "alpha_c")
        }
    except ValueError:
        raise DataError(file, "has something other than numbers in fc, cc, kc, nx or ny", _REMEDY) from None
    return _camera_of_toolbox(values, file, name)


def script(camera: Camera) -> str:
    """A Calib_Results.m; uncertainties as the toolbox gives them, three standard deviations."""
    lines = ["% Intrinsic camera parameters, as the camera calibration toolbox for MATLAB writes them"]
    values = _toolbox_values(camera)
    lines += [
        f"{key} = [ {' ; '.join(repr(float(item)) for item in np.ravel(value))} ];" for key, value in values.items()
    ]
    return "\n".join(lines) + "\n"


def mat(camera: Camera) -> bytes:
    """A Calib_Results.mat."""
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
        file, name, (size[0][0], size[1][0]), (_of_length(fc, 2, file, "fc"), _of_length(cc, 2, file, "cc"), kc)
    )


def _camera_of_struct(values: Mapping[str, Any], file: str, name: str) -> Camera:
    """MATLAB's first pixel is 1, OpenCV's 0; its IntrinsicMatrix is transposed, K is not."""
    if "K" in values:
        matrix = _numbers(values["K"], file, "K")
    elif "IntrinsicMatrix" in values:
        matrix = _numbers(np.transpose(values["IntrinsicMatrix"]), file, "IntrinsicMatrix")
    else:
        raise DataError(file, "has neither K nor IntrinsicMatrix", _REMEDY)
    fx, skew, cx, _, fy, cy = _of_length(matrix, 9, file, "the camera matrix")[:6].tolist()
    if skew:
        raise DataError(file, f"has a skew of {skew:g}", "calibrate without")
    radial, tangential = (_numbers(values[key], file, key) for key in _STRUCT[1:])
    radial = np.concatenate([radial, np.zeros(3)])[:3]
    kc = np.array([*radial[:2], *_of_length(tangential, 2, file, _STRUCT[2]), radial[2]])
    height, width = _of_length(_numbers(values["ImageSize"], file, "ImageSize"), 2, file, "ImageSize")
    return _camera(file, name, (width, height), (np.array([fx, fy]), np.array([cx, cy]) - 1, kc))


_Parameters = tuple[Float64[Array, "2"], Float64[Array, "2"], Float64[Array, "_"]]


def _camera(file: str, name: str, size: tuple[float, float], parameters: _Parameters) -> Camera:
    (fx, fy), (cx, cy), kc = parameters
    fields = Fields(file, {"image_width": int(size[0]), "image_height": int(size[1])})
    if len(kc) > 5:
        raise DataError(file, f"has {len(kc)} distortion coefficients, the toolbox has 5")
    return Camera(
        camera_name=name,
        image_width=fields.integer("image_width", least=1),
        image_height=fields.integer("image_height", least=1),
        camera_matrix=checked_matrix(fields, np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])),
        distortion_model="plumb_bob",
        distortion_coefficients=np.concatenate([kc, np.zeros(5 - len(kc))]),
    )


def _toolbox_values(camera: Camera) -> dict[str, Any]:
    matrix, coefficients = camera.camera_matrix, camera.distortion_coefficients
    if np.any(coefficients[5:] != 0):
        raise DataError(
            "matlab", "the toolbox has k1, k2, p1, p2, k3 alone", "calibrate with --distortion-model plumb_bob"
        )
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
        raise DataError(file, f"has a {key} that is no list of numbers", _REMEDY) from None
    if not len(numbers) or not np.isfinite(numbers).all():
        raise DataError(file, f"has a {key} that is not finite", _REMEDY)
    return numbers


def _of_length(numbers: Float64[Array, "_"], length: int, file: str, key: str) -> Float64[Array, "_"]:
    if len(numbers) != length:
        raise DataError(file, f"has {len(numbers)} numbers in {key}, must have {length}", _REMEDY)
    return numbers
