"""Assignment of stripes to lasers.

A frame with one laser on labels its stripe by the bit of its mask. Stripes of frames with several lasers on are
assigned by a given order across the image, or by the light planes of the stripes that are labelled already.

Labels can be wrong: a late or miswired switch exchanges lasers in all frames of a shot. Each shot by itself looks
right; only the other shots contradict it. `exchanged_lasers` therefore estimates the light planes with the labels of
all shots free, and takes the labels that most shots share as the correct ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.geometry.rays import nearest_plane
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.calibration import StripeView
from ringpose.types.image import ALL_LASERS, Shot
from ringpose.types.session import MAX_LASERS

THREE = ("left", "middle", "right")
"""Default names of three lasers, by mask bit."""

ASSIGNMENT_RATIO = 3.0
"""An assignment is accepted if its rms distance from the planes is this many times smaller than the second best."""

EXCHANGE_RATIO = 3.0
"""An exchange is reported if the stripes lie this many times closer to the other planes than to their own."""

MIN_GAIN_M = 5e-4
"""Distance of the stripes from their own planes above which it is reported: bent boards move stripes by less."""

MAX_DISTANCE_M = 5e-3
"""Truncation of a stripe's distance from its plane in the score: such a stripe may belong to none of the lasers."""

_DRAWN_SHOTS = 8
"""Number of shots of which each pair determines candidates for the planes."""

StripeEnds = Float64[Array, "view laser end=2 xyz=3"]
"""Two points of each stripe, one standard deviation of its centres to either side of their mean; NaN for none."""

Labels = Int64[Array, "view laser"]
"""Index of the plane to which each stripe is assigned; -1 where there is no stripe."""

Planes = Float64[Array, "plane 4"]
"""Unit normal and distance by plane; NaN where a plane is undetermined."""


def laser_names(given: str | None, number: int) -> tuple[str, ...]:
    """The given names, separated by commas; by default left, middle, right for three lasers, else laser_1, laser_2.

    `number` is the number of lasers that the masks of the shots refer to.
    """
    if given is None:
        return THREE if number == len(THREE) else tuple(f"laser_{i + 1}" for i in range(number))
    names = tuple(name.strip() for name in given.split(","))
    if not all(names) or len(set(names)) < len(names) or any("." in name for name in names) or len(names) > MAX_LASERS:
        finding = f"{given!r} is not a list of laser names"
        raise UsageError("--laser-names", finding, "give one to eight different names, as left,right")
    return names


def lasers_in_masks(shot: Shot) -> int:
    """Number of lasers that the shot's masks refer to; zero if all its frames have all lasers on."""
    return max((int(mask) for mask in shot.lasers if mask != ALL_LASERS), default=0).bit_length()


def laser_order(given: str | None, names: tuple[str, ...]) -> tuple[int, ...] | None:
    """Laser indices in the order in which the stripes cross the image; None if not given, except for a single laser."""
    if given is None:
        return (0,) if len(names) == 1 else None
    order = [name.strip() for name in given.split(",")]
    if sorted(order) != sorted(names):
        finding = f"{given!r} does not list each laser once"
        raise UsageError("--laser-order", finding, f"give {','.join(names)} in their order")
    return tuple(names.index(name) for name in order)


def labelled_by_order(view: StripeView, order: Sequence[int]) -> StripeView:
    """The view with its unlabelled stripes assigned to the lasers in the order in which they cross the image."""
    if len(view.unlabelled_px) != len(order):
        return view
    return _with_labels(view, dict(zip(order, view.unlabelled_px, strict=True)))


def check_order(views: Sequence[StripeView], order: Sequence[int], names: Sequence[str]) -> None:
    """Raise DataError if frames with single lasers on contradict the given order."""
    for view in views:
        observed = _observed_order(view)
        if observed != [laser for laser in order if laser in observed]:
            given = ",".join(names[laser] for laser in order)
            seen = ", ".join(names[laser] for laser in observed)
            finding = f"{given} contradicts {view.board.name}, whose frames with single lasers on show {seen}"
            raise DataError("--laser-order", finding, "give that order, or check whether the lasers are exchanged")


