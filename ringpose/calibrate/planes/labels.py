"""Which laser drew which stripe, where several were on together.

Shots whose frames name the wrong lasers: their stripes lie on the light planes of others.

A late or miswired switch gives every frame of a shot its neighbour's laser. Each shot by itself looks right; only
against the others do its stripes lie on other planes. Which planes there are is searched with the shots' labels free;
the labels that most shots share are the true ones.

How the lasers are called, in the order of a shot's mask bits.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.geometry.planes import nearest_plane
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.calibration import StripeView
from ringpose.types.image import ALL_LASERS, Shot
from ringpose.types.sequence import MAX_LASERS

DECISION = 3.0
"""An assignment is taken if its rms distance from the planes is this many times smaller than the next one's."""


def labelled_by_order(view: StripeView, order: Sequence[int]) -> StripeView:
    """The view with its unlabelled stripes given to the lasers in the order in which they cross the image."""
    if len(view.unlabelled_px) != len(order):
        return view
    by_laser = dict(zip(order, view.unlabelled_px, strict=True))
    return _with_labels(view, by_laser)


def refuse_other_order(views: Sequence[StripeView], order: Sequence[int], names: Sequence[str]) -> None:
    """Refuse an order that frames with single lasers contradict."""
    for view in views:
        seen = _order_seen(view)
        if seen != [laser for laser in order if laser in seen]:
            said = ", ".join(names[laser] for laser in seen)
            found = (
                f"{','.join(names[laser] for laser in order)} is not how {view.board.name} has them, where frames with "
            )
            found += f"single lasers on say {said}"
            raise DataError("--laser-order", found, "give that order, or see whether the lasers are exchanged")


def _order_seen(view: StripeView) -> list[int]:
    """The labelled lasers by where their stripes cross the image's middle, down it or, upright, to the right."""
    stripes = {laser: px for laser, px in enumerate(view.stripes_px) if len(px) > 1}
    if len(stripes) < 2:
        return []
    every = np.concatenate(list(stripes.values()))
    spread = np.mean([np.ptp(px, axis=0) for px in stripes.values()], axis=0)
    along = int(np.argmax(spread))
    middle = float(every[:, along].mean())
    place = {
        laser: float(np.polynomial.Polynomial.fit(px[:, along], px[:, 1 - along], 1)(middle))
        for laser, px in stripes.items()
    }
    return sorted(place, key=lambda laser: place[laser])


def labelled_by_planes(
    view: StripeView,
    points: Sequence[Float64[Array, "_ xyz=3"]],
    planes: Sequence[tuple[Float64[Array, "3"], float]],
) -> StripeView:
    """The view with its unlabelled stripes given to the lasers whose planes they lie on.

    `points` are the stripes' triangulated centres. A view that fits the planes in two ways stays as it is.
    """
    if not points:
        return view
    cost = np.array(
        [[np.mean((stripe @ normal - distance_m) ** 2) for normal, distance_m in planes] for stripe in points]
    )
    ways = sorted(permutations(range(len(planes)), len(points)), key=lambda way: _rms(cost, way))
    if len(ways) > 1 and _rms(cost, ways[1]) < DECISION * _rms(cost, ways[0]):
        return replace(view, remarks=(*view.remarks, "the stripes fit the lasers in more than one way"))
    return _with_labels(view, dict(zip(ways[0], view.unlabelled_px, strict=True)))


def _rms(cost: Float64[Array, "stripe laser"], way: tuple[int, ...]) -> float:
    return float(np.sqrt(cost[range(len(way)), way].mean()))


def _with_labels(view: StripeView, by_laser: Mapping[int, Float64[Array, "_ xy=2"]]) -> StripeView:
    """The view with stripes for the lasers that it has none of."""
    stripes_px = tuple(seen if len(seen) else by_laser.get(laser, seen) for laser, seen in enumerate(view.stripes_px))
    return replace(view, stripes_px=stripes_px, unlabelled_px=())


EXCHANGE_DECISION = 3.0
"""Other labels are believed where stripes lie this many times nearer to their planes than by their own labels ..."""

MIN_GAIN_M = 5e-4
"""... and are this far from those: bent boards tear stripes of good shots by less."""

MAX_DISTANCE_M = 5e-3
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
    near = _squares(ends, planes) < MAX_DISTANCE_M**2
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
    return float(np.minimum(squares, MAX_DISTANCE_M**2)[seen].sum()) + unusual * MIN_GAIN_M**2


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
    return moved if own_m > max(EXCHANGE_DECISION * other_m, MIN_GAIN_M) else {}


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


THREE = ("left", "middle", "right")


def laser_names(given: str | None, number: int) -> tuple[str, ...]:
    """The names that were given, comma between; else left, middle, right for three lasers, laser_1, laser_2 for others.

    `number` is how many lasers the shots' masks speak of.
    """
    if given is None:
        return THREE if number == len(THREE) else tuple(f"laser_{i + 1}" for i in range(number))
    names = tuple(name.strip() for name in given.split(","))
    if not all(names) or len(set(names)) < len(names) or any("." in name for name in names) or len(names) > MAX_LASERS:
        raise UsageError("--laser-names", f"{given!r} are no names", "give one to eight different ones, as left,right")
    return names


def lasers_named(shot: Shot) -> int:
    """How many lasers the shot's masks speak of; none where all were on, however many there are."""
    return max((int(mask) for mask in shot.lasers if mask != ALL_LASERS), default=0).bit_length()


def laser_order(given: str | None, names: tuple[str, ...]) -> tuple[int, ...] | None:
    """The lasers in the order in which their stripes cross the image; a single one needs none."""
    if given is None:
        return (0,) if len(names) == 1 else None
    order = [name.strip() for name in given.split(",")]
    if sorted(order) != sorted(names):
        raise UsageError(
            "--laser-order", f"{given!r} is no order of the lasers", f"give {','.join(names)} in their order"
        )
    return tuple(names.index(name) for name in order)
