"""Assignment of stripes to lasers.

A frame with one laser on labels its stripe by the bit of its mask. Stripes of frames with several lasers on are
assigned by a given order across the image, or by the light planes of the stripes that are labelled already.

Labels can be wrong: a late or miswired switch exchanges lasers in all frames of a shot. Each shot by itself looks
right; only the other shots contradict it. `exchanged_lasers` takes the labels of most shots as the correct ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from ringpose.calibrate.planes.plane_fit import Points, outlying_views, rms, robust_plane
from ringpose.errors import DataError, UsageError
from ringpose.types.arrays import Array, Float64
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


def laser_names(given: str | None, number: int) -> tuple[str, ...]:
    """The given names, separated by commas; by default left, middle, right for three lasers, else laser_1, laser_2.

    `number` is the number of lasers that the masks of the shots refer to.
    """
    if given is None:
        return THREE if number == len(THREE) else tuple(f"laser_{i + 1}" for i in range(number))
    names = tuple(name.strip() for name in given.split(","))
    if not all(names) or len(set(names)) < len(names) or any("." in name for name in names) or len(names) > MAX_LASERS:
        found = f"{given!r} is not a list of laser names"
        raise UsageError("--laser-names", found, "give one to eight different names, as left,right")
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
        found = f"{given!r} does not list each laser once"
        raise UsageError("--laser-order", found, f"give {','.join(names)} in their order")
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
            found = f"{given} contradicts {view.board.name}, whose frames with single lasers on show {seen}"
            raise DataError("--laser-order", found, "give that order, or check whether the lasers are exchanged")


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


def exchanged_lasers(points: Sequence[Sequence[Points]], lasers: Sequence[str]) -> dict[int, str]:
    """Indices of the shots whose labels contradict those of most shots, with a message for each.

    `points` are the stripes' triangulated centres by laser and shot. A stripe beside its laser's plane by the other
    shots that lies on the plane of another laser has a wrong label.
    """
    beside = [outlying_views(own, name) for own, name in zip(points, lasers, strict=True)]
    planes = [
        robust_plane(np.concatenate([stripe for view, stripe in enumerate(own) if view not in outlying]))[:2]
        if any(len(stripe) for stripe in own)
        else (np.full(3, np.nan), np.nan)
        for own, outlying in zip(points, beside, strict=True)
    ]
    messages = {}
    for view in sorted(set().union(*beside)):
        stripes = [laser for laser, outlying in enumerate(beside) if view in outlying]
        rms_m = np.array([[rms(points[laser][view] @ normal - d) for normal, d in planes] for laser in stripes])
        nearest = np.nanargmin(rms_m, axis=1)
        own_m, other_m = rms_m[range(len(stripes)), stripes], rms_m[range(len(stripes)), nearest]
        wrong = own_m > np.maximum(EXCHANGE_RATIO * other_m, MIN_GAIN_M)
        exchanged = {stripes[index]: int(nearest[index]) for index in np.flatnonzero(wrong)}
        if exchanged:
            found = f"stripes lie {1e3 * rms(own_m[wrong]):.3g} mm from their own planes"
            messages[view] = (
                f"{_exchange_text(exchanged, lasers)} against the other shots: {found}, "
                f"{1e3 * rms(other_m[wrong]):.2g} mm from the others'; left out: see how its lasers were switched"
            )
    return messages


def _exchange_text(exchanged: Mapping[int, int], lasers: Sequence[str]) -> str:
    """`left and middle are exchanged`; for more than two, which laser shows whose stripe."""
    if len(exchanged) == 2 and all(exchanged.get(other) == laser for laser, other in exchanged.items()):
        return f"{' and '.join(lasers[laser] for laser in exchanged)} are exchanged"
    pairs = ", ".join(f"{lasers[laser]} shows the stripe of {lasers[other]}" for laser, other in exchanged.items())
    return f"lasers are exchanged ({pairs})"