def _observed_order(view: StripeView) -> list[int]:
    """Labelled lasers in the order of their stripes at the image's middle: downwards, or to the right if upright."""
    stripes = {laser: px for laser, px in enumerate(view.stripes_px) if len(px) > 1}
    if len(stripes) < 2:
        return []
    extent = np.mean([np.ptp(px, axis=0) for px in stripes.values()], axis=0)
    along = int(np.argmax(extent))
    middle = float(np.concatenate(list(stripes.values()))[:, along].mean())
    ordinate = {
        laser: float(np.polynomial.Polynomial.fit(px[:, along], px[:, 1 - along], 1)(middle))
        for laser, px in stripes.items()
    }
    return sorted(ordinate, key=lambda laser: ordinate[laser])


def labelled_by_planes(
    view: StripeView,
    points: Sequence[Float64[Array, "_ xyz=3"]],
    planes: Sequence[tuple[Float64[Array, "3"], float]],
) -> StripeView:
    """The view with its unlabelled stripes assigned to the lasers on whose planes they lie.

    `points` are the stripes' triangulated centres. The view stays unlabelled if the assignment is ambiguous.
    """
    if not points:
        return view
    squares_m2 = np.array(
        [[np.mean((stripe @ normal - distance_m) ** 2) for normal, distance_m in planes] for stripe in points]
    )
    stripes = range(len(points))

    def rms_m(assignment: tuple[int, ...]) -> float:
        return float(np.sqrt(squares_m2[stripes, assignment].mean()))

    best, *others = sorted(permutations(range(len(planes)), len(points)), key=rms_m)
    if others and rms_m(others[0]) < ASSIGNMENT_RATIO * rms_m(best):
        return replace(view, remarks=(*view.remarks, "the stripes fit the lasers in more than one way"))
    return _with_labels(view, dict(zip(best, view.unlabelled_px, strict=True)))


def _with_labels(view: StripeView, by_laser: Mapping[int, Float64[Array, "_ xy=2"]]) -> StripeView:
    """The view with these stripes for the lasers that have none; existing labels are kept."""
    stripes_px = tuple(seen if len(seen) else by_laser.get(laser, seen) for laser, seen in enumerate(view.stripes_px))
    return replace(view, stripes_px=stripes_px, unlabelled_px=())


def exchanged_lasers(
    points: Sequence[Sequence[Float64[Array, "_ xyz=3"]]], lasers: Sequence[str], shots: Sequence[str]
) -> dict[int, str]:
    """Indices of the shots whose labels contradict the planes of the other shots, with a message for each.

    `points` are the stripes' triangulated centres by laser and shot. Raises DataError if two labellings are shared by
    equally many shots.
    """
    ends = np.array([[_stripe_ends(own[view]) for own in points] for view in range(len(points[0]))])
    usable = np.flatnonzero(np.isfinite(ends[..., 0, 0]).sum(axis=1) > 1)  # one stripe alone cannot be exchanged
    if len(usable) < 2:
        return {}
    planes = _planes_of_most_shots(ends, usable)
    (labels, _), squares_m2 = _assignment(ends, planes), _squared_distances_m2(ends, planes)
    agreeing: list[int] = []
    exchanges: dict[tuple[tuple[int, int], ...], list[int]] = {}  # shots by what is exchanged: laser, and the other one
    messages = {}
    for view in usable.tolist():
        exchanged = {laser: other for laser, other in enumerate(labels[view].tolist()) if other not in (laser, -1)}
        stripes, others = list(exchanged), list(exchanged.values())
        own_m, other_m = (
            float(np.sqrt(squares_m2[view, stripes, at].mean())) if exchanged else 0.0 for at in (stripes, others)
        )
        if own_m <= max(EXCHANGE_RATIO * other_m, MIN_GAIN_M):
            agreeing.append(view)
            continue
        exchanges.setdefault(tuple(exchanged.items()), []).append(view)
        messages[view] = (
            f"{_exchange_text(exchanged, lasers)} against the other shots: stripes lie {1e3 * own_m:.3g} mm from "
            f"their own planes, {1e3 * other_m:.2g} mm from the others'; left out: see how its lasers were switched"
        )
    for exchange, views in exchanges.items():
        if len(views) >= len(agreeing):
            known = ", ".join(shots[view] for view in agreeing)
            finding = f"{_exchange_text(dict(exchange), lasers)} against {known}: as many shots have either labelling"
            remedy = (
                "see with --overlay which stripe is whose, and leave out the shots whose lasers were switched wrongly"
            )
            raise DataError(", ".join(shots[view] for view in views), finding, remedy)
    return messages


