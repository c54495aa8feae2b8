"""Shots whose frames name the wrong lasers: their stripes lie on the light planes of others.

A late or miswired switch gives every frame of a shot its neighbour's laser. Each shot by itself looks right; only
against the others do its stripes lie on other planes. Which planes there are is searched with the shots' labels free;
the labels that most shots share are the true ones.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.planes import nearest_plane
from ringpose.types.arrays import Array, Float64, Int64

DECISION = 3.0
"""Other labels are believed where stripes lie this many times nearer to their planes than by their own labels ..."""

LEAST_GAIN_M = 5e-4
"""... and are this far from those: bent boards tear stripes of good shots by less."""

FARTHEST_M = 5e-3
"""A stripe beside all planes by more than this counts no further: it may be no laser's."""

_ANCHORS, _PARTNERS, _ROUNDS = 3, 4, 2
"""Shots that a search begins with, those each is paired with, and how often planes and labels are renewed."""

Ends = Float64[Array, "view laser end=2 xyz=3"]
"""Two points of each stripe, a standard deviation of its centres to either side of their middle; NaN for none."""

Labels = Int64[Array, "view laser"]
"""The plane on which each stripe lies; -1 where there is no stripe."""

Planes = Float64[Array, "laser 4"]
"""Unit normal and distance; NaN where nothing determines them."""


def exchanged_lasers(
    points: Sequence[Sequence[Float64[Array, "_ xyz=3"]]], lasers: Sequence[str], shots: Sequence[str]
) -> dict[int, str]:
    """What is wrong with the labels of which shots; `points` are the stripes by laser and shot.

    Refused where as many shots say one as the other: then nobody knows which are right.
    """
    ends = _ends(points)
    several = np.flatnonzero(np.isfinite(ends[..., 0, 0]).sum(axis=1) > 1)
    if len(several) < 2:
        return {}
    labels, planes = min(_explanations(ends, several), key=lambda found: _price(ends, *found))
    ways = _usual_ways(labels)
    if len(ways) > 1:
        raise DataError(*_undecided(labels, ways, lasers, shots))
    by_laser = planes[list(ways[0])]
    found = {int(view): _lies_on(ways[0], labels[view], ends[view], by_laser) for view in several}
    return {view: _sentence(lies_on, ends[view], by_laser, lasers) for view, lies_on in found.items() if lies_on}


def _ends(points: Sequence[Sequence[Float64[Array, "_ xyz=3"]]]) -> Ends:
    return np.array([[_line_ends(own[view]) for own in points] for view in range(len(points[0]))])


def _line_ends(points: Float64[Array, "_ xyz=3"]) -> Float64[Array, "end=2 xyz=3"]:
    if len(points) < 2:
        return np.full((2, 3), np.nan)
    middle = points.mean(axis=0)
    _, length, axes = np.linalg.svd(points - middle, full_matrices=False)
    ends: Float64[Array, "end=2 xyz=3"] = middle + np.outer([-1.0, 1.0], axes[0] * length[0] / np.sqrt(len(points)))
    return ends


def _explanations(ends: Ends, several: Int64[Array, "several"]) -> Iterator[tuple[Labels, Planes]]:
    """Labels and planes that two shots and an exchange between them suggest, fitted to all shots."""
    lasers = ends.shape[1]
    for first in several[np.linspace(0, len(several) - 1, min(_ANCHORS, len(several))).astype(int)]:
        for second in _far_from(ends, int(first), several):
            for way in _exchanges(lasers):
                planes = _planes(np.concatenate([ends[first], ends[second][list(way)]], axis=1))
                labels = _labels(ends, planes)
                for _ in range(_ROUNDS):
                    planes = _fitted(ends, labels, planes)
                    labels = _labels(ends, planes)
                yield labels, planes


def _far_from(ends: Ends, first: int, several: Int64[Array, "several"]) -> Int64[Array, "partner"]:
    """The shots whose stripes lie farthest from those of one."""
    with np.errstate(invalid="ignore"):
        apart = np.linalg.norm(ends[several].mean(axis=2) - ends[first].mean(axis=1), axis=-1)
    farthest = several[np.argsort(-np.nan_to_num(apart).max(axis=1))]
    partners: Int64[Array, "partner"] = farthest[farthest != first][:_PARTNERS]
    return partners


def _exchanges(lasers: int) -> list[tuple[int, ...]]:
    """Orders of lasers: as they are, turned round, two exchanged, and upside down."""
    every = tuple(range(lasers))
    ways = [every[turn:] + every[:turn] for turn in every] + [every[::-1]]
    for first, second in combinations(every, 2):
        swapped = list(every)
        swapped[first], swapped[second] = second, first
        ways.append(tuple(swapped))
    return list(dict.fromkeys(ways))


def _planes(ends: Float64[Array, "laser end xyz=3"]) -> Planes:
    """Nearest to the ends that are known."""
    return np.array([_plane(own[np.isfinite(own[:, 0])]) for own in ends])


def _plane(points: Float64[Array, "end xyz=3"]) -> Float64[Array, "4"]:
    if len(points) < 3:
        return np.full(4, np.nan)
    normal, distance_m, _ = nearest_plane(points)
    return np.append(normal, distance_m)


def _fitted(ends: Ends, labels: Labels, planes: Planes) -> Planes:
    """Through the stripes that lie near them."""
    near = _squares(ends, planes) < FARTHEST_M**2
    found = []
    for plane in range(len(planes)):
        own = ends[(labels == plane) & near[..., plane]].reshape(-1, 3)
        found.append(_plane(own) if len(own) > 2 else planes[plane])
    return np.array(found)


