"""Cameras in files: the project's own, and those of other programs, read and written."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic, kalibr, matlab, opencv_storage
from ringpose.files.bytes import read_bytes
from ringpose.files.camera_format import CameraFormat
from ringpose.files.cameras import CAMERA_KEYS, FILE_KEYS, camera_of, camera_values, write_camera
from ringpose.files.covariances import read_covariance
from ringpose.files.fields import Fields
from ringpose.files.yaml import parsed, write_yaml
from ringpose.types.camera import Camera
from ringpose.types.covariance import CAMERA_PARAMETERS, ParameterCovariance

_MESSAGE_END = re.compile(rb"\n---\s*\Z")
"""The line that `ros2 topic echo` prints behind each message, where nothing follows."""


def read_camera(path: Path) -> Camera:
    """The camera of a camera.yaml or rig.yaml, or of a file of ROS, OpenCV, Kalibr or MATLAB, told by its content."""
    text, file = read_bytes(path), str(path)
    if opencv_storage.is_storage(text):
        return opencv_storage.camera_of(text, file, path.stem)
    if matlab.is_mat(text):
        return matlab.camera_of_mat(text, file, path.stem)
    if matlab.is_script(text):
        return matlab.camera_of_script(text, file, path.stem)
    values = parsed(_MESSAGE_END.sub(b"\n", text), file)
    if kalibr.is_camchain(values):
        return kalibr.camera_of(values, file)
    schema = str(values.get("ringpose", "")) if isinstance(values, Mapping) else ""
    if schema.startswith("rig/"):
        return _camera_of_rig(Fields(file, values))
    if not schema:
        said = {"camera_name": path.stem, "distortion_model": "plumb_bob"} | _ros_mapping(values, file)
        foreign = Fields(file, said)
        foreign.known = CAMERA_KEYS
        return camera_of(foreign)
    return camera_of(Fields(file, values, FILE_KEYS), schema=schema)


def write_camera_as(path: Path, camera: Camera, form: CameraFormat, source: Path, *, force: bool = False) -> None:
    """Write a camera that was read from `source`; the covariance goes with it in ringpose's own format alone."""
    if form is CameraFormat.RINGPOSE:
        write_camera(path, camera, force=force, inputs=[source])
        return
    content = _content(path, camera, form)
    with atomic.replacing(path, force) as stream:
        if isinstance(content, bytes):
            stream.write(content)
        else:
            write_yaml(stream, content)


def _camera_of_rig(fields: Fields) -> Camera:
    """With its part of the joint covariance of camera and planes."""
    camera = camera_of(fields.fields("camera", CAMERA_KEYS))
    if camera.covariance is not None or not fields.has("covariance"):
        return camera
    names = fields.fields("covariance").texts("parameters")
    joint = read_covariance(fields, names)
    own = [index for index, name in enumerate(names) if name in CAMERA_PARAMETERS]
    if joint is None or not own:
        return camera
    part = ParameterCovariance(parameters=tuple(names[index] for index in own), data=joint.data[np.ix_(own, own)])
    return replace(camera, covariance=part)


def _content(path: Path, camera: Camera, form: CameraFormat) -> bytes | dict[str, Any]:
    """Bytes, or what is written as YAML."""
    if form is CameraFormat.OPENCV:
        xml = path.suffix.lower() == ".xml"
        return opencv_storage.xml_text(camera) if xml else opencv_storage.yaml_text(camera)
    if form is CameraFormat.KALIBR:
        return kalibr.camera_values(camera)
    if form is CameraFormat.MATLAB:
        return matlab.mat(camera) if path.suffix.lower() == ".mat" else matlab.script(camera).encode()
    return _ros_values(camera)


def _ros_values(camera: Camera) -> dict[str, Any]:
    """With the two matrices of a stereo pair, of which a single camera's change nothing."""
    matrix = camera.camera_matrix
    return camera_values(replace(camera, covariance=None)) | {
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": np.column_stack([matrix, np.zeros(3)]).ravel()},
    }


def _ros_mapping(values: object, file: str) -> dict[str, Any]:
    """The keys of camera_info files, also from a message, as `rostopic echo` and `ros2 topic echo` print it."""
    if isinstance(values, Mapping) and ("K" in values or "k" in values):
        values = _of_message({str(key).lower(): value for key, value in values.items()}, file)
    if not isinstance(values, Mapping) or "camera_matrix" not in values:
        raise DataError(
            file, "is no camera", "give a camera.yaml, rig.yaml, or a file of ROS, OpenCV, Kalibr or MATLAB"
        )
    return dict(values)


def _of_message(message: dict[str, Any], file: str) -> dict[str, Any]:
    fields = Fields(file, message)
    coefficients = fields.array("d", (None,))
    return {
        "image_width": fields.raw("width"),
        "image_height": fields.raw("height"),
        "distortion_model": fields.raw("distortion_model"),
        "camera_matrix": {"rows": 3, "cols": 3, "data": fields.raw("k")},
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients.tolist()},
    }
