"""Cameras in OpenCV's FileStorage format: YAML or XML, and JSON, which is read only."""

from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files.camera_matrices import checked_matrix
from ringpose.files.fields import Fields
from ringpose.files.yaml import parsed
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera

_MATRIX, _COEFFICIENTS = "camera_matrix", "distortion_coefficients"
_MATRIX_KEYS = ("rows", "cols", "sizes", "dt", "data", "type_id")


def is_storage(text: bytes) -> bool:
    """Whether OpenCV's FileStorage wrote a file: its XML, its own YAML header, or its matrices, in YAML or JSON."""
    return text.startswith((b"%YAML:", b"<?xml", b"<opencv_storage")) or b"!!opencv-" in text or b'"opencv-' in text


def camera_of(text: bytes, file: str, name: str) -> Camera:
    """The camera under the keys that OpenCV's calibration samples write."""
    fields = Fields(file, _xml_values(text, file) if text.startswith(b"<") else parsed(_yaml_text(text), file))
    if not fields.has(_MATRIX):
        raise DataError(file, f"has no {_MATRIX}", "give a file with one camera, as OpenCV's calibration sample writes")
    if not (fields.has("image_width") and fields.has("image_height")):
        raise DataError(file, "does not say the size of the image", "add image_width: and image_height: to it")
    if fields.has("fisheye_model") and fields.number("fisheye_model") != 0:
        raise fields.problem("fisheye_model", "is set", "calibrate with plumb_bob or rational_polynomial")
    coefficients = _trimmed(fields, _storage_matrix(fields, _COEFFICIENTS, 1).ravel())
    return Camera(
        camera_name=name,
        image_width=fields.integer("image_width", least=1),
        image_height=fields.integer("image_height", least=1),
        camera_matrix=checked_matrix(fields, _storage_matrix(fields, _MATRIX, 3)),
        distortion_model="plumb_bob" if len(coefficients) == 5 else "rational_polynomial",
        distortion_coefficients=coefficients,
    )


def yaml_text(camera: Camera) -> bytes:
    """YAML with the header that every version of OpenCV reads."""
    matrices = ((_MATRIX, camera.camera_matrix), (_COEFFICIENTS, camera.distortion_coefficients[:, None]))
    lines = ["%YAML:1.0", "---", f"image_width: {camera.image_width}", f"image_height: {camera.image_height}"]
    for key, matrix in matrices:
        data = ", ".join(repr(value) for value in matrix.ravel().tolist())
        rows, columns = matrix.shape
        lines += [
            f"{key}: !!opencv-matrix",
            f"   rows: {rows}",
            f"   cols: {columns}",
            "   dt: d",
            f"   data: [ {data} ]",
        ]
    return "\n".join([*lines, ""]).encode()


def xml_text(camera: Camera) -> bytes:
    """XML as OpenCV itself writes it."""
    import cv2

    storage = cv2.FileStorage(".xml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.image_width)
    storage.write("image_height", camera.image_height)
    storage.write(_MATRIX, camera.camera_matrix)
    storage.write(_COEFFICIENTS, camera.distortion_coefficients[:, None])
    return storage.releaseAndGetString().encode()


def _trimmed(fields: Fields, given: Float64[Array, "given"]) -> Float64[Array, "kept"]:
    used = int(np.flatnonzero(given)[-1]) + 1 if given.any() else 0
    length = 5 if used <= 5 else 8
    if used > 8:
        raise fields.problem(_COEFFICIENTS, f"has {len(given)} numbers", "calibrate without thin prism and tilt terms")
    return np.concatenate([given, np.zeros(8)])[:length]


def _storage_matrix(fields: Fields, key: str, rows: int) -> Float64[Array, "row column"]:
    entry = fields.fields(key, _MATRIX_KEYS)
    if entry.has("sizes"):  # OpenCV 5 writes a vector so
        size = int(np.prod(entry.array("sizes", (None,))))
    else:
        size = entry.integer("rows", least=1) * entry.integer("cols", least=1)
    data = entry.vector("data", size)
    if rows == 3 and size != 9:
        raise fields.problem(key, f"has {size} numbers, must have 3 x 3")
    return data.reshape(rows, -1)


def _yaml_text(text: bytes) -> bytes:
    """Without the header of OpenCV 4, which is no YAML."""
    return text.partition(b"\n")[2] if text.startswith(b"%YAML:") else text


def _xml_values(text: bytes, file: str) -> dict[str, Any]:
    import cv2

    try:
        storage = cv2.FileStorage(text.decode(), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        values: dict[str, Any] = {}
        for key in (_MATRIX, _COEFFICIENTS):
            matrix = storage.getNode(key).mat()
            if matrix is not None:
                values[key] = {"rows": len(matrix), "cols": matrix.size // len(matrix), "data": matrix.ravel().tolist()}
        for key in ("image_width", "image_height", "fisheye_model"):
            if not storage.getNode(key).empty():
                values[key] = int(storage.getNode(key).real())
    except (cv2.error, UnicodeDecodeError, SystemError):
        raise DataError(file, "is no valid OpenCV FileStorage XML") from None
    return values
