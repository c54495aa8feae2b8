"""How many shots of a data set show how many stripes, and of which lasers, by their truth."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from ringpose.types.truth import Truth


def stripes_shown(truths: Iterable[Truth], names: Sequence[str] = ()) -> str:
    """One line: the number of shots by the number of their stripes with both ends in view, and by laser.

    Empty without a shot whose truth states the break points. Lasers without a name are numbered.
    """
    known = [truth.break_points_px for truth in truths if truth.break_points_px is not None]
    if not known:
        return ""
    seen = np.zeros((len(known), max(map(len, known))), dtype=np.bool_)
    for shot, points_px in enumerate(known):
        seen[shot, : len(points_px)] = np.isfinite(points_px).all(axis=(1, 2))
    by_number = Counter(seen.sum(axis=1).tolist())
    counts = ", ".join(f"{number} in {by_number[number]}" for number in sorted(by_number, reverse=True))
    of_laser = seen.sum(axis=0).tolist()
    named = [*names, *(f"laser {number + 1}" for number in range(len(names), len(of_laser)))]
    lasers = ", ".join(f"{name} in {count}" for name, count in zip(named, of_laser, strict=False))
    return f"stripes with both ends on the face in view, of {len(known)} shots with a ring: {counts}; {lasers}"
