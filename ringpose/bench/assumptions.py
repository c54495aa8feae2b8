"""What poses assume about motion, ring and rig: results are compared only if they assume the same."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from math import degrees, isfinite
from typing import Annotated, Literal

from ringpose.types.assumptions import Assumptions, RigStability
from ringpose.types.options import Method
from ringpose.types.pose import PoseFlag, PoseLine
from ringpose.types.record import Key


@dataclass(frozen=True, slots=True, kw_only=True)
class AssumedRadii:
    """Radii that a pose assumes: given radii, or those of the catalogue's ring that each shot identifies."""

    source: Annotated[Literal["given", "catalogue"], Key("Where the radii are from.")]
    inner_m: Annotated[float | None, Key("Given radius of the inner edge; null without one.", least=0.0)] = None
    outer_m: Annotated[float | None, Key("Given radius of the outer edge; null without one.", least=0.0)] = None
    sd_m: Annotated[float | None, Key("Standard deviation of the given radii.", least=0.0)] = None


OTHER_ASSUMPTIONS = PoseFlag.MOTION | PoseFlag.RING_FORM | PoseFlag.RADIUS_INCONSISTENT
"""Flags of shots that were explained by other assumptions than the chosen ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedAssumptions(Assumptions):
    """The assumptions of a pose record, among them those about the radii."""

    radii: Annotated[AssumedRadii | None, Key("Assumed radii; null if they are unknown.")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CountedAssumptions(StatedAssumptions):
    """The same assumptions of several shots."""

    shots: Annotated[int, Key("Number of these shots.", least=1)]


def assumptions_of(line: PoseLine) -> StatedAssumptions | None:
    """Assumptions of a pose line; None for a line that is not compared by its assumptions.

    None is returned for a line without a pose, for a closed-form solution, which makes no assumptions, and for a shot
    that fits only assumptions other than the chosen ones. A pose without priors, as in records of version 1, counts as
    computed for a still and exactly circular ring of unknown radius, with an unchanged rig.
    """
    if line.pose is None or line.pose.method != Method.ML or line.flags & OTHER_ASSUMPTIONS:
        return None
    if line.priors is None:
        return StatedAssumptions()
    assumed, prior, radii = line.priors.assumptions, line.priors.radius, None
    if line.pose.ring_posterior is not None or (prior is not None and prior.source != "given"):
        radii = AssumedRadii(source="catalogue")
    elif prior is not None:
        inner_m, outer_m = (radius_m if isfinite(radius_m) else None for radius_m in (prior.inner_m, prior.outer_m))
        radii = AssumedRadii(source="given", inner_m=inner_m, outer_m=outer_m, sd_m=prior.sd_m)
    return StatedAssumptions(
        motion=assumed.motion,
        radii=radii,
        ring_tolerance_m=assumed.ring_tolerance_m,
        stability=assumed.stability,
        face_slope_rad=assumed.face_slope_rad,
    )


def counted(assumptions: Iterable[StatedAssumptions | None]) -> tuple[CountedAssumptions, ...]:
    """The different assumptions in the order of their first occurrence, each with the number of shots."""
    counts = Counter(stated for stated in assumptions if stated is not None)
    return tuple(
        CountedAssumptions(**{key.name: getattr(stated, key.name) for key in fields(stated)}, shots=shots)
        for stated, shots in counts.items()
    )


def assumptions_text(assumptions: StatedAssumptions) -> str:
    """The assumptions in one line."""
    motion, radii, stability = assumptions.motion, assumptions.radii, assumptions.stability
    target, rings, rig = "still target", "radii unknown", "stable rig"
    if motion is not None:
        target = f"speed {motion.speed_sd_m_s:g} m/s and rate {degrees(motion.rate_sd_rad_s):.3g} deg/s (1 sd)"
    if radii is not None and radii.source == "catalogue":
        rings = "radii of a catalogue"
    elif radii is not None:
        given = ("-" if radius_m is None else f"{1e3 * radius_m:g}" for radius_m in (radii.inner_m, radii.outer_m))
        rings = f"radii {'/'.join(given)} mm" + ("" if radii.sd_m is None else f" (1 sd {1e3 * radii.sd_m:g} mm)")
    if stability != RigStability():
        tilt_mrad, distance_mm = 1e3 * stability.plane_tilt_rad, 1e3 * stability.plane_distance_m
        rig = f"rig stability plane tilt {tilt_mrad:g} mrad, plane distance {distance_mm:g} mm, "
        rig += f"focal ratio {stability.focal_ratio:g}"
    form = f"ring tolerance {1e3 * assumptions.ring_tolerance_m:g} mm"
    if assumptions.face_slope_rad:
        form += f", slope of its face {degrees(assumptions.face_slope_rad):.3g} deg"
    return f"{target}, {rings}, {form}, {rig}"


def assumption_lines(assumptions: Sequence[StatedAssumptions | None]) -> list[str]:
    """A line for each of the different assumptions of some shots."""
    different = counted(assumptions)
    return [
        f"assumptions: {assumptions_text(stated)}" + (f" ({stated.shots} shots)" if len(different) > 1 else "")
        for stated in different
    ]
