"""Reading and writing of cameras in the formats of ringpose, ROS, OpenCV, Kalibr and MATLAB."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.files import atomic
from ringpose.files.cameras import matlab, ros
from ringpose.files.cameras import opencv as opencv_storage
from ringpose.files.cameras.camera_info import INI_SECTION, ini_values, message_values, published_values
from ringpose.files.io import read_bytes
from ringpose.files.schema import Fields
from ringpose.files.yaml import parsed, write_yaml
from ringpose.types.options import CameraFormat
from ringpose.types.rig import CAMERA_PARAMETERS, Camera, ParameterCovariance

_SEPARATOR = re.compile(rb"^---[ \t\r]*$", re.MULTILINE)
"""The line that `rostopic echo` and `ros2 topic echo` print after each message."""

_HEADER = re.compile(rb"^header:[^\n]*\n(?:[ \t]+[^\n]*\n)*", re.MULTILINE)
"""The header of a printed message, the only part that differs between the messages of one camera."""

_KALIBR_NAME = "cam0"
_KALIBR_IGNORED = ("rostopic", "cam_overlaps", "T_cn_cnm1", "T_cam_imu", "timeshift_cam_imu")
_KALIBR_KEYS = ("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution", *_KALIBR_IGNORED)
_KALIBR_LENGTHS = {"radtan": 4, "none": 0}
"""Number of coefficients (k1, k2, p1, p2) of the Kalibr distortion models that OpenCV also has."""


def read_camera(path: Path) -> Camera:
    """The camera in a camera.yaml, rig.yaml, or a file of ROS, OpenCV, Kalibr or MATLAB, recognised by its contents."""
    file = str(path)
    form, values = _opened(read_bytes(path), file)
    return _READERS[form](values, file, path.stem)


def write_camera_as(path: Path, camera: Camera, form: CameraFormat, source: Path, *, force: bool = False) -> None:
    """Write a camera that was read from `source`; only ringpose's own format includes the covariance."""
    if form is CameraFormat.RINGPOSE:
        ros.write_camera(path, camera, force=force, inputs=[source])
        return
    if form is CameraFormat.MATLAB and path.suffix.lower() != ".mat":
        raise UsageError("--output", f"{path.name} is not a .mat file", "end it with .mat")
    content: bytes | dict[str, Any]
    if form is CameraFormat.OPENCV:
        content = opencv_storage.storage_text(camera, path.suffix)
    elif form is CameraFormat.MATLAB:
        content = matlab.mat(camera)
    else:
        own = ros.stereo_values(replace(camera, covariance=None))
        content = _kalibr_values(camera) if form is CameraFormat.KALIBR else own
    with atomic.replacing(path, force) as stream:
        if isinstance(content, bytes):
            stream.write(content)
        else:
            write_yaml(stream, content)


def _opened(content: bytes, file: str) -> tuple[CameraFormat, Any]:
    """The format of a file, recognised by its first bytes or its keys, and its values."""
    if content.startswith(matlab.SIGNATURES):
        return CameraFormat.MATLAB, matlab.mat_variables(content, file)
    if content.startswith(opencv_storage.SIGNATURES) or any(tag in content for tag in opencv_storage.MATRIX_TAGS):
        return CameraFormat.OPENCV, opencv_storage.storage_values(content, file)
    if INI_SECTION.search(content):
        return CameraFormat.ROS, ini_values(content, file)
    _reject_report(content, file)
    values = parsed(_one_message(content, file), file)
    keys = set(values) if isinstance(values, Mapping) else set()
    for form, characteristic_keys in _CHARACTERISTIC_KEYS.items():
        if keys & characteristic_keys:
            return form, values
    raise DataError(file, "is not a camera", "give a camera.yaml, rig.yaml, or a file of ROS, OpenCV, Kalibr or MATLAB")


def _one_message(content: bytes, file: str) -> bytes:
    """The text of the one camera in a file of printed messages, which differ at most in their headers."""
    messages = [part for part in _SEPARATOR.split(content) if part.strip()]
    if len(messages) < 2:
        return _SEPARATOR.sub(b"", content)  # the text itself, so that errors name its lines
    different = {_HEADER.sub(b"", message).strip() for message in messages}
    if len(different) > 1:
        raise DataError(file, f"holds {len(messages)} messages of different cameras", "keep one message")
    return messages[0]


def _reject_report(content: bytes, file: str) -> None:
    """Reject what a calibrator printed or reported for people, naming the file that it writes for programs."""
    for pattern, report, remedy in _REPORTS:
        if re.search(pattern, content, re.MULTILINE):
            raise DataError(file, f"is {report}", f"give {remedy}")