def _squares(ends: Float64[Array, "*view laser end=2 xyz=3"], planes: Planes) -> Float64[Array, "*view laser plane"]:
    """Mean square distance of each stripe from each plane; as far as counts where either is unknown."""
    distance_m = np.einsum("...ei,pi->...ep", ends, planes[:, :3]) - planes[:, 3]
    squares: Float64[Array, "*view laser plane"] = np.nan_to_num(np.mean(distance_m**2, axis=-2), nan=np.inf)
    return squares


def _labels(ends: Ends, planes: Planes) -> Labels:
    """For each shot the planes, each for one stripe at most, that its stripes lie nearest to."""
    from scipy.optimize import linear_sum_assignment

    labels = np.full(ends.shape[:2], -1)
    capped = np.minimum(_squares(ends, planes), 1.0)
    for view, squares in enumerate(capped):
        seen = np.flatnonzero(np.isfinite(ends[view, :, 0, 0]))
        labels[view, seen] = linear_sum_assignment(squares[seen])[1]
    return labels


def _price(ends: Ends, labels: Labels, planes: Planes) -> float:
    """Squares of all stripes; and for labels that few shots have what is asked for to believe them."""
    seen = labels >= 0
    squares = np.take_along_axis(_squares(ends, planes), np.maximum(labels, 0)[..., None], axis=-1)[..., 0]
    unusual = int(np.sum(seen & (labels != np.array(_usual_ways(labels)[0]))))
    return float(np.minimum(squares, FARTHEST_M**2)[seen].sum()) + unusual * LEAST_GAIN_M**2


def _usual_ways(labels: Labels) -> list[tuple[int, ...]]:
    """By laser the plane that most shots have for it; several ways if as many shots have each."""
    seen = (labels >= 0).sum(axis=1)
    ways = {_completed(own) for own in labels[seen == seen.max()].tolist()}
    agreeing = {way: int(np.sum(np.all((labels == np.array(way)) | (labels < 0), axis=1))) for way in sorted(ways)}
    return [way for way, count in agreeing.items() if count == max(agreeing.values())]


def _completed(way: Sequence[int]) -> tuple[int, ...]:
    """With the planes that are left for lasers of which no stripe is seen."""
    left = iter(sorted(set(range(len(way))) - set(way)))
    return tuple(plane if plane >= 0 else next(left) for plane in way)


def _lies_on(
    usual: Sequence[int], labels: Int64[Array, "laser"], ends: Float64[Array, "laser end=2 xyz=3"], planes: Planes
) -> dict[int, int]:
    """The lasers of one shot whose stripes lie on the plane of another, and of which; empty if in doubt."""
    lies_on = {laser: usual.index(plane) for laser, plane in enumerate(labels.tolist()) if plane >= 0}
    moved = {laser: other for laser, other in lies_on.items() if other != laser}
    if not moved:
        return {}
    own_m, other_m = _beside_m(moved, ends, planes)
    return moved if own_m > max(DECISION * other_m, LEAST_GAIN_M) else {}


def _beside_m(
    lies_on: Mapping[int, int], ends: Float64[Array, "laser end=2 xyz=3"], planes: Planes
) -> tuple[float, float]:
    """How far, rms, these stripes lie beside their own planes and beside the others."""
    lasers, others = list(lies_on), list(lies_on.values())
    squares = _squares(ends, planes)
    return float(np.sqrt(squares[lasers, lasers].mean())), float(np.sqrt(squares[lasers, others].mean()))


def _sentence(
    lies_on: Mapping[int, int], ends: Float64[Array, "laser end=2 xyz=3"], planes: Planes, lasers: Sequence[str]
) -> str:
    own_m, other_m = _beside_m(lies_on, ends, planes)
    return (
        f"{_exchange(lies_on, lasers)} against the other shots: stripes lie {1e3 * own_m:.3g} mm from their own "
        f"planes, {1e3 * other_m:.2g} mm from the others'; left out: see how its lasers were switched"
    )


def _exchange(lies_on: Mapping[int, int], lasers: Sequence[str]) -> str:
    """`left and middle are exchanged`; with more, which shows the stripe of which."""
    if len(lies_on) == 2 and all(lies_on.get(other) == laser for laser, other in lies_on.items()):
        return f"{' and '.join(lasers[laser] for laser in lies_on)} are exchanged"
    shown = ", ".join(f"{lasers[laser]} shows the stripe of {lasers[other]}" for laser, other in lies_on.items())
    return f"lasers are exchanged ({shown})"


def _undecided(
    labels: Labels, ways: Sequence[tuple[int, ...]], lasers: Sequence[str], shots: Sequence[str]
) -> tuple[str, str, str]:
    """Place, finding and remedy where shots are divided."""
    groups = [
        [shot for shot, own in zip(shots, labels, strict=True) if np.all((own == np.array(way)) | (own < 0))]
        for way in ways[:2]
    ]
    lies_on = {laser: ways[0].index(plane) for laser, plane in enumerate(ways[1]) if plane != ways[0][laser]}
    return (
        ", ".join(groups[1]),
        f"{_exchange(lies_on, lasers)} against {', '.join(groups[0])}: as many shots say one as the other",
        "see with --overlay which stripe is whose, and leave out the shots whose lasers were switched wrongly",
    )
