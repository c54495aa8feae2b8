"""How the light planes lie to one another: what the maker of the lasers said can be held against it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np

from ringpose.calibrate.laser_names import THREE
from ringpose.geometry.rotations import angle_between, tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.calibration import PlanesCalibration
from ringpose.types.covariance import laser_parameters


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneAngle:
    """The angle between two neighbouring light planes, and the line that they share."""

    first: str
    second: str
    angle_rad: float
    sd_rad: float
    """NaN where there is no covariance."""
    line_point_m: Float64[Array, "xyz=3"]
    """The point of their common line that is nearest to the camera; one projector stands on all such lines."""
    line_direction: Float64[Array, "xyz=3"]


def plane_angles(calibration: PlanesCalibration) -> list[PlaneAngle]:
    """Of neighbours, in the order of the lasers; none with one laser."""
    return [_angle(calibration, first, first + 1) for first, _ in pairwise(range(len(calibration.lasers)))]


def middle_outside_rad(calibration: PlanesCalibration) -> float | None:
    """By how much the plane that is called middle lies outside those called left and right; None without such names.

    The plane between two others makes a smaller angle with each than they make with each other.
    """
    planes = dict(zip(calibration.planes.names, calibration.planes.normal, strict=True))
    if set(planes) != set(THREE):
        return None
    left, middle, right = (planes[name] for name in THREE)
    inner = max(float(angle_between(left, middle)), float(angle_between(middle, right)))
    return max(inner - float(angle_between(left, right)), 0.0)


def order_with_angles(
    calibration: PlanesCalibration, expected_rad: Sequence[float], tolerance_rad: float
) -> tuple[str, ...] | None:
    """Another order of the lasers whose neighbours have the expected angles; None if none has, or the own one has."""
    normals = calibration.planes.normal
    angles = np.array([[float(angle_between(own, other)) for other in normals] for own in normals])
    for way in permutations(range(len(normals))):
        found = np.array([angles[pair] for pair in pairwise(way)])
        if np.all(np.abs(found - np.array(expected_rad)) < tolerance_rad):
            return tuple(calibration.planes.names[laser] for laser in way) if way != tuple(sorted(way)) else None
    return None


def common_line_gap_m(angles: list[PlaneAngle]) -> float:
    """Largest distance between neighbouring planes' lines, at their points nearest to the camera; NaN for one line."""
    points = [angle.line_point_m for angle in angles]
    return max((float(np.linalg.norm(after - before)) for before, after in pairwise(points)), default=float("nan"))


def _angle(calibration: PlanesCalibration, first: int, second: int) -> PlaneAngle:
    normals, distances_m = calibration.planes.normal, calibration.planes.distance_m
    pair = normals[[first, second]]
    direction = np.cross(*pair)
    length = float(np.linalg.norm(direction))
    point, *_ = np.linalg.lstsq(pair, distances_m[[first, second]], rcond=1e-9)
    return PlaneAngle(
        first=calibration.lasers[first].name,
        second=calibration.lasers[second].name,
        angle_rad=float(angle_between(pair[0], pair[1])),
        sd_rad=_angle_sd_rad(calibration, first, second),
        line_point_m=point,
        line_direction=direction / length if length > 0 else np.full(3, np.nan),
    )


def _angle_sd_rad(calibration: PlanesCalibration, first: int, second: int) -> float:
    """To first order: each normal's tilt towards the other changes the angle by as much."""
    covariance = calibration.covariance
    if covariance is None:
        return float("nan")
    names = [name for laser in (first, second) for name in laser_parameters([calibration.lasers[laser].name])[:2]]
    places = [covariance.parameters.index(name) for name in names]
    own, other = calibration.planes.normal[[first, second]]
    jacobian = np.concatenate([-_towards(own, other), -_towards(other, own)])
    return float(np.sqrt(max(jacobian @ covariance.data[np.ix_(places, places)] @ jacobian, 0.0)))


def _towards(normal: Float64[Array, "xyz=3"], other: Float64[Array, "xyz=3"]) -> Float64[Array, "2"]:
    """Direction in the tilt basis of `normal` that leads to the other normal; zero if they are one."""
    leaning = tilt_basis(normal) @ other
    length = float(np.linalg.norm(leaning))
    return leaning / length if length > 0 else leaning
