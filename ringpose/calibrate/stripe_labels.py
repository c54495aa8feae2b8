"""Which laser drew which stripe, where several were on together."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64
from ringpose.types.calibration import StripeView

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
