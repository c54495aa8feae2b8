"""Cameras with the keys of ROS camera_info, as in camera.yaml and rig.yaml, and the check of camera matrices."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, cast

import numpy as np

from ringpose.errors import ImplausibleValueWarning
from ringpose.files import atomic
from ringpose.files.io import provenance
from ringpose.files.records import plain
from ringpose.files.records.codec import OF_FILE, RecordType, definition_of
from ringpose.files.schema import CAMERA, Fields, hint
from ringpose.files.yaml import write_yaml
from ringpose.geometry.rays import fold_px
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.plausible import CENTRAL_POINT, FOCAL_LENGTH, PRINCIPAL_POINT, TANGENTIAL
from ringpose.types.record import Key, Presence
from ringpose.types.rig import DISTORTION_COEFFICIENTS, Camera, ParameterCovariance, camera_parameters

SCHEMA = "camera/1"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matrix:
    """A matrix as ROS writes it."""

    rows: Annotated[int, Key("Number of rows.", least=0)]
    cols: Annotated[int, Key("Number of columns.", least=0)]
    data: Annotated[Float64[Array, "n"], Key("The numbers, row by row.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frustum:
    """The near plane of a virtual camera, as of glFrustum in OpenGL; in any one unit of length."""

    left: Annotated[
        float, Key("x of the plane's left border, to the right of the optical axis, in any unit of length.")
    ]
    right: Annotated[float, Key("x of its right border.")]
    bottom: Annotated[float, Key("y of its lower border, upwards from the optical axis as in OpenGL.")]
    top: Annotated[float, Key("y of its upper border.")]
    near: Annotated[float, Key("Its distance from the projection centre.", least=1e-6)]

    def camera_matrix(self, image_width: int, image_height: int) -> Float64[Array, "3 3"]:
        """The camera matrix of an image that fills the near plane (ringpose-conventions(7)).

        Its borders are half a pixel beyond the centres of the outermost pixels; y turns from upwards to downwards.
        """
        per_x, per_y = image_width / (self.right - self.left), image_height / (self.top - self.bottom)
        return np.array([
            [self.near * per_x, 0.0, -self.left * per_x - 0.5],
            [0.0, self.near * per_y, self.top * per_y - 0.5],
            [0.0, 0.0, 1.0],
        ])  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraInfo:
    """A camera with the keys of ROS camera_info."""

    image_width: Annotated[int, Key("Columns of the image.", least=1)]
    image_height: Annotated[int, Key("Rows of the image.", least=1)]
    camera_name: Annotated[str | None, Key("Name of the camera.", presence=Presence.IF_KNOWN)] = None
    camera_matrix: Annotated[
        Matrix | None,
        Key("[fx, 0, cx, 0, fy, cy, 0, 0, 1], in pixels; pixel (0, 0) is a centre.", presence=Presence.IF_KNOWN),
    ] = None
    frustum: Annotated[
        Frustum | None, Key("Instead of it, the near plane of a virtual camera.", presence=Presence.IF_KNOWN)
    ] = None
    distortion_model: Annotated[Literal["plumb_bob", "rational_polynomial"], Key("Distortion model by its ROS name.")]
    distortion_coefficients: Annotated[
        Matrix, Key("In the order of OpenCV: k1, k2, p1, p2, k3; for `rational_polynomial` also k4, k5, k6.")
    ]
    rectification_matrix: Annotated[
        Mapping[str, Any] | None, Key("Of ROS, for stereo: the identity; not read.", presence=Presence.IF_KNOWN)
    ] = None
    projection_matrix: Annotated[
        Mapping[str, Any] | None, Key("Of ROS, for stereo: [K | 0]; not read.", presence=Presence.IF_KNOWN)
    ] = None
    covariance: Annotated[
        ParameterCovariance | None, Key("Covariance of the camera's parameters alone.", presence=Presence.IF_KNOWN)
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFile(CameraInfo):
    """camera.yaml."""

    provenance: Annotated[
        Mapping[str, Any] | None, Key("Version, command, time and inputs.", presence=Presence.IF_KNOWN)
    ] = None
    standard_deviations: Annotated[
        Mapping[str, Any] | None, Key("Of the parameters, by name; informative.", presence=Presence.IF_KNOWN)
    ] = None
    quality: Annotated[
        Mapping[str, Any] | None, Key("How the calibration was assessed; informative.", presence=Presence.IF_KNOWN)
    ] = None


RECORD = RecordType(
    cls=CameraFile,
    kind=CAMERA,
    version=SCHEMA,
    description="camera.yaml: a camera with the keys of ROS camera_info. Pixels. Your own keys begin with x_.",
    is_file=True,
    strict=True,
)

CAMERA_KEYS = definition_of(CameraInfo).names
FILE_KEYS = ("ringpose", *definition_of(CameraFile).names)


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
        write_yaml(stream, head | stereo_values(camera) | dict(extra))


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
    return checked_camera(fields, definition_of(CameraInfo).read(fields, OF_FILE))


def checked_camera(fields: Fields, info: CameraInfo) -> Camera:
    """The camera that was read from `fields`; rejected if its matrix or lens is impossible."""
    coefficients = _coefficients(fields, info)
    matrix = _matrix(fields, info)
    camera = Camera(
        camera_name=info.camera_name or "",
        image_width=info.image_width,
        image_height=info.image_height,
        camera_matrix=checked_matrix(fields, matrix),
        distortion_model=info.distortion_model,
        distortion_coefficients=coefficients,
        covariance=checked_parameters(fields, info.covariance, camera_parameters(len(coefficients))),
    )
    return _checked_lens(fields, camera)


def camera_info(camera: Camera) -> CameraInfo:
    """The camera as it is written."""
    coefficients = camera.distortion_coefficients
    return CameraInfo(
        image_width=camera.image_width,
        image_height=camera.image_height,
        camera_name=camera.camera_name or None,
        camera_matrix=Matrix(rows=3, cols=3, data=camera.camera_matrix.ravel()),
        distortion_model=cast(Any, camera.distortion_model),
        distortion_coefficients=Matrix(rows=1, cols=len(coefficients), data=coefficients),
        covariance=camera.covariance,
    )


def camera_values(camera: Camera) -> dict[str, Any]:
    """The mapping that `camera_of` reads, in the order of ROS camera_info."""
    return definition_of(CameraInfo).write(camera_info(camera))


def stereo_values(camera: Camera) -> dict[str, Any]:
    """The mapping with ROS's stereo matrices too, which its camera_info_manager requires: the identity and [K | 0]."""
    projection = np.column_stack([camera.camera_matrix, np.zeros(3)])
    values = camera_values(camera)
    covariance = {key: values.pop(key) for key in ("covariance",) if key in values}
    return (
        values
        | {
            "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel()},
            "projection_matrix": {"rows": 3, "cols": 4, "data": projection.ravel()},
        }
        | covariance
    )


