"""The flags of a line, what they mean and what to do about them: one table, from which the manual's is made.

The stages report findings; this module alone decides which flags they set, and states them in the reason of the line.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ringpose.types.arrays import Array, Bool
from ringpose.types.detection import BreakPointFlag, BreakPoints, Detection, NoBreakPoints, Rejection
from ringpose.types.finding import NOTHING, Finding
from ringpose.types.pose import HARMLESS_FLAGS, LaserState, NoPose, PoseFlag, PoseLine, PoseResult
from ringpose.types.rig import Rig

if TYPE_CHECKING:  # not imported to print the table
    from ringpose.estimate.hypotheses import Explanation

NOT_A_RING = Finding.STRAIGHT | Finding.OTHER_SURFACE | Finding.FEW_ENDS
"""Findings that something else than a ring may have left the shot."""

UNRELIABLE = Finding.NO_ERRORS | Finding.NOT_TIMED | Finding.NOT_CONVERGED | NOT_A_RING
"""Findings after which no quantity but the velocity can be relied on."""

QUANTITIES = ("grasp", "normal", "center", "radius", "velocity")
"""What a flag may forbid to use."""

ALL = frozenset(QUANTITIES)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlagRule:
    """One row of the table."""

    flag: PoseFlag
    findings: Finding
    """Any of them sets the flag."""
    meaning: str
    """What is known where it is set; names of keys, flags, options and commands in backticks, as in the remedy."""
    remedy: str
    """What the user can do."""
    forbids: frozenset[str] = frozenset()
    """Quantities that may not be used with it ..."""
    unless: str = ""
    """... unless this holds, which no line shows."""
    lasting: bool = False
    """Whether it also concerns a track that has used the line."""

    @property
    def name(self) -> str:
        """Its name in records."""
        return str(self.flag.name).lower()


RULES = (
    FlagRule(
        flag=PoseFlag.CENTER_WEAK,
        findings=Finding.CENTER_OPEN | UNRELIABLE,
        meaning=(
            "The centre's standard deviation is over 5 % of the radius, or it is not determined (curvature less than "
            "twice its standard deviation); the normal and the grasp point may still be accurate."
        ),
        remedy="Give the ring's radius, show its edges in ambient light, or step back.",
        forbids=frozenset({"center"}),
    ),
    FlagRule(
        flag=PoseFlag.NORMAL_WEAK,
        findings=Finding.NORMAL_OPEN | UNRELIABLE,
        meaning=(
            "There is only one stripe, and the tilt about it is not determined: the pose has a grasp point but no "
            "normal."
        ),
        remedy="Bring a second stripe onto the ring, or step back.",
        forbids=frozenset({"normal"}),
    ),
    FlagRule(
        flag=PoseFlag.GRASP_WEAK,
        findings=Finding.GRASP_OPEN | Finding.ONE_STRIPE_ALONE | Finding.SEVERAL_FACES | UNRELIABLE,
        meaning="The grasp point is weakly determined, or not at all; or two faces are at one height about one axis.",
        remedy="Bring both ends of a stripe into view; give the radii.",
        forbids=frozenset({"grasp"}),
    ),
    FlagRule(
        flag=PoseFlag.RADIUS_WEAK,
        findings=Finding.RADIUS_OPEN | Finding.SEVERAL_FACES | UNRELIABLE,
        meaning="As `center_weak`, for the radii.",
        remedy="Give the ring's radius, or show its edges in ambient light.",
        forbids=frozenset({"radius"}),
    ),
    FlagRule(
        flag=PoseFlag.VELOCITY_WEAK,
        findings=Finding.VELOCITY_OPEN | Finding.NOT_TIMED,
        meaning=(
            "Explanations of the shot differ in the velocity, which is null, or it depends on a centre that is weakly "
            "determined, or the estimate did not converge. A velocity that the shot does not determine is reported "
            "with the mean and the covariance of its prior, without a flag."
        ),
        remedy="Track the ring through several shots; record frames with stamps of their own.",
        forbids=frozenset({"velocity"}),
    ),
    FlagRule(
        flag=PoseFlag.SIDE_UNKNOWN,
        findings=Finding.SIDE_OPEN,
        meaning="The inner and the outer edge could not be distinguished: the centre may lie on either side.",
        remedy="Bring the lasers farther apart on the face, or step back.",
        forbids=frozenset({"center"}),
    ),
    FlagRule(
        flag=PoseFlag.ASSIGNMENT_AMBIGUOUS,
        findings=Finding.WRONG_LASERS,
        meaning="The stripes fit one ring only, or about as well, if they are assigned to other lasers.",
        remedy="Switch the lasers one by one, or check how they are wired.",
        forbids=ALL,
    ),
    FlagRule(
        flag=PoseFlag.POINT_REJECTED,
        findings=Finding.WRONG_POINT | Finding.WRONG_ENDS | Finding.POINT_UNUSED,
        meaning=(
            "A break point contradicts the others and was rejected; the reason and `rejected` name it. Or something "
            "that stands on the face hides it; the reason names the stripe."
        ),
        remedy="Look for what hides the ring's edge or shines there.",
    ),
    FlagRule(
        flag=PoseFlag.STRIPE_REJECTED,
        findings=Finding.WRONG_STRIPE | Finding.STRIPE_UNUSED,
        meaning=(
            "A stripe contradicts the others and was rejected. If `inconsistent` or another flag of this kind is also "
            "set, the remaining measurements still contradict each other."
        ),
        remedy="Look whether the stripe is on the ring; if it is in many shots, check the rig.",
    ),
    FlagRule(
        flag=PoseFlag.EDGE_REJECTED,
        findings=Finding.WRONG_EDGES | Finding.NO_EDGES,
        meaning=(
            "Visible points of an edge contradict the ring and were rejected, or the ambient light should show the "
            "ring's edges (the frames without lasers have contrast about two break points of an edge), but none was "
            "found; then nothing shows that the stripes end at the edges of a ring, and `inconsistent` is set, too."
        ),
        remedy="Look in the overlay whether the edges are those of the ring.",
    ),
    FlagRule(
        flag=PoseFlag.LASER_MISSING,
        findings=Finding.STRIPE_NOT_FOUND,
        meaning="The stripe of a laser that was on should be in view, but was not found.",
        remedy="Check the laser, raise the exposure, or look for what hides the stripe.",
    ),
    FlagRule(
        flag=PoseFlag.RADIUS_INCONSISTENT,
        findings=Finding.WRONG_RADIUS,
        meaning="The measured radii contradict the given ones, which were ignored.",
        remedy="Give the radii of this ring.",
        forbids=frozenset({"center", "radius"}),
        lasting=True,
    ),
    FlagRule(
        flag=PoseFlag.RADIUS_UNVERIFIED,
        findings=Finding.RADIUS_ASSUMED,
        meaning=(
            "The radius is assumed, and the shot alone would not show that it is wrong by 1 %: it determines it to no "
            "better than 0.22 %."
        ),
        remedy="Make sure that the given radius is right: centre and radii depend on it.",
        forbids=frozenset({"center", "radius"}),
        unless="the given radius is right",
        lasting=True,
    ),
    FlagRule(
        flag=PoseFlag.RING_FORM,
        findings=Finding.NOT_ROUND | Finding.RADII_DIFFER,
        meaning=(
            "Only a larger deviation of the ring from circle and plane than `ring_tolerance_m` explains the shot; "
            "`priors` has the one that was used. Or the radii of the last shots differ by more than their errors; then "
            "`inconsistent` is set, too."
        ),
        remedy="Give the ring's tolerance with `--ring-tolerance`.",
    ),
    FlagRule(
        flag=PoseFlag.INCONSISTENT,
        findings=Finding.UNEXPLAINED
        | Finding.DISPLACED_STRIPE
        | Finding.NO_EDGES
        | Finding.RADII_DIFFER
        | Finding.RIG_DOUBTED
        | Finding.TRACK_CONTRADICTED,
        meaning=(
            "The measurements deviate from one ring by more than their errors, and the outlier is ambiguous; the "
            "covariance is inflated accordingly, and by the differences between the solutions without each of the "
            "candidates. In a track record: the newest measurement contradicts the track and was not used, and the "
            "covariance is not inflated."
        ),
        remedy="Use nothing of this line; look at the overlay, and check the rig if it stays.",
        forbids=ALL,
    ),
    FlagRule(
        flag=PoseFlag.MOTION,
        findings=Finding.FASTER | Finding.MOVED | Finding.FRAME_DIFFERS,
        meaning=(
            "Only a faster motion than the assumed one explains the shot, or a frame with all lasers on contradicts "
            "those with one and was left out; `priors` has the standard deviations that were used."
        ),
        remedy="Give the limits of the motion with `--max-speed` and `--max-rate`.",
    ),
    FlagRule(
        flag=PoseFlag.AMBIENT_CHANGED,
        findings=Finding.AMBIENT_CHANGED,
        meaning=(
            "The ambient light changed within the shot. Of a live camera, a shot in which it changed so much that "
            "frames with and without lasers cannot be compared has no pose."
        ),
        remedy="Keep the light steady, or take the frames faster.",
    ),
    FlagRule(
        flag=PoseFlag.RIG_DRIFT,
        findings=Finding.PLANE_MOVED | Finding.PLANE_OR_CAMERA_MOVED | Finding.RIG_DISAGREES | Finding.SHOTS_CONTRADICT,
        meaning=(
            "A light plane has moved, as the shots before show. The covariance includes the correction of the rig, but "
            "a robot should stop until somebody has looked at the rig. Where the rig could not be corrected, or the "
            "shot cannot check it, `inconsistent` is set, too."
        ),
        remedy="Run `ringpose calibrate-planes`.",
        lasting=True,
    ),
    FlagRule(
        flag=PoseFlag.RIG_UNCHECKED,
        findings=Finding.FEW_STRIPES,
        meaning=(
            "There are only one or two stripes: the shot has no redundancy that could show an error of the rig; "
            "`rig_health` counts."
        ),
        remedy="Bring a third stripe onto the ring.",
        lasting=True,
    ),
    FlagRule(
        flag=PoseFlag.SATURATED,
        findings=Finding.POINT_SATURATED,
        meaning="A break point could not be measured, because its stripe is saturated there.",
        remedy="Reduce the exposure.",
    ),
    FlagRule(
        flag=PoseFlag.TRUNCATED,
        findings=Finding.POINT_CUT_OFF,
        meaning="A break point could not be measured, because its stripe is cut off by the image's border.",
        remedy="Turn the camera so that the ring's section is in view, or step back.",
    ),
    FlagRule(
        flag=PoseFlag.BLUNT_EDGE,
        findings=Finding.BLUNT,
        meaning="The ring's edges are rounded or chamfered.",
        remedy="Nothing is needed: the errors of the break points include it.",
    ),
    FlagRule(
        flag=PoseFlag.GHOST_REMOVED,
        findings=Finding.GHOST_REMOVED,
        meaning=(
            "Each stripe is seen a second time, fainter and at a constant offset, by a reflection inside the camera; "
            "the copies were subtracted from the frames. `ghosts` of the detection has their offset and ratio."
        ),
        remedy="Nothing is needed; filter, cover glass or lens cause it.",
    ),
)
"""One row for each flag, in the order of `PoseFlag`."""

LASTING_FLAGS = PoseFlag(sum(rule.flag for rule in RULES if rule.lasting))
"""Flags of the newest used line that also concern its track."""


@lru_cache(maxsize=256)
def flags_of(findings: Finding) -> PoseFlag:
    """The flags that findings set."""
    return PoseFlag(sum(rule.flag for rule in RULES if findings & rule.findings))


def flags_forbidding(quantity: str) -> PoseFlag:
    """The flags with which a quantity may not be used."""
    return PoseFlag(sum(rule.flag for rule in RULES if quantity in rule.forbids))


@lru_cache(maxsize=256)
def unbounded(flags: PoseFlag) -> frozenset[str]:
    """The quantities whose error no protection level bounds with these flags, as what was seen may be something else.

    A weak centre or an assumed radius has a level: a large one. Without a normal there is no centre either.
    """
    forbidden = frozenset[str]().union(*(rule.forbids for rule in RULES if rule.flag & flags & ~BOUNDED))
    return forbidden | ({"center"} if "normal" in forbidden else set())


BOUNDED = PoseFlag.CENTER_WEAK | PoseFlag.RADIUS_WEAK | PoseFlag.VELOCITY_WEAK | PoseFlag.RADIUS_UNVERIFIED
"""Flags of what a protection level describes."""

FINDING_OF_REJECTION = MappingProxyType(
    {
        "point": Finding.WRONG_POINT,
        "stripe": Finding.WRONG_STRIPE,
        "edge": Finding.WRONG_EDGES,
        "assignment": Finding.WRONG_LASERS,
        "radius": Finding.WRONG_RADIUS,
    }
)
"""The finding that each kind of rejection is."""

WITHOUT_STRIPES = (
    NoBreakPoints.NO_LASER_FRAME,
    NoBreakPoints.IMAGE_DARK,
    NoBreakPoints.IMAGE_SATURATED,
    NoBreakPoints.NO_STRIPE,
    NoBreakPoints.AMBIENT_CHANGED,
)
"""Reasons of shots in which no stripe was found or searched."""

CONTRADICTED = (
    NoBreakPoints.AMBIGUOUS_LABELS,
    NoBreakPoints.CONTRADICTED_MASKS,
    NoBreakPoints.CONTRADICTED_RIG,
    NoBreakPoints.UPSIDE_DOWN,
    NoBreakPoints.DARK_FRAME_LIT,
)
"""Reasons of shots whose stripes fit no ring as the rig and the lasers' masks assign them."""


