"""Cameras with the keys of ROS camera_info, as in camera.yaml and rig.yaml, and the check of camera matrices."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ringpose.errors import ImplausibleValueWarning
from ringpose.files import atomic
from ringpose.files.io import provenance
from ringpose.files.records import plain
from ringpose.files.schema import Fields, checked_covariance, hint
from ringpose.files.yaml import write_yaml
from ringpose.geometry.rays import fold_px
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.plausible import CENTRAL_POINT, FOCAL_LENGTH, PRINCIPAL_POINT, TANGENTIAL
from ringpose.types.rig import DISTORTION_COEFFICIENTS, Camera, ParameterCovariance, camera_parameters

SCHEMA = "camera/1"

CAMERA_KEYS = (
    "image_width",
    "image_height",
    "camera_name",
    "camera_matrix",
    "distortion_model",
    "distortion_coefficients",
    "rectification_matrix",
    "projection_matrix",
    "covariance",
)
"""Keys of ROS camera_info; the two stereo matrices are accepted but not read."""

FILE_KEYS = ("ringpose", "provenance", "standard_deviations", "quality", *CAMERA_KEYS)

_MATRIX_KEYS = ("rows", "cols", "data")


def write_camera(
    path: Path,
    camera: Camera,
    *,
    extra: Mapping[str, Any] = MappingProxyType({}),
    force: bool = False,
    inputs: Iterable[Path] = (),
) -> None:
    """Write camera.yaml; `extra` has the informative keys `standard_deviations` and `quality`.

    A camera that `read_camera` would reject is not written.
    """
    head, values = {"ringpose": SCHEMA, "provenance": provenance(inputs)}, camera_values(camera)
    with without_hints():
        camera_of(Fields(str(path), plain(values), CAMERA_KEYS))
    with atomic.replacing(path, force) as stream:
        write_yaml(stream, head | values | dict(extra))


@contextmanager
def without_hints() -> Iterator[None]:
    """No warnings of implausible values, since they were given when the values were read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ImplausibleValueWarning)
        yield


def camera_of(fields: Fields, schema: str = SCHEMA) -> Camera:
    """The camera in a mapping with the keys of ROS camera_info."""
    if schema != SCHEMA:
        raise fields.problem("ringpose", f"is {schema!r}, must be {SCHEMA!r}", "give a camera.yaml or a rig.yaml")
    coefficients = _coefficients(fields)
    camera = Camera(
        camera_name=fields.text("camera_name") if fields.has("camera_name") else "",
        image_width=fields.integer("image_width", least=1),
        image_height=fields.integer("image_height", least=1),
        camera_matrix=checked_matrix(fields, _matrix(fields, "camera_matrix", (3, 3)).reshape(3, 3)),
        distortion_model=fields.choice("distortion_model", DISTORTION_COEFFICIENTS),
        distortion_coefficients=coefficients,
        covariance=read_covariance(fields, camera_parameters(len(coefficients))),
    )
    return _checked_lens(fields, camera)


def camera_values(camera: Camera) -> dict[str, Any]:
    """The mapping that `camera_of` reads, in the order of ROS camera_info."""
    coefficients = camera.distortion_coefficients
    values: dict[str, Any] = {
        "image_width": camera.image_width,
        "image_height": camera.image_height,
        "camera_name": camera.camera_name or None,
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.camera_matrix.ravel()},
        "distortion_model": camera.distortion_model,
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients},
    }
    if camera.covariance is not None:
        values["covariance"] = covariance_values(camera.covariance)
    return {key: value for key, value in values.items() if value is not None}


def _coefficients(fields: Fields) -> Float64[Array, "n"]:
    model = fields.choice("distortion_model", DISTORTION_COEFFICIENTS)
    count = DISTORTION_COEFFICIENTS[model]
    given = _matrix(fields, "distortion_coefficients", (None, None))
    if model == "plumb_bob" and len(given) in (0, 4):  # ROS and OpenCV omit coefficients that are zero
        return np.concatenate([given, np.zeros(count - len(given))])
    if len(given) != count:
        raise fields.problem("distortion_coefficients", f"has {len(given)} numbers, {model} has {count}")
    return given


def _matrix(fields: Fields, key: str, shape: tuple[int | None, int | None]) -> Float64[Array, "n"]:
    entry = fields.fields(key, _MATRIX_KEYS)
    rows, columns = entry.integer("rows", least=0), entry.integer("cols", least=0)
    for name, found, expected in (("rows", rows, shape[0]), ("cols", columns, shape[1])):
        if expected is not None and found != expected:
            raise entry.problem(name, f"is {found}, must be {expected}")
    return entry.vector("data", rows * columns)


