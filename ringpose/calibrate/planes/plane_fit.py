"""One laser's plane through its points of all views, and what each view says about it.

Light planes through triangulated stripe centres (ringpose-method(7), section 6).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.planes import nearest_plane
from ringpose.geometry.robust import robust_std
from ringpose.types.arrays import Array, Float64
from ringpose.types.calibration import LaserCalibration, LaserView
from ringpose.types.options import PlanesMethod

MAX_CONDITION = 50.0
"""Points this many times longer than wide lie on a line: views 100 mm long must differ by 2 mm across it."""

MIN_MEAN_WEIGHT = 0.1
"""A view whose points get less weight than this on average lies beside the plane of the others."""

MAX_SCATTER = 0.02
"""Root mean square distance from the plane, as a share of the points' extent, above which they are not its stripe."""

Points = Float64[Array, "_ xyz=3"]
"""Triangulated centres of one view; none where the laser is not seen."""


def condition(points: Float64[Array, "n xyz=3"], weights: Float64[Array, "n"]) -> float:
    """Extent of the points along their longest direction over that across it, in their plane.

    Infinite for points on one line, which leave the plane open.
    """
    _, _, (along, across, _) = nearest_plane(points, weights)
    return float(along / across) if across > 0 else float("inf")


class FittedPlane(NamedTuple):
    """A plane `normal . point = distance_m` through points, and how well they determine it."""

    normal: Float64[Array, "xyz=3"]
    distance_m: float
    condition: float


def fitted_plane(name: str, points: Sequence[Points], method: PlanesMethod) -> FittedPlane:
    """The plane through a laser's points of all views; refused with the remedy where they determine none."""
    seen = sum(len(own) > 0 for own in points)
    if seen == 0:
        remedy = "see that its stripe crosses the board; add views at two distances, 50 mm or more apart"
        raise DataError(_place(name), "no view shows its stripe on the board", remedy)
    every = np.concatenate(points)
    normal, distance_m, weights = light_plane(every, method)
    spread = condition(every, weights)
    if spread > MAX_CONDITION:
        lying = "its one view lie" if seen == 1 else f"its {seen} views lie"
        found = f"the points of {lying} on one line (condition {spread:.0f}), which determines no plane"
        raise DataError(_place(name), found, _another_view(every))
    rms_m = _rms(every @ normal - distance_m)
    if rms_m > MAX_SCATTER * extent_m(every):
        found = f"the points of its {seen} views lie on no common plane (rms {1e3 * rms_m:.1f} mm)"
        remedy = "see with --overlay whether these stripes are the laser's, and none are exchanged in one of the shots"
        raise DataError(_place(name), found, remedy)
    return FittedPlane(normal, distance_m, spread)


def plane_without(points: Sequence[Points], left_out: int, method: PlanesMethod) -> FittedPlane | None:
    """The plane of the other views; None where those determine none."""
    if not determined_without(points, left_out):
        return None
    every = np.concatenate([own for index, own in enumerate(points) if index != left_out])
    normal, distance_m, weights = light_plane(every, method)
    return FittedPlane(normal, distance_m, condition(every, weights))


def determined_without(points: Sequence[Points], left_out: int) -> bool:
    """Whether the other views determine the plane."""
    every = np.concatenate([*(own for index, own in enumerate(points) if index != left_out), np.empty((0, 3))])
    return len(every) > 2 and condition(every, np.ones(len(every))) < MAX_CONDITION


def laser_calibration(
    name: str, plane: FittedPlane, views: Sequence[LaserView], disagreement: float = float("nan")
) -> LaserCalibration:
    """The plane with what the views say about it."""
    residual_m = np.concatenate([view.residual_m for view in views])
    held_out_m = np.concatenate([view.held_out_m for view in views])
    known_m = held_out_m[np.isfinite(held_out_m)]
    return LaserCalibration(
        name=name,
        normal=plane.normal,
        distance_m=plane.distance_m,
        views=tuple(views),
        rms_m=_rms(residual_m),
        held_out_rms_m=_rms(known_m) if len(known_m) else float("nan"),
        condition=plane.condition,
        disagreement=disagreement,
    )