def findings_of(detection: Detection, rejected: Sequence[Rejection] = ()) -> Finding:
    """What a detection shows by itself, and what was rejected by detector and estimator together."""
    findings = Finding.AMBIENT_CHANGED if detection.ambient_changed else NOTHING
    if detection.ghosts:
        findings |= Finding.GHOST_REMOVED
    if detection.break_points in CONTRADICTED:
        findings |= Finding.WRONG_LASERS
    if rejected and edges_missing(detection.rejected):
        findings |= Finding.NO_EDGES
    for each in rejected:
        findings |= FINDING_OF_REJECTION[each.what]
    return findings


def edges_missing(by_detector: Sequence[Rejection]) -> bool:
    """Whether ambient light should show the ring's edges, but the detector found none.

    Then nothing shows that the stripes end at the edges of a ring.
    """
    return any(each.what == "edge" for each in by_detector)


# What each laser contributed

SEEN_SHARE = 0.5
"""A stripe is expected to be found if at least this share of its length on the face is in view."""


def seen_lasers(
    best: "Explanation",
    break_points: BreakPoints,
    rig: Rig,
    lasers_on: Bool[Array, "laser"] | None,
    rejected: Sequence[Rejection],
) -> tuple[Mapping[str, LaserState], Finding]:
    """What each laser that was on contributed, and what should be in view but was not used.

    `rejected`: what the detector and the explanation have rejected.
    """
    used = np.zeros((len(rig.lasers.names), 2), dtype=bool)
    used[best.measured.points.laser, best.measured.points.edge] = True
    has_line = np.zeros(len(used), dtype=bool)
    has_line[best.measured.lines.laser] = True
    on = np.ones(len(used), dtype=bool) if lasers_on is None else lasers_on
    on = on | used.any(axis=1) | has_line
    if bool(used[on].all()):  # what is out of view need not be predicted
        inside, share = used, used.mean(axis=1)
    else:
        from ringpose.estimate.visibility import expected_in_view

        inside, share = expected_in_view(best, rig)
    states, findings = {}, NOTHING
    for laser in np.flatnonzero(on).tolist():
        contributed = bool(used[laser].any() or has_line[laser])
        mine = [each for each in rejected if each.laser == rig.lasers.names[laser]]
        if contributed:
            clipped = break_points.flags[laser] & int(BreakPointFlag.CLIPPED) != 0
            expected = inside[laser] if used[laser].any() else ~clipped  # a line without ends lies in the image
            missing = expected & ~used[laser]
            findings |= _why_missing(break_points.flags[laser, missing].tolist())
            whole = not (break_points.flags[laser] & int(BreakPointFlag.INTERRUPTED)).any()
            contribution = LaserState.USED if whole else LaserState.INTERRUPTED
            covered = not whole and bool((break_points.flags[laser, missing] & int(BreakPointFlag.OCCLUDED)).all())
            state = LaserState.PARTLY if mine or (missing.any() and not covered) else contribution
        elif mine or break_points.of_lasers[laser]:
            state, findings = LaserState.REJECTED, findings | Finding.STRIPE_UNUSED
        elif share[laser] >= SEEN_SHARE:
            state, findings = LaserState.NOT_SEEN, findings | Finding.STRIPE_NOT_FOUND
        else:
            state = LaserState.OUT_OF_VIEW
        states[rig.lasers.names[laser]] = state
    blunt = break_points.flags[used] & int(BreakPointFlag.BLUNT) != 0
    return states, findings | (Finding.BLUNT if blunt.any() else NOTHING)