def _stripe_ends(points: Float64[Array, "_ xyz=3"]) -> Float64[Array, "end=2 xyz=3"]:
    """Two points that replace a straight stripe: they have its mean and its standard deviation along the line."""
    if len(points) < 2:
        return np.full((2, 3), np.nan)
    center = points.mean(axis=0)
    _, singular, axes = np.linalg.svd(points - center, full_matrices=False)
    return center + np.outer([-1.0, 1.0], axes[0] * singular[0] / np.sqrt(len(points)))


def _planes_of_most_shots(ends: StripeEnds, usable: Int64[Array, "usable"]) -> Planes:
    """The light planes with which the labels of most shots agree.

    The stripes of two shots determine candidates for all planes, also if the lasers of the second are exchanged.
    """
    drawn = usable[np.unique(np.linspace(0, len(usable) - 1, _DRAWN_SHOTS).astype(int))]
    candidates = (
        np.array([_plane(stripes[np.isfinite(stripes[:, 0])]) for stripes in both])
        for first, second in combinations(drawn.tolist(), 2)
        for permutation in _permutations(ends.shape[1])
        for both in [np.concatenate([ends[first], ends[second, permutation]], axis=1)]
    )
    planes = min(candidates, key=lambda planes: _assignment(ends, planes)[1])
    return _refitted(ends, _assignment(ends, planes)[0], planes)


def _permutations(lasers: int) -> list[tuple[int, ...]]:
    """The permutations that wrong switching makes: identity, rotations, reversal, exchanges of two.

    For three lasers these are all; for eight they are 37 of 40320.
    """
    identity = tuple(range(lasers))
    permutations = [identity[shift:] + identity[:shift] for shift in identity] + [identity[::-1]]
    for first, second in combinations(identity, 2):
        swapped = list(identity)
        swapped[first], swapped[second] = second, first
        permutations.append(tuple(swapped))
    return list(dict.fromkeys(permutations))


def _plane(points: Float64[Array, "n xyz=3"]) -> Float64[Array, "4"]:
    if len(points) < 3:
        return np.full(4, np.nan)
    normal, distance_m, _ = nearest_plane(points)
    return np.append(normal, distance_m)


def _refitted(ends: StripeEnds, labels: Labels, planes: Planes) -> Planes:
    """Each plane through the stripes that are assigned to it and lie near it; unchanged if these are too few."""
    near = _squared_distances_m2(ends, planes) < MAX_DISTANCE_M**2
    refitted = []
    for index, plane in enumerate(planes):
        points = ends[(labels == index) & near[..., index]].reshape(-1, 3)
        refitted.append(_plane(points) if len(points) > 2 else plane)
    return np.array(refitted)


def _squared_distances_m2(ends: StripeEnds, planes: Planes) -> Float64[Array, "view laser plane"]:
    """Mean squared distance of each stripe from each plane; a very large number where either is undetermined."""
    distance_m = np.einsum("...ei,pi->...ep", ends, planes[:, :3]) - planes[:, 3]
    return np.nan_to_num(np.mean(distance_m**2, axis=-2), nan=np.inf)


def _assignment(ends: StripeEnds, planes: Planes) -> tuple[Labels, float]:
    """The assignment of each shot's stripes to planes, one to one, with the smallest cost, and its cost.

    The cost is the truncated squared distance, and MIN_GAIN_M^2 for each stripe on the plane of another laser.
    """
    from scipy.optimize import linear_sum_assignment

    labels, total = np.full(ends.shape[:2], -1), 0.0
    own = np.eye(len(planes), dtype=bool)
    costs = np.minimum(_squared_distances_m2(ends, planes), MAX_DISTANCE_M**2) + MIN_GAIN_M**2 * ~own
    for view, cost in enumerate(costs):
        seen = np.flatnonzero(np.isfinite(ends[view, :, 0, 0]))
        labels[view, seen] = linear_sum_assignment(cost[seen])[1]
        total += float(cost[seen, labels[view, seen]].sum())
    return labels, total


def _exchange_text(exchanged: Mapping[int, int], lasers: Sequence[str]) -> str:
    """`left and middle are exchanged`; for more than two, which laser shows whose stripe."""
    if len(exchanged) == 2 and all(exchanged.get(other) == laser for laser, other in exchanged.items()):
        return f"{' and '.join(lasers[laser] for laser in exchanged)} are exchanged"
    pairs = ", ".join(f"{lasers[laser]} shows the stripe of {lasers[other]}" for laser, other in exchanged.items())
    return f"lasers are exchanged ({pairs})"
