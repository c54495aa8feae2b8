"""Cameras written in the formats of other programs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.files import atomic, kalibr, matlab, opencv_storage
from ringpose.files.camera_format import CameraFormat
from ringpose.files.cameras import camera_values, write_camera
from ringpose.files.yaml import write_yaml
from ringpose.types.camera import Camera


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