_REPORTS = (
    (
        rb"^\** ?Calibrating ?\**\s*$|^\('?[DK] = '?,|^[DK] = \[",
        "what ROS's calibrator printed",
        "the ost.yaml of /tmp/calibrationdata.tar.gz, which its button SAVE writes",
    ),
    (
        rb"^Calibration results *\r?\n=+|aslam_cv",
        "a text report of Kalibr",
        "its camchain.yaml, written beside the report",
    ),
    (rb"^(Focal Length|Principal point): +f?c?c? *= *\[", "what MATLAB's toolbox printed", "its Calib_Results.mat"),
    (rb"^fc = \[ *[-+.\d]+ *; *[-+.\d]+ *\];", "the text Calib_Results.m", "the Calib_Results.mat beside it"),
    (rb"^R(e-projection|MS) error reported by calibrateCamera", "what OpenCV's sample printed", "the file it wrote"),
    (rb"^ringpose[a-z -]*: \d+ of \d+ views used", "what ringpose printed", "the file of its --output"),
    (rb"(?i)^\s*<(!doctype )?html", "a page for people", "the camera file that was written with it"),
)
"""Texts of calibrators by a regular expression: what they are, and what to give instead."""


_CHARACTERISTIC_KEYS = {
    CameraFormat.RINGPOSE: {"ringpose"},
    CameraFormat.KALIBR: {_KALIBR_NAME},
    CameraFormat.ROS: {"camera_matrix", "K", "k"},
}
"""Top-level keys by which a YAML file of each format is recognised; one of them suffices."""


def _own_camera(values: Mapping[str, Any], file: str, name: str) -> Camera:
    """The camera in a camera.yaml, or in a rig.yaml with its block of the joint covariance of camera and planes."""
    schema = str(values["ringpose"])
    if not schema.startswith("rig/"):
        return ros.camera_of(Fields(file, values, ros.FILE_KEYS), schema=schema)
    fields = Fields(file, values)
    camera = ros.camera_of(fields.fields("camera", ros.CAMERA_KEYS))
    if camera.covariance is not None or not fields.has("covariance"):
        return camera
    names = fields.fields("covariance").texts("parameters")
    joint = ros.read_covariance(fields, names)
    own = [index for index, name in enumerate(names) if name in CAMERA_PARAMETERS]
    if joint is None or not own:
        return camera
    part = ParameterCovariance(parameters=tuple(names[index] for index in own), data=joint.data[np.ix_(own, own)])
    return replace(camera, covariance=part)


def _ros_camera(values: Mapping[str, Any], file: str, name: str) -> Camera:
    """The camera in a camera_info file, or in a message printed by `rostopic echo` or `ros2 topic echo`."""
    values = published_values(values if "camera_matrix" in values else message_values(values, file), file)
    no_model = {"distortion_model"} if _is_without_distortion(values) else set()
    given = {key: value for key, value in values.items() if key not in no_model}
    fields = Fields(file, {"camera_name": name, "distortion_model": "plumb_bob", **given})
    fields.known = ros.CAMERA_KEYS
    return ros.camera_of(fields)


def _is_without_distortion(values: Mapping[str, Any]) -> bool:
    """Whether model and coefficients are both empty, as drivers publish it for images that are not distorted."""
    coefficients = values.get("distortion_coefficients")
    return not values.get("distortion_model") and isinstance(coefficients, Mapping) and coefficients.get("data") == []


def _kalibr_camera(values: Mapping[str, Any], file: str, name: str) -> Camera:
    """The camera in a camchain file of Kalibr with one camera."""
    if len(values) > 1:
        raise DataError(file, f"has {len(values)} cameras, must have one", "keep the required one, as cam0")
    fields = Fields(file, values).fields(_KALIBR_NAME, _KALIBR_KEYS)
    fields.choice("camera_model", ("pinhole",))
    model = fields.choice("distortion_model", _KALIBR_LENGTHS)
    given = fields.vector("distortion_coeffs", _KALIBR_LENGTHS[model]) if _KALIBR_LENGTHS[model] else np.empty(0)
    width, height = fields.vector("resolution", 2).tolist()
    fx, fy, cx, cy = fields.vector("intrinsics", 4).tolist()
    size = Fields(file, {"image_width": int(width), "image_height": int(height)}, path=_KALIBR_NAME)
    return ros.pinhole_camera(size, _KALIBR_NAME, np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), given)


_READERS: dict[CameraFormat, Callable[[Any, str, str], Camera]] = {
    CameraFormat.RINGPOSE: _own_camera,
    CameraFormat.ROS: _ros_camera,
    CameraFormat.OPENCV: opencv_storage.camera_of,
    CameraFormat.KALIBR: _kalibr_camera,
    CameraFormat.MATLAB: matlab.camera_of,
}
"""Converters from the values in a file, its name (for messages), and a default name of the camera."""


def _kalibr_values(camera: Camera) -> dict[str, Any]:
    """The mapping that `_kalibr_camera` reads."""
    coefficients = camera.distortion_coefficients
    if np.any(coefficients[4:] != 0):
        finding = "radtan has only k1, k2, p1, p2, and this camera has more coefficients"
        raise DataError("kalibr", finding, "calibrate with --fix-k3")
    matrix = camera.camera_matrix
    return {
        _KALIBR_NAME: {
            "cam_overlaps": [],
            "camera_model": "pinhole",
            "distortion_coeffs": coefficients[:4],
            "distortion_model": "radtan",
            "intrinsics": [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]],
            "resolution": [camera.image_width, camera.image_height],
            "rostopic": f"/{camera.camera_name or _KALIBR_NAME}/image_raw",
        }
    }