def outlying_views(points: Sequence[Points]) -> dict[int, float]:
    """Views that lie beside the plane of the others, with how far (m, rms); none where fewer than three are left."""
    seen = [index for index, own in enumerate(points) if len(own)]
    if len(seen) < 4:
        return {}
    every = np.concatenate([points[index] for index in seen])
    normal, distance_m, weights = robust_plane(every, _start_plane([points[index] for index in seen]))
    by_view = np.split(weights, np.cumsum([len(points[index]) for index in seen])[:-1])
    return {
        index: _rms(points[index] @ normal - distance_m)
        for index, weight in zip(seen, by_view, strict=True)
        if weight.mean() < MIN_MEAN_WEIGHT
    }


def _start_plane(views: Sequence[Points]) -> tuple[Float64[Array, "3"], float]:
    """The plane of all views but one that half of the views lie nearest to; of all, a stray one draws it aside."""
    others = [np.concatenate([*views[:index], *views[index + 1 :]]) for index in range(len(views))]
    planes = [nearest_plane(every)[:2] for every in others]
    return min(planes, key=lambda plane: float(np.median([_rms(own @ plane[0] - plane[1]) for own in views])))


def _another_view(points: Float64[Array, "n xyz=3"]) -> str:
    return f"add a view of the board 50 mm or more nearer or farther than {points[:, 2].mean():.2f} m"


def _place(name: str) -> str:
    return f'laser "{name}"'


def _rms(distances_m: Float64[Array, "n"]) -> float:
    return float(np.sqrt(np.mean(distances_m**2)))


_TUKEY = 4.685
"""Tukey's constant: 95 % efficient on normal errors."""

_ITERATIONS = 20

_MIN_SCALE_M = 1e-9
"""Scale below which points are exact, so that rounding is not taken for outliers."""


def light_plane(
    points: Float64[Array, "n xyz=3"], method: PlanesMethod
) -> tuple[Float64[Array, "3"], float, Float64[Array, "n"]]:
    """Unit normal, distance and the points' weights by one of the methods."""
    return paper_plane(points) if method is PlanesMethod.PAPER else robust_plane(points)


def robust_plane(
    points: Float64[Array, "n xyz=3"], start: tuple[Float64[Array, "3"], float] | None = None
) -> tuple[Float64[Array, "3"], float, Float64[Array, "n"]]:
    """Unit normal, distance and weights of the plane nearest to most points: total least squares, re-weighted.

    It starts from the plane nearest to all, or from another.
    """
    weights = np.ones(len(points))
    normal, distance_m = nearest_plane(points)[:2] if start is None else start
    for _ in range(_ITERATIONS):
        residual = points @ normal - distance_m
        scale = max(robust_std(residual), _MIN_SCALE_M)
        moved = np.clip(1 - (residual / (_TUKEY * scale)) ** 2, 0.0, None) ** 2
        normal, distance_m, _ = nearest_plane(points, moved)
        if np.abs(moved - weights).max() < 1e-6:
            break
        weights = moved
    return *downward(normal, distance_m), weights


def paper_plane(points: Float64[Array, "n xyz=3"]) -> tuple[Float64[Array, "3"], float, Float64[Array, "n"]]:
    """The paper's form S . P = 1 by least squares, as unit normal and distance; all weights one.

    It minimises no distance: |S| comes out too large when points scatter, and a plane through the camera has no S.
    """
    scaled, _, _, _ = np.linalg.lstsq(points, np.ones(len(points)), rcond=None)
    length = float(np.linalg.norm(scaled))
    return *downward(scaled / length, 1 / length), np.ones(len(points))


def downward(normal: Float64[Array, "3"], distance_m: float) -> tuple[Float64[Array, "3"], float]:
    """The same plane with its normal's largest component positive, so that two calibrations compare."""
    if normal[np.argmax(np.abs(normal))] < 0:
        return -normal, -distance_m
    return normal, distance_m


def extent_m(points: Float64[Array, "n xyz=3"]) -> float:
    """Root mean square distance of the points from their middle."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