def _matrix(fields: Fields, info: CameraInfo) -> Float64[Array, "3 3"]:
    """The camera matrix, which is given itself or by a frustum."""
    if (info.camera_matrix is None) == (info.frustum is None):
        finding = "has neither camera_matrix nor frustum" if info.frustum is None else "has camera_matrix and frustum"
        raise fields.problem("", finding, "give one of them")
    if info.frustum is not None:
        for low, high in (("left", "right"), ("bottom", "top")):
            if not getattr(info.frustum, low) < getattr(info.frustum, high):
                raise fields.problem(f"frustum.{high}", f"must be greater than {low}", "y is upwards, as in OpenGL")
        return info.frustum.camera_matrix(info.image_width, info.image_height)
    assert info.camera_matrix is not None
    for name, count in (("rows", info.camera_matrix.rows), ("cols", info.camera_matrix.cols)):
        if count != 3:
            raise fields.problem(f"camera_matrix.{name}", f"is {count}, must be 3")
    return _numbers(fields, "camera_matrix", info.camera_matrix).reshape(3, 3)


def _numbers(fields: Fields, key: str, matrix: Matrix) -> Float64[Array, "n"]:
    """The numbers of a matrix; rejected if they are not as many as it has elements."""
    if len(matrix.data) != matrix.rows * matrix.cols:
        finding = f"has {len(matrix.data)} numbers, must have {matrix.rows * matrix.cols}"
        raise fields.problem(f"{key}.data", finding)
    return matrix.data


def _coefficients(fields: Fields, info: CameraInfo) -> Float64[Array, "n"]:
    model, given = info.distortion_model, _numbers(fields, "distortion_coefficients", info.distortion_coefficients)
    count = DISTORTION_COEFFICIENTS[model]
    if model == "plumb_bob" and len(given) in (0, 4):  # ROS and OpenCV omit coefficients that are zero
        return np.concatenate([given, np.zeros(count - len(given))])
    if len(given) != count:
        raise fields.problem("distortion_coefficients", f"has {len(given)} numbers, {model} has {count}")
    return given


def checked_parameters(
    parent: Fields, covariance: ParameterCovariance | None, known: Sequence[str]
) -> ParameterCovariance | None:
    """The covariance of a camera or rig, whose parameters must be known ones; `parent` names the place in messages."""
    if covariance is None:
        return None
    fields, names = parent.fields("covariance"), covariance.parameters
    for name in names:
        if name not in known:
            raise fields.problem("parameters", f"unknown parameter {name!r}", hint(name, known))
    if len(set(names)) != len(names):
        raise fields.problem("parameters", "a parameter occurs twice")
    if len(covariance.data) != len(names):
        size = len(covariance.data)
        raise fields.problem("data", f"has {size} x {size} numbers, must have {len(names)} x {len(names)}")
    return covariance


def read_covariance(parent: Fields, known: Sequence[str]) -> ParameterCovariance | None:
    """The covariance under the optional key `covariance`; see `checked_parameters`."""
    if not parent.has("covariance"):
        return None
    covariance = definition_of(ParameterCovariance).read(parent.fields("covariance"), OF_FILE)
    return checked_parameters(parent, covariance, known)


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
    finding = f"has its principal point at ({principal_px[0]:g}, {principal_px[1]:g})"
    if not all(map(PRINCIPAL_POINT.holds, offset)):
        raise fields.problem("camera_matrix", f"{finding}, far outside the image")
    if all(map(CENTRAL_POINT.holds, offset)):
        return
    remedy = "check the order fx, 0, cx, 0, fy, cy and the image's size, unless the image is a window of the sensor's"
    if 2 * np.abs(principal_px[::-1] / size - 0.5).max() < np.abs(offset).max():
        remedy = "cx and cy are probably exchanged"
    middle = f"({size[0] / 2:g}, {size[1] / 2:g})"
    line = str(fields.problem("camera_matrix", f"{finding}, far from the image's middle {middle}", remedy))
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
    finding = f"folds the image: beyond the pixel ({at_px[0]:.0f}, {at_px[1]:.0f}) pixels have no ray, or several"
    raise fields.problem("distortion_coefficients", finding, remedy)