def _why_missing(point_flags: list[int]) -> Finding:
    """Why break points that should be in view were not used, from the detector's flags."""
    findings = NOTHING
    for flags in point_flags:
        if flags & BreakPointFlag.OCCLUDED:
            findings |= Finding.POINT_UNUSED
        elif flags & BreakPointFlag.CLIPPED:
            findings |= Finding.POINT_CUT_OFF
        elif flags & BreakPointFlag.SATURATED:
            findings |= Finding.POINT_SATURATED
        else:
            findings |= Finding.POINT_UNUSED
    return findings


def unused_lasers(
    rig: Rig, lasers_on: Bool[Array, "laser"] | None, has_stripe: bool | Bool[Array, "laser"]
) -> Mapping[str, LaserState]:
    """The states of the lasers that were on, in a shot that has no pose: whether a stripe was found for them."""
    on, stripes = (
        np.broadcast_to(each, len(rig.lasers.names)) for each in (lasers_on is None or lasers_on, has_stripe)
    )
    states = (LaserState.REJECTED if stripe else LaserState.NOT_SEEN for stripe in stripes)
    return {name: state for name, state, lit in zip(rig.lasers.names, states, on, strict=True) if lit}


# What a line states in words

SENTENCES = MappingProxyType(
    {
        Finding.WRONG_POINT: "the {edge} break point of laser {laser} contradicts the others and was left out",
        Finding.WRONG_ENDS: "a break point of laser {laser} contradicts the others; both were left out",
        Finding.WRONG_STRIPE: "the stripe of laser {laser} contradicts the others and was left out",
        Finding.WRONG_EDGES: "the visible edges contradict the stripes and were left out",
        Finding.WRONG_LASERS: "the stripes fit one ring only as those of lasers {fitting}, not {given}",
        Finding.WRONG_RADIUS: "the ring that was seen does not have the given radii; they were left out",
        Finding.NOT_ROUND: "the ring deviates from a circle or a plane by more than assumed",
        Finding.FASTER: "the target moves faster than assumed",
        Finding.MOVED: "the target moved within the shot",
        Finding.FRAME_DIFFERS: "the frame with all lasers contradicts those with one; it was left out",
        Finding.UNEXPLAINED: (
            "what was seen disagrees with one ring by more than its errors, and no single part is to blame"
        ),
        Finding.NOT_TIMED: "the frames have no time stamps of their own: give --still if the target was still",
        Finding.NOT_CONVERGED: "the estimate did not converge",
        Finding.STRAIGHT: "the edges may be straight: the shot does not show that it is a ring",
        Finding.OTHER_SURFACE: "the single stripe may lie on another surface than the visible edges",
        Finding.FEW_ENDS: "too few ends of stripes are clear to show that it is a ring",
        Finding.SEVERAL_FACES: "two faces are at one height about one axis: give the radii of one of them",
        Finding.DISPLACED_STRIPE: "the stripe of laser {laser} is near the ring of the others, but not on it",
        Finding.NO_EDGES: "the ambient light should show the ring's edges, but they were not found",
        Finding.STRIPE_NOT_FOUND: "the stripe of laser {laser} should be in view, but was not found",
        Finding.BLUNT: "the ring's edges are rounded or chamfered",
        Finding.POINT_SATURATED: "a break point could not be measured, as its stripe is saturated",
        Finding.POINT_CUT_OFF: "a break point could not be measured, as its stripe is cut off by the image's border",
        Finding.AMBIENT_CHANGED: "ambient light changed within the shot",
        Finding.PLANE_MOVED: "the light plane of laser {laser} {change}",
        Finding.PLANE_OR_CAMERA_MOVED: "the light plane of laser {laser} {change}, or the camera has turned",
        Finding.RIG_DISAGREES: "the stripes disagree with the rig: a light plane or the camera has moved",
        Finding.SHOTS_CONTRADICT: ("most of the last shots contradict one ring: a light plane or the camera has moved"),
        Finding.RADII_DIFFER: (
            "the ring's radius differs between shots by {spread} (standard deviation), more than its errors allow: the "
            "ring is not round (give --ring-tolerance), or the rig has changed"
        ),
    }
)
"""What a finding adds to the reason of a line, in the order of `Finding`."""


