"""What poses assume about motion, the ring's form and the rig: results are compared only if they assume the same."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from ringpose.types.assumptions import Assumptions, RigStability
from ringpose.types.options import Method
from ringpose.types.pose import PoseFlag, PoseLine


def assumptions_of(line: PoseLine) -> Assumptions | None:
    """Assumptions of a pose line; None if it cannot be compared with others by them.

    These are lines without a pose, closed forms, which have no assumptions to choose, and shots that only wider
    assumptions than the chosen ones explain. A pose without priors, as in records of version 1, counts as one of a
    still and perfect ring by an unchanged rig.
    """
    closed_form = line.pose is None or line.pose.method != Method.ML
    if closed_form or line.flags & (PoseFlag.MOTION | PoseFlag.RING_FORM):
        return None
    return Assumptions() if line.priors is None else line.priors.assumptions


def counted(assumptions: Iterable[Assumptions | None]) -> list[tuple[Assumptions, int]]:
    """The different assumptions in the order of their first occurrence, each with the number of shots."""
    return list(Counter(each for each in assumptions if each is not None).items())


def assumptions_record(assumptions: Assumptions) -> dict[str, Any]:
    """The assumptions with the keys of `priors` in a pose record."""
    motion = assumptions.motion
    return {
        "motion": "still" if motion is None else asdict(motion),
        "ring_tolerance_m": assumptions.ring_tolerance_m,
        "stability": asdict(assumptions.stability),
    }


def assumptions_text(assumptions: Assumptions) -> str:
    """The assumptions in one line."""
    motion, stability = assumptions.motion, assumptions.stability
    moving = (
        "still target"
        if motion is None
        else f"speed {motion.speed_sd_m_s:g} m/s and rate {math.degrees(motion.rate_sd_rad_s):.3g} deg/s (1 sd)"
    )
    drift = (
        f"plane tilt {1e3 * stability.plane_tilt_rad:g} mrad, plane distance {1e3 * stability.plane_distance_m:g} mm, "
        f"focal ratio {stability.focal_ratio:g}"
    )
    rig = "stable rig" if stability == RigStability() else f"rig stability {drift}"
    return f"{moving}, ring tolerance {1e3 * assumptions.ring_tolerance_m:g} mm, {rig}"


def assumption_lines(assumptions: Sequence[Assumptions | None]) -> list[str]:
    """A line for each of the different assumptions of some shots."""
    found = counted(assumptions)
    return [
        f"assumptions: {assumptions_text(each)}" + (f" ({count} shots)" if len(found) > 1 else "")
        for each, count in found
    ]