def read_covariance(parent: Fields, known: Sequence[str]) -> ParameterCovariance | None:
    """The covariance under the optional key `covariance` of a camera or rig; its parameters must be known ones."""
    if not parent.has("covariance"):
        return None
    fields = parent.fields("covariance", ("parameters", "data"))
    names = fields.texts("parameters")
    for name in names:
        if name not in known:
            raise fields.problem("parameters", f"unknown parameter {name!r}", hint(name, known))
    if len(set(names)) != len(names):
        raise fields.problem("parameters", "a parameter occurs twice")
    data = checked_covariance(fields, "data", fields.array("data", (len(names), len(names))))
    return ParameterCovariance(parameters=names, data=data)


def covariance_values(covariance: ParameterCovariance) -> dict[str, Any]:
    """The mapping that `read_covariance` reads."""
    return {"parameters": list(covariance.parameters), "data": covariance.data}


def pinhole_camera(
    fields: Fields, name: str, matrix: Float64[Array, "3 3"], coefficients: Float64[Array, "n"]
) -> Camera:
    """The camera of another program's file, with up to 5 coefficients of plumb_bob or 8 of rational_polynomial.

    The size of the image is in `fields`; missing coefficients are zero.
    """
    model = "plumb_bob" if len(coefficients) <= 5 else "rational_polynomial"
    missing = DISTORTION_COEFFICIENTS[model] - len(coefficients)
    camera = Camera(
        camera_name=name,
        image_width=fields.integer("image_width", least=1),
        image_height=fields.integer("image_height", least=1),
        camera_matrix=checked_matrix(fields, matrix),
        distortion_model=model,
        distortion_coefficients=np.concatenate([coefficients, np.zeros(missing)]),
    )
    return _checked_lens(fields, camera)


MAX_PIXELS = 100_000
"""Maximum number of columns or rows of an image."""


def checked_matrix(fields: Fields, matrix: Float64[Array, "3 3"]) -> Float64[Array, "3 3"]:
    """The camera matrix; rejected if it is not plausible for a pinhole camera."""
    if not matrix[:2].any():
        raise fields.problem("camera_matrix", "is all zeros: the camera is not calibrated", "calibrate it first")
    if np.any(matrix[[0, 1, 2, 2], [1, 0, 0, 1]] != 0) or matrix[2, 2] != 1:
        raise fields.problem("camera_matrix", "must have the form [fx, 0, cx, 0, fy, cy, 0, 0, 1]")
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise fields.problem("camera_matrix", "has a focal length that is not positive")
    size = np.array([fields.integer(key, least=1, most=MAX_PIXELS) for key in ("image_width", "image_height")])
    if not all(map(FOCAL_LENGTH.holds, (np.diag(matrix)[:2] / size).tolist())):
        shortest = min(matrix[0, 0], matrix[1, 1])
        raise fields.problem("camera_matrix", f"has a focal length of {shortest:g} pixels", "give pixels, not mm")
    _check_principal_point(fields, matrix[:2, 2], size)
    return matrix


def _check_principal_point(fields: Fields, principal_px: Float64[Array, "xy=2"], size: Int64[Array, "xy=2"]) -> None:
    """Reject a principal point far outside the image, and warn of one far from its middle."""
    offset: list[float] = (principal_px / size - 0.5).tolist()
    found = f"has its principal point at ({principal_px[0]:g}, {principal_px[1]:g})"
    if not all(map(PRINCIPAL_POINT.holds, offset)):
        raise fields.problem("camera_matrix", f"{found}, far outside the image")
    if all(map(CENTRAL_POINT.holds, offset)):
        return
    remedy = "check the order fx, 0, cx, 0, fy, cy and the image's size, unless the image is a window of the sensor's"
    if 2 * np.abs(principal_px[::-1] / size - 0.5).max() < np.abs(offset).max():
        remedy = "cx and cy are probably exchanged"
    middle = f"({size[0] / 2:g}, {size[1] / 2:g})"
    line = str(fields.problem("camera_matrix", f"{found}, far from the image's middle {middle}", remedy))
    warnings.warn(line, ImplausibleValueWarning, stacklevel=2)


def _checked_lens(fields: Fields, camera: Camera) -> Camera:
    """The camera; rejected if its lens does not map rays one-to-one to the pixels of the image."""
    at_px = fold_px(camera)
    if at_px is None:
        return camera
    p1, p2 = camera.distortion_coefficients[2:4].tolist()
    remedy = "the order is k1, k2, p1, p2, k3; calibrate with --fix-k3, or with the board in the corners, too"
    if not (TANGENTIAL.holds(p1) and TANGENTIAL.holds(p2)):
        remedy = f"the order is k1, k2, p1, p2, k3, and p1 = {p1:g}, p2 = {p2:g} look like radial coefficients"
    found = f"folds the image: beyond the pixel ({at_px[0]:.0f}, {at_px[1]:.0f}) pixels have no ray, or several"
    raise fields.problem("distortion_coefficients", found, remedy)
