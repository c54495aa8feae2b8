"""OpenCV's FileStorage (YAML, XML and JSON are read, YAML and XML written), with the keys of its calibration samples.

Files are not read by cv2.FileStorage, since damaged files can end the process: of 20000 files with up to seven wrong
bytes each, 6 in XML crashed it (OpenCV 4.10: already `<?xml version=`), others corrupted its heap, and deep nesting
overflows the stack in every version.
"""

import re
from contextlib import suppress
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files.cameras.ros import pinhole_camera
from ringpose.files.schema import Fields
from ringpose.files.yaml import parsed
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Camera

HEADER_4 = b"%YAML:1.0"
"""First line of the YAML that OpenCV 4 writes and that every version of OpenCV reads; it is not valid YAML."""

SIGNATURES, MATRIX_TAGS = (HEADER_4[:6], b"<?xml", b"<opencv_storage"), (b"!!opencv-", b'"opencv-')
"""First bytes of a file, one of which is found unless it is plain YAML or JSON, and the type of matrices in those."""

_MATRIX, _COEFFICIENTS = "camera_matrix", "distortion_coefficients"
_MATRIX_KEYS = ("rows", "cols", "sizes", "dt", "data", "type_id")
_LIST_KEYS = ("data", "sizes")

_WITHOUT_BLANK = re.compile(rb"((?:^|[{,])[ \t]*[A-Za-z_]\w*:)(?=[^\s])", re.MULTILINE)
"""A key without a blank after its colon, as OpenCV 2 writes and reads it; YAML requires one."""


def storage_values(text: bytes, file: str) -> Any:
    """The values of a file; a matrix is a mapping of `rows`, `cols` and `data`."""
    if not text.startswith(b"<"):
        if text.startswith(HEADER_4[:6]):
            text = b"\n" + text.partition(b"\n")[2]  # the line break keeps the numbers of the lines
        return parsed(_WITHOUT_BLANK.sub(rb"\1 ", text), file)
    from xml.etree import ElementTree

    try:
        root = ElementTree.fromstring(text)  # noqa: S314 (expat limits the expansion of entities)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise DataError(file, f"is not valid XML: {error}") from None
    values = {child.tag: _xml_value(child) for child in root}
    if len(values) < len(root):
        raise DataError(file, "has a key that occurs twice")
    return values


def camera_of(values: Any, file: str, name: str) -> Camera:
    """The camera with the keys that OpenCV's calibration samples write, of which version 2 has some in capitals."""
    fields = Fields(file, {str(key).lower(): value for key, value in Fields(file, values).values.items()})
    if not fields.has(_MATRIX):
        matrices = ", ".join(str(key) for key, value in values.items() if isinstance(value, dict) and "data" in value)
        finding = f"has no {_MATRIX}, but {matrices}" if matrices else f"has no {_MATRIX}"
        raise DataError(file, finding, f"name those of one camera {_MATRIX} and {_COEFFICIENTS}")
    if not (fields.has("image_width") and fields.has("image_height")):
        raise DataError(file, "does not have the size of the image", "add image_width: and image_height: to it")
    if fields.has("fisheye_model") and fields.number("fisheye_model") != 0:
        raise fields.problem("fisheye_model", "is set", "calibrate with plumb_bob or rational_polynomial")
    given = _storage_matrix(fields, _COEFFICIENTS, 1).ravel()
    used = int(np.flatnonzero(given)[-1]) + 1 if given.any() else 0
    if used > 8:
        finding = f"has {len(given)} numbers"
        raise fields.problem(_COEFFICIENTS, finding, "calibrate without thin prism and tilt terms")
    return pinhole_camera(fields, name, _storage_matrix(fields, _MATRIX, 3), given[:used])


def storage_text(camera: Camera, suffix: str) -> bytes:
    """The camera as XML if the suffix is .xml, else as YAML."""
    import cv2

    xml = suffix.lower() == ".xml"
    storage = cv2.FileStorage(".xml" if xml else ".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.image_width)
    storage.write("image_height", camera.image_height)
    storage.write(_MATRIX, camera.camera_matrix)
    storage.write(_COEFFICIENTS, camera.distortion_coefficients[:, None])
    text = storage.releaseAndGetString().encode()
    return text if xml else HEADER_4 + b"\n" + text.partition(b"\n")[2]


def _xml_value(element: Any) -> Any:
    """A mapping if the element has children, else a number, a text, or a list of them."""
    if len(element):
        return {child.tag: _xml_value(child) for child in element}
    words = [number_or_text(word) for word in (element.text or "").split()]
    return words if element.tag in _LIST_KEYS or len(words) != 1 else words[0]


def number_or_text(word: str) -> int | float | str:
    """The number that a word is, else the word without quotes."""
    for number in (int, float):
        with suppress(ValueError):
            return number(word)
    return word.strip('"')


def _storage_matrix(fields: Fields, key: str, rows: int) -> Float64[Array, "row column"]:
    entry = fields.fields(key, _MATRIX_KEYS)
    if entry.has("sizes"):  # a vector as OpenCV 5 writes it
        size = int(np.prod(entry.array("sizes", (None,))))
    else:
        size = entry.integer("rows", least=1) * entry.integer("cols", least=1)
    data = entry.vector("data", size)
    if rows == 3 and size != 9:
        raise fields.problem(key, f"has {size} numbers, must have 3 x 3")
    return data.reshape(rows, -1)