def sentences(findings: Finding, **names: str) -> str:
    """What findings add to the reason; `names`: what their sentences name."""
    return "; ".join(SENTENCES[finding].format(**names) for finding in findings if finding in SENTENCES)


def explained(best: "Explanation") -> str:
    """What must be wrong with a shot for the rest to fit one ring, in words; empty if nothing is."""
    named = next((each for each in best.rejected if each.laser), Rejection(what="point"))
    fitting, given = best.exchanged or ("", "")
    causes = best.findings & ~Finding.UNEXPLAINED
    if best.exchanged is None:  # another assignment is only comparable
        causes &= ~Finding.WRONG_LASERS
    cause = sentences(causes, laser=named.laser or "", edge=named.edge or "", fitting=fitting, given=given)
    if Finding.UNEXPLAINED not in best.findings:
        return cause
    return f"{cause}, but the rest disagrees, too" if cause else sentences(Finding.UNEXPLAINED)


def reason_of(result: PoseResult, detection: Detection) -> str | None:
    """Why there is no pose, or what contradicts it, and what would improve the shot; None if there is neither."""
    no_pose = isinstance(result.pose, NoPose)
    why = result.pose.value if isinstance(result.pose, NoPose) else contradictions(result, detection.rejected)
    limited = no_pose or detection.ambient_changed or result.flags & ~HARMLESS_FLAGS
    changed = sentences(Finding.AMBIENT_CHANGED) if detection.ambient_changed else ""
    return "; ".join(filter(None, [why, changed, detection.advice if limited else ""])) or None


