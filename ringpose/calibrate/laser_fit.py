"""One laser's plane through its points of all views, and what each view says about it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from ringpose.calibrate.plane_fits import PlanesMethod, condition, extent_m, light_plane
from ringpose.errors import DataError
from ringpose.types.arrays import Array
from ringpose.types.calibration import LaserCalibration, LaserView

LARGEST_CONDITION = 50.0
"""Points this many times longer than wide lie on a line: views 100 mm long must differ by 2 mm across it."""

LEAST_MEAN_WEIGHT = 0.1
"""A view whose points get less weight than this on average lies beside the plane of the others."""

LARGEST_SCATTER = 0.02
"""Root mean square distance from the plane, as a share of the points' extent, above which they are not its stripe."""

Points = Float64[Array, "_ xyz=3"]
"""Triangulated centres of one view; none where the laser is not seen."""


def laser_calibration(
    name: str, points: Sequence[Points], views: Sequence[str], method: PlanesMethod
) -> LaserCalibration:
    """The plane through the points of all views, with their distances from it and from the plane of the others."""
    seen = [index for index, own in enumerate(points) if len(own)]
    _require_views(name, len(seen))
    every = np.concatenate([points[index] for index in seen])
    normal, distance_m, weights = light_plane(every, method)
    spread = condition(every, weights)
    if spread > LARGEST_CONDITION:
        lying = "its one view lie" if len(seen) == 1 else f"its {len(seen)} views lie"
        found = f"the points of {lying} on one line (condition {spread:.0f}), which determines no plane"
        raise DataError(_place(name), found, _another_view(every))
    rms_m = _rms(every @ normal - distance_m)
    if rms_m > LARGEST_SCATTER * extent_m(every):
        found = f"the points of its {len(seen)} views lie on no common plane (rms {1e3 * rms_m:.1f} mm)"
        raise DataError(_place(name), found, "see with --overlay whether these stripes are the laser's")

    held_out_m = [_held_out_m(points, seen, index, method) for index in seen]
    by_view = np.split(weights, np.cumsum([len(points[index]) for index in seen])[:-1])
    return LaserCalibration(
        name=name,
        normal=normal,
        distance_m=distance_m,
        views=tuple(
            _view(views[index], points[index], weight, points[index] @ normal - distance_m, other)
            for index, weight, other in zip(seen, by_view, held_out_m, strict=True)
        ),
        rms_m=rms_m,
        held_out_rms_m=_rms(np.concatenate(held_out_m)),
        condition=spread,
    )


def _view(
    name: str,
    points: Float64[Array, "n xyz=3"],
    weights: Float64[Array, "n"],
    residual_m: Float64[Array, "n"],
    held_out_m: Float64[Array, "n"],
) -> LaserView:
    return LaserView(name=name, points=points, weights=weights, rms_m=_rms(residual_m), held_out_rms_m=_rms(held_out_m))


def outlying_views(points: Sequence[Points], method: PlanesMethod) -> dict[int, str]:
    """Views that lie beside the plane of the others, with how far; none where fewer than three views are left."""
    seen = [index for index, own in enumerate(points) if len(own)]
    if len(seen) < 4 or method is PlanesMethod.PAPER:
        return {}
    every = np.concatenate([points[index] for index in seen])
    normal, distance_m, weights = light_plane(every, method)
    by_view = np.split(weights, np.cumsum([len(points[index]) for index in seen])[:-1])
    return {
        index: f"{1e3 * _rms(points[index] @ normal - distance_m):.2f} mm beside the plane of the other views"
        for index, weight in zip(seen, by_view, strict=True)
        if weight.mean() < LEAST_MEAN_WEIGHT
    }


def _require_views(name: str, views: int) -> None:
    if views == 0:
        remedy = "see that its stripe crosses the board; add views at two distances, 50 mm or more apart"
        raise DataError(_place(name), "no view shows its stripe on the board", remedy)


def _another_view(points: Float64[Array, "n xyz=3"]) -> str:
    return f"add a view of the board 50 mm or more nearer or farther than {points[:, 2].mean():.2f} m"


def _place(name: str) -> str:
    return f'laser "{name}"'


def _held_out_m(
    points: Sequence[Points], seen: Sequence[int], left_out: int, method: PlanesMethod
) -> Float64[Array, "n"]:
    """Distances of one view's points from the plane of the other views; NaN where those determine none."""
    own = points[left_out]
    others = [points[index] for index in seen if index != left_out]
    if others:
        every = np.concatenate(others)
        normal, distance_m, weights = light_plane(every, method)
        if condition(every, weights) < LARGEST_CONDITION:
            return own @ normal - distance_m
    return np.full(len(own), np.nan)


def _rms(distances_m: Float64[Array, "n"]) -> float:
    known = distances_m[np.isfinite(distances_m)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