def contradictions(result: PoseResult, rejected: Sequence[Rejection]) -> str | None:
    """What was rejected or is missing, in words; None if everything that should be in view was used and agreed."""
    missing = [name for name, state in result.lasers.items() if state is LaserState.NOT_SEEN]
    remarks = [result.remark, rejection_remark(rejected)]
    if edges_missing(rejected):
        remarks.append(sentences(Finding.NO_EDGES))
    remarks += [sentences(Finding.STRIPE_NOT_FOUND, laser=name) for name in missing]
    if PoseFlag.POINT_REJECTED in result.flags:
        interrupted = [name for name, state in result.lasers.items() if state is LaserState.INTERRUPTED]
        remarks += [f"the stripe of laser {name} is interrupted" for name in interrupted]
    of_points = (Finding.BLUNT, Finding.POINT_SATURATED, Finding.POINT_CUT_OFF)
    remarks += [sentences(finding) for finding in of_points if flags_of(finding) in result.flags]
    return "; ".join(filter(None, remarks)) or None


def rejection_remark(rejected: Sequence[Rejection]) -> str:
    """The break points and stripes that the detector rejected, in words; empty if there are none."""
    names = [
        f"the {rejection.edge} break point of laser {rejection.laser}"
        for rejection in rejected
        if rejection.what == "point"
    ]
    names += [f"the stripe of laser {rejection.laser}" for rejection in rejected if rejection.what == "stripe"]
    if not names:
        return ""
    verbs = ("contradict", "were") if len(names) > 1 else ("contradicts", "was")
    return f"{' and '.join(names)} {verbs[0]} the others and {verbs[1]} left out"


def with_findings(line: PoseLine, findings: Finding, **names: str) -> PoseLine:
    """The line with what the stream has shown; `names`: what the sentences of the findings name."""
    reason = sentences(findings, **names)
    flags = line.flags | flags_of(findings)
    pose = None if line.pose is None else replace(line.pose, flags=line.pose.flags | flags)
    protection = None if line.protection is None else line.protection.without(unbounded(flags))
    reason = "; ".join(filter(None, [line.reason, reason]))
    return replace(line, flags=flags, pose=pose, protection=protection, reason=reason)
