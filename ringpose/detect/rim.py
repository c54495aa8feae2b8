"""Selection of the segments on the ring's face: one per laser, coplanar, ends on two concentric circles.

In a frame with several lasers on, this also assigns the stripes to the lasers: each assignment of segments to lasers,
exchanges included, is scored by how well one planar ring explains it (ringpose-method(7), section 3).

A stripe may be broken into several segments by speckle, a glint or a bracket. Whether two of them are on one surface is
not decided in advance: their union is a further candidate, with its scatter about one line, and the ring with the best
score decides.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.detect.stripes import LONG_COLUMNS, SAME_STRIPE_PX, lens, line_y_px
from ringpose.estimate.faults import SURFACE_TILT_SD_RAD
from ringpose.estimate.ring_estimate import STRIPES_OF_A_PLANE
from ringpose.estimate.solver import ALARM_SIGMAS
from ringpose.geometry.rays import undistorted_rays
from ringpose.geometry.sheets import bends_of, light_planes, sheet_points
from ringpose.kernels import _kernels
from ringpose.kernels.lines import (
    AFTER_END,
    BEFORE_START,
    CENTERS,
    CLIPPED,
    LASER,
    MIDDLE_X,
    MIDDLE_Y,
    NEAREST_M,
    SEGMENT_COLUMNS,
    SLOPE,
    X_END,
    X_START,
    CandidateParams,
    RingParams,
    UnionParams,
)
from ringpose.optics.feature_errors import AGREEMENT, CUT_OFF_PX
from ringpose.types.arrays import EDGES, Array, Bool, Float64, Int64
from ringpose.types.detection import UNLABELLED
from ringpose.types.rig import Camera, Rig

CONVINCING_SCORE = {3: 9.0, 2: 12.0, 1: 6.0}
"""Minimum score by number of segments, which foil hardly ever reaches; two segments have little redundancy."""

MAX_TO_SHORTEST = 2.5
"""Maximum ratio of the lengths of stripes on one face: they cross it at 45 degrees or more, and half of one may be
occluded; segments on foil have any length."""

IN_FRONT_M = (0.005, 0.3)
"""Range of the distance of another flat surface in front of the plane of a ring."""

MIN_LENGTH_RATIO = 0.5
"""Minimum length of that stripe, as a share of those on the ring."""

DISPLACED_M = 0.02
"""Maximum distance from a ring's plane of the stripe of a light plane that has moved; the body is farther behind."""

ALIKE_DISPLACED_M, ALIKE = 0.04, 1.15
"""The same for a stripe parallel to the plane and of the length of those on it, and the maximum ratio of their lengths.
With one of the selected stripes 10 px beside its place (0.5 m, lasers at 10 degrees) the third is 24 to 35 mm off."""

MOVED_RAD = math.radians(0.6)
"""Largest turn of a light plane since the calibration that is considered, seen from the camera."""


UNIONS = UnionParams(separation_sigmas=ALARM_SIGMAS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Face:
    """The segments on the ring's face."""

    lasers: tuple[int, ...]
    segments: Float64[Array, "segment column=12"]
    """One for each of these lasers; columns as in `SEGMENT_COLUMNS`."""
    score: float
    ambiguous: bool
    """Another assignment explains the same segments about as well."""
    behind: bool = False
    """Another segment is on a flat surface in front of these, which may be the face."""
    covered: frozenset[tuple[int, int]] = frozenset()
    """Lasers and ends (0 left, 1 right) at which something that stands on the face begins: they are on no edge."""
    displaced: tuple[int, ...] = ()
    """Lasers whose segment on the ring is not in its plane (`_beside_band`, `displaced_lasers`)."""
    outer_end: int | None = None
    """Which ends are on the outer edge, 0 left or 1 right; None if one arc was seen, whose ends do not show it."""
    crossing_sine: Float64[Array, "segment end=2"] | None = None
    """Sines of the angles at which the ends cross their edges, if both arcs were seen."""
    opposite: "Face | None" = None
    """The segments on the opposite arc. One that passes beside the hole, from outer edge to outer edge, is on both."""

    @property
    def is_confirmed(self) -> bool:
        """Whether its segments are more than a coincidence: three of them, or two stripes across both arcs."""
        return len(self.lasers) > STRIPES_OF_A_PLANE or (self.opposite is not None and len(self.lasers) > 1)

    def passes_beside_hole(self, laser: int) -> bool:
        """Whether the segment of a laser reaches from this arc to the opposite one."""
        if self.opposite is None or laser not in self.lasers or laser not in self.opposite.lasers:
            return False
        own, other = (face.segments[face.lasers.index(laser)] for face in (self, self.opposite))
        return bool(np.array_equal(own, other))


class Group(NamedTuple):
    """The best hypothesis with a given number of lasers: one segment for each of them."""

    lasers: tuple[int, ...]
    segments: tuple[int, ...]
    """Indices of the segments."""
    score: float
    """Log likelihood up to a constant; minus infinity if no group is possible."""
    rival: float
    """Best score of the same segments with another assignment to lasers."""
    covered: tuple[int, ...] = ()
    """For each segment the bits of its ends beyond which a nearer surface hides the plane: 1 left, 2 right."""


class Chord(NamedTuple):
    """A stripe across the face of a ring of which both arcs are in view, or across one of them."""

    laser: int
    segment: int
    """Index of the segment, or of the left one of two ..."""
    second: int
    """... and of the right one, on the opposite arc; -1 if there is none."""
    left_edge: int
    """Edge on which the first segment begins, 0 inner, 1 outer ..."""
    right_edge: int
    """... and on which it ends."""
    crossing_sine: tuple[float, float, float, float]
    """Sines of the angles at which the ends of both segments cross their edges; 0 for those of a missing one."""


class Chords(NamedTuple):
    """The best group of chords."""

    score: float
    rival: float
    """Best score of the same segments with another assignment to lasers."""
    chords: tuple[Chord, ...]
    """One for each of up to three lasers; none if no stripe is seen on both arcs."""

    @property
    def are_convincing(self) -> bool:
        """Whether foil hardly ever reaches the score, and no other assignment explains the segments about as well."""
        number = len(self.chords)
        return bool(number) and self.score > CONVINCING_SCORE[number] and not ambiguous(self.score, self.rival, number)


def ambiguous(score: float, rival: float, number: int) -> bool:
    """Whether another assignment of that number of segments explains them no worse than chance may.

    That of a single segment cannot be verified by its score, so that any other possible assignment makes it ambiguous.
    """
    return rival > (score - AGREEMENT if number > 1 else -math.inf)


class Faces(NamedTuple):
    """Hypotheses for the rim of the ring."""

    segments: Float64[Array, "n column=12"]
    """The given segments, followed by the merged ones."""
    groups: tuple[Group, Group, Group]
    """The best groups of one, two and three segments."""
    chords: Chords


def ring_face(segments: Float64[Array, "segment column=12"], lasers: Sequence[int], rig: Rig) -> Face | None:
    """The foremost face, from as many lasers as are consistent; None if no segment can be on a face.

    It is the one of the best score, unless there is one in front of it. `lasers` are those that an unlabelled segment
    may belong to.
    """
    unlabelled = sum(1 << laser for laser in lasers)
    ring = _ring_params(rig.camera)
    every, best_groups, chords = ring_faces(
        segments, unlabelled, planes_per_m(rig), ring, UNIONS, CandidateParams(), sheet_bends(rig)
    )
    if chords.are_convincing and len(chords.chords) > 1:
        return _foremost(face_of_both_arcs(chords, every, rig), segments, rig)
    groups: list[Group | None] = list(best_groups)
    best = best_hypothesis(groups)
    uneven: list[Group] = []
    while best is not None and not _lengths_consistent(every[list(best.segments)], best.lasers, rig):
        uneven.append(best)
        groups = [None if group is best else group for group in groups]
        best = best_hypothesis(groups)
    if chords.are_convincing and (best is None or _explains_more(chords, best)):
        return face_of_both_arcs(chords, every, rig)
    if best is None:
        return None
    beside = _beside_band(best, every, lasers, rig)
    best = best if beside is None else _without(best, beside)
    chosen = every[list(best.segments)]
    face = Face(
        lasers=best.lasers,
        segments=chosen,
        score=best.score,
        ambiguous=ambiguous(best.score, best.rival, len(best.segments)),
        displaced=_left_out(best, uneven) if beside is None else (beside,),
    )
    face, standing = _interrupted(face, best.covered, segments, lasers, rig)
    if STRIPES_OF_A_PLANE < len(face.lasers) < len(rig.lasers.names):
        face = _with_further_lasers(face, every, lasers, rig)
    foremost = _foremost(face, segments, rig)
    if foremost.segments is face.segments or not foremost.is_confirmed:  # no ring in front that all of three show
        foremost = _foremost(face, segments[~standing], rig)
    return replace(foremost, displaced=displaced_lasers(foremost, segments[~standing], lasers, rig))


def _with_further_lasers(
    face: Face, segments: Float64[Array, "segment column=12"], lasers: Sequence[int], rig: Rig
) -> Face:
    """The face with the segments of a rig's fourth and further lasers that are near its plane and about as long.

    Whether their ends lie on its circles is judged by the estimator. Neighbouring stripes of many lasers may fit when
    all of them are shifted by one: the assignment is ambiguous if another one leaves no more lasers without a segment.
    """
    on_plane = _segments_on_plane(face, segments, lasers, rig)
    unlabelled = bool((face.segments[:, LASER] == UNLABELLED).any())
    count = len(rig.lasers.names)
    for shift in range(-count, count) if unlabelled else ():
        shifted = tuple(laser + shift for laser in face.lasers)
        if shift and set(shifted) <= set(lasers):
            other = _segments_on_plane(replace(face, lasers=shifted), segments, lasers, rig)
            if len(other) >= len(on_plane):
                return replace(face, ambiguous=True)
    return replace(
        face, lasers=tuple(sorted(on_plane)), segments=np.array([on_plane[laser] for laser in sorted(on_plane)])
    )


def _segments_on_plane(
    face: Face, segments: Float64[Array, "segment column=12"], lasers: Sequence[int], rig: Rig
) -> dict[int, list[float]]:
    """The segments of the face, and of each other laser the longest one on its plane; none if they have no plane."""
    ends_m, lengths_m, origin, normal = plane_of(face.segments, face.lasers, rig)
    used = face.segments.tolist()
    by_laser = {
        laser: row
        for laser, row in zip(face.lasers, used, strict=True)
        if _off_plane_px(row, laser, origin, normal, rig) < SAME_STRIPE_PX
    }
    if len(by_laser) < len(used) or float(ends_m[:, :, 2].min()) < NEAREST_M:
        return {}
    for row in sorted(segments.tolist(), key=lambda row: -row[CENTERS]):
        for laser in lasers if row[LASER] == UNLABELLED else (int(row[LASER]),):
            if laser in by_laser or row in by_laser.values():
                continue
            (own_m,) = segment_ends_m(np.array([row]), [laser], rig)
            as_long = max(lengths_m) / MAX_TO_SHORTEST < math.dist(*own_m) < MAX_TO_SHORTEST * min(lengths_m)
            in_front = own_m[:, 2].min() > NEAREST_M
            if in_front and as_long and _off_plane_px(row, laser, origin, normal, rig) < SAME_STRIPE_PX:
                by_laser[laser] = row
    return by_laser


def _off_plane_px(
    row: Sequence[float], laser: int, origin_m: Float64[Array, "xyz=3"], normal: Float64[Array, "xyz=3"], rig: Rig
) -> float:
    """Largest distance in rows of a segment's ends from the line in which a plane meets that laser's light plane.

    That line is (a - n / (n . o)) . (x, y, 1) = 0, with the light plane a . P = 1.
    """
    optics = lens(rig.camera)
    flat, off_px = normal / (normal @ origin_m), []
    for x_px in (row[X_START], row[X_END]):
        x = (x_px - optics.cx) / optics.fx
        y_px = row[MIDDLE_Y] + row[SLOPE] * (x_px - row[MIDDLE_X])
        line = _light_per_m(x, (y_px - optics.cy) / optics.fy, laser, rig) - flat
        off_px.append(abs(optics.cy - optics.fy * float((line[0] * x + line[2]) / (line[1] or math.nan)) - y_px))
    return max(off_px)


def ring_faces(
    segments: Float64[Array, "segment column=12"],
    unlabelled: int,
    planes: Float64[Array, "laser xyz=3"],
    ring: RingParams,
    unions: UnionParams,
    candidates: CandidateParams,
    sheets: Float64[Array, "laser column=10"] | None = None,
) -> Faces:
    """The best groups of one, two and three segments, each of another laser, that lie on the rim of one planar ring.

    `unlabelled` is the bit mask of the lasers that segments without a laser may belong to. `planes` are the light
    planes as normal / distance, so that 1/z = (normal / distance) . (x, y, 1) on them, and `sheets` their bends
    (`sheet_bends`). Collinear segments are tried as one, too. The score is the sum of the merits less the costs of
    plane and circles, the penalties of missing lasers, and a tilt prior of sigma 0.5 rad.
    """
    segments, planes = np.ascontiguousarray(segments), np.ascontiguousarray(planes)
    every, (one, two, three), of_chords = _kernels.faces(segments, unlabelled, planes, sheets, unions, candidates, ring)
    groups = Group(*one), Group(*two), Group(*three)
    score, rival, chords = of_chords
    both_arcs = Chords(score, rival, tuple(Chord(*chord) for chord in chords))
    return Faces(np.frombuffer(every, np.float64).reshape(-1, len(SEGMENT_COLUMNS)), groups, both_arcs)


def face_of_both_arcs(chords: Chords, segments: Float64[Array, "segment column=12"], rig: Rig) -> Face:
    """The face by a group of chords, from the arc nearer to the middle of the image, with the opposite arc."""
    arcs = []
    for side in range(2):  # on the left arc the left ends are on the outer edge
        of_arc = {}
        for chord in chords.chords:
            if chord.second >= 0:
                of_arc[chord.laser] = (chord.segment, chord.second)[side], chord.crossing_sine[2 * side : 2 * side + 2]
            elif (chord.left_edge, chord.right_edge)[side] == EDGES.index("outer"):
                of_arc[chord.laser] = chord.segment, chord.crossing_sine[:2]
        numbers, sines = zip(*of_arc.values(), strict=True)
        arcs.append(
            Face(
                lasers=tuple(of_arc),
                segments=segments[list(numbers)],
                score=chords.score,
                ambiguous=False,
                outer_end=side,
                crossing_sine=np.array(sines),
            )
        )
    optics = lens(rig.camera)
    off_px = [
        math.hypot(float(arc.segments[:, end].mean()) - optics.cx, float(arc.segments[:, MIDDLE_Y].mean()) - optics.cy)
        for arc, end in zip(arcs, (X_START, X_END), strict=True)
    ]
    near, far = arcs if off_px[0] <= off_px[1] else reversed(arcs)
    return replace(near, opposite=far)


FURTHER_AGREEMENTS = 2
"""Two pieces on one line with ends about one middle agree three times by chance, two segments on one plane once."""


def _explains_more(chord: Chords, group: Group) -> bool:
    """Whether a single stripe across both arcs is more probable than fewer than three segments on one arc."""
    return len(group.segments) <= STRIPES_OF_A_PLANE and chord.score + FURTHER_AGREEMENTS * AGREEMENT > group.score


def best_hypothesis(groups: Sequence[Group | None]) -> Group | None:
    """The largest group, unless a smaller one has a sufficiently better score; None if no score is high enough.

    A single segment has no redundancy. Two are verified by a common plane, and three by a common plane and two circles,
    which is hardly ever a coincidence: if three score less than two others, the cause may be a broken segment. Two
    segments next to a single one of a far better score are on the body behind it.
    """
    one, two, three = (
        group if group is not None and group.score > CONVINCING_SCORE[len(group.segments)] else None for group in groups
    )
    if one is not None and two is not None and not set(one.segments) < set(two.segments) and two.score < 2 * one.score:
        two = None
    if two is None or three is None:
        return three or two or one
    among = set(zip(two.lasers, two.segments, strict=True)) < set(zip(three.lasers, three.segments, strict=True))
    return three if three.score > two.score + (AGREEMENT if among else -AGREEMENT) else two


def _left_out(group: Group, larger: Sequence[Group]) -> tuple[int, ...]:
    """The lasers whose segment makes one of the larger groups of this one."""
    pairs = set(zip(group.lasers, group.segments, strict=True))
    more = (set(zip(each.lasers, each.segments, strict=True)) for each in larger)
    return tuple(sorted({laser for each in more if pairs < each for laser, _ in each - pairs}))


def _lengths_consistent(segments: Float64[Array, "segment column=12"], lasers: Sequence[int], rig: Rig) -> bool:
    """Whether the segments may cross one band: none is much shorter than another one, unless the image truncates it.

    One of three that is truncated may be long: where it passes beside the hole.
    """
    lengths_m = _lengths_m(segment_ends_m(segments, lasers, rig))
    whole_m = lengths_m[segments[:, CLIPPED] == 0]
    longest_m = whole_m if len(segments) > STRIPES_OF_A_PLANE else lengths_m
    return bool(longest_m.max(initial=0.0) < MAX_TO_SHORTEST * whole_m.min(initial=math.inf))


def _without(group: Group, laser: int) -> Group:
    """The group without the segment of a laser, with the scores of all of them."""
    kept = [number for number, each in enumerate(group.lasers) if each != laser]
    columns = group.lasers, group.segments, group.covered
    lasers, segments, covered = (tuple(each[number] for number in kept) for each in columns)
    return group._replace(lasers=lasers, segments=segments, covered=covered)


def _beside_band(
    group: Group, segments: Float64[Array, "segment column=12"], lasers: Sequence[int], rig: Rig
) -> int | None:
    """The laser of three whose segment is beside the band of the other two, where another one of its segments is.

    If a light plane has moved, the ring's three stripes are no longer coplanar, but one on the body may be with two of
    them, as light planes are nearly parallel. Where a stripe is along its light plane, and how long it is, has hardly
    changed: the laser's stripe on the ring is as long as the other two, on their band, and coplanar with them after a
    small turn of one light plane.
    """
    start_px, end_px = segments[list(group.segments)][:, [X_START, X_END]].T
    if len(group.segments) <= STRIPES_OF_A_PLANE or start_px.max() < end_px.min():
        return None
    for laser, segment in zip(group.lasers, group.segments, strict=True):
        pair = _without(group, laser)
        rows = segments[list(pair.segments)]
        plane = plane_of(rows, pair.lasers, rig)
        if plane.on_band(segment_ends_m(segments[[segment]], [laser], rig))[0]:
            continue
        others = _of_laser(_others(rows, segments), laser, lasers)
        ends_m = segment_ends_m(others, [laser] * len(others), rig)
        for other in others[plane.on_band(ends_m) & plane.alike(ends_m)]:
            if _turn_rad(np.stack([*rows, other]), [*pair.lasers, laser], rig) < MOVED_RAD:
                return laser
    return None


def _turn_rad(segments: Float64[Array, "segment=3 column=12"], lasers: Sequence[int], rig: Rig) -> float:
    """The smallest turn of one of three light planes after which these segments are coplanar, seen from the camera."""
    off_px = []
    for number, laser in enumerate(lasers):
        others = [each for each in range(len(lasers)) if each != number]
        plane = plane_of(segments[others], [lasers[each] for each in others], rig)
        off_px.append(_off_plane_px(segments[number].tolist(), laser, plane.origin_m, plane.normal, rig))
    return min(off_px) / lens(rig.camera).fy


class SegmentPlane(NamedTuple):
    """The plane of the selected segments."""

    ends_m: Float64[Array, "segment end=2 xyz=3"]
    lengths_m: list[float]
    origin_m: Float64[Array, "xyz=3"]
    normal: Float64[Array, "xyz=3"]
    """Unit normal towards the camera."""

    def on_band(self, ends_m: Float64[Array, "n end=2 xyz=3"]) -> Bool[Array, "n"]:
        """Whether stripes with these ends overlap the band of two selected ones, seen along the normal."""
        across = self.ends_m[1].mean(axis=0) - self.ends_m[0].mean(axis=0)
        along = across / np.linalg.norm(across)
        offset_m = ends_m.mean(axis=1) - self.origin_m
        aside_m = offset_m - np.outer(offset_m @ along, along) - np.outer(offset_m @ self.normal, self.normal)
        overlap: Bool[Array, "n"] = np.linalg.norm(aside_m, axis=1) < max(self.lengths_m)
        return overlap

    def alike(self, ends_m: Float64[Array, "n end=2 xyz=3"]) -> Bool[Array, "n"]:
        """Whether stripes with these ends are parallel to the plane, and as long as the selected ones."""
        length_m, off_m = _lengths_m(ends_m), (ends_m - self.origin_m) @ self.normal
        as_long = np.maximum(max(self.lengths_m) / length_m, length_m / min(self.lengths_m)) < ALIKE
        alike: Bool[Array, "n"] = as_long & (np.ptp(off_m, axis=1) < SURFACE_TILT_SD_RAD * length_m)
        return alike


def plane_of(segments: Float64[Array, "segment column=12"], lasers: Sequence[int], rig: Rig) -> SegmentPlane:
    """The plane through the ends of two or more segments."""
    ends_m = segment_ends_m(segments, lasers, rig)
    points_m = ends_m.reshape(-1, 3)
    origin_m = points_m.mean(axis=0)
    normal = np.linalg.svd(points_m - origin_m, full_matrices=False)[2][2]
    return SegmentPlane(ends_m, _lengths_m(ends_m).tolist(), origin_m, -np.sign(normal @ origin_m) * normal)


def _others(
    selected: Float64[Array, "selected column=12"], segments: Float64[Array, "segment column=12"]
) -> Float64[Array, "other column=12"]:
    """The other segments that are not truncated by the image, and longer than most reflections."""
    used = (segments[:, None] == selected).all(axis=2).any(axis=1)
    return segments[~used & (segments[:, CLIPPED] == 0) & (segments[:, CENTERS] >= LONG_COLUMNS)]


def _of_laser(
    segments: Float64[Array, "segment column=12"], laser: int, lasers: Sequence[int]
) -> Float64[Array, "own column=12"]:
    """The segments that may be of a laser; `lasers`: those that an unlabelled segment may belong to."""
    return segments[is_of_laser(segments, laser, lasers)]


def is_of_laser(
    segments: Float64[Array, "segment column=12"], laser: int, lasers: Sequence[int]
) -> Bool[Array, "segment"]:
    """Mask of the same."""
    mask: Bool[Array, "segment"] = (segments[:, LASER] == laser) | (
        (segments[:, LASER] == UNLABELLED) & (laser in lasers)
    )
    return mask


def _interrupted(
    face: Face,
    covered: Sequence[int],
    segments: Float64[Array, "segment column=12"],
    lasers: Sequence[int],
    rig: Rig,
) -> tuple[Face, Bool[Array, "segment"]]:
    """The face with its ends at what stands on it, and which of the segments are on that.

    Where a nearer surface begins at an end of a stripe, and ends where the band does that the longest stripe shows, it
    stands on the face: on a ring in front there would be light of that laser, too. It is not higher than the band is
    wide.
    """
    standing, at_ends = np.zeros(len(segments), dtype=bool), set()
    if len(face.lasers) <= 1 or not any(covered):
        return face, standing
    plane = plane_of(face.segments, face.lasers, rig)
    whole = int(np.argmax(plane.lengths_m))
    band_m = plane.lengths_m[whole]
    if face.segments[whole, CLIPPED]:
        return face, standing
    for number, (row, laser) in enumerate(zip(face.segments, face.lasers, strict=True)):
        own = np.flatnonzero(is_of_laser(segments, laser, lasers))
        start, end, x, y = segments[own][:, [X_START, X_END, MIDDLE_X, MIDDLE_Y]].T
        ends_m = segment_ends_m(segments[own], [laser] * len(own), rig)
        off_m = (ends_m - plane.origin_m) @ plane.normal
        in_front = (off_m.min(axis=1) > 0.0) & (off_m.max(axis=1) < band_m)
        if number == whole:
            apart = np.abs(y - line_y_px(row, x)) > SAME_STRIPE_PX
            if (in_front & apart & (start < row[X_END]) & (end > row[X_START])).any():
                return face, np.zeros_like(standing)
            continue
        for side in (side for side in range(2) if covered[number] >> side & 1 and not row[CLIPPED]):
            reach_m = ends_m[:, side] - plane.ends_m[number, 1 - side]
            reach_m = np.linalg.norm(reach_m - np.outer(reach_m @ plane.normal, plane.normal), axis=1)
            beyond = x > row[X_END] if side else x < row[X_START]
            on_face = in_front & beyond & (reach_m > band_m / ALIKE) & (reach_m < ALIKE * band_m)
            standing[own[on_face]] = True
            if on_face.any():
                at_ends.add((laser, side))
    return replace(face, covered=frozenset(at_ends)), standing


def _foremost(face: Face, segments: Float64[Array, "segment column=12"], rig: Rig) -> Face:
    """The face, or the one in front of it; `behind` if another surface in front of it may be the face.

    A ring's face is its foremost flat surface; a flange behind it is an annulus, too, and a wider one has longer
    stripes. Three stripes in front that make a face are on it. Stripes of two lasers there, or one that is about as
    long as the selected ones, may be all that is seen of it; a shorter one may be a reflection, and a much longer one
    is not on a ring. A single laser's stripe does not determine a plane. Segments that are not assigned to a laser are
    examined only as three that make a face: by the plane of another laser, a stripe on the body may be anywhere. A
    stripe of a laser without a selected one may be off the plane because its light plane has moved
    (`displaced_lasers`).
    """
    on_face, of_lasers = face.segments, face.lasers
    if face.opposite is not None:
        on_face = np.concatenate([on_face, face.opposite.segments])
        of_lasers = (*of_lasers, *face.opposite.lasers)
    if len(face.lasers) <= 1 or not len(others := _others(on_face, segments)):
        return face
    plane, lasers = plane_of(on_face, of_lasers, rig), np.array(face.lasers)
    which, number = np.nonzero((others[:, LASER, None] == lasers) | (others[:, LASER, None] == UNLABELLED))
    ends_m = segment_ends_m(others[which], lasers[number], rig)
    rows = others[sorted(set(which[_in_front(ends_m, plane.origin_m, plane.normal)].tolist()))]
    nearer = ring_face(_beside_face(rows, on_face), face.lasers, rig) if len(rows) > 1 else None
    if nearer is not None and len(nearer.lasers) > 1 and (nearer.is_confirmed or nearer.score > face.score):
        nearer_m, _, _, normal = plane_of(nearer.segments, nearer.lasers, rig)
        parallel = float(np.linalg.norm(normal - plane.normal)) < SURFACE_TILT_SD_RAD
        if parallel and bool(_in_front(nearer_m, plane.origin_m, plane.normal).all()):
            return _as_measured(nearer, rows)
    length_m, may_be_face = _lengths_m(ends_m), parallel_in_front(ends_m, plane.origin_m, plane.normal)
    short = length_m < MAX_TO_SHORTEST * max(plane.lengths_m)
    start, end = face.segments[number][:, [X_START, X_END]].T
    on_face = length_m < MIN_LENGTH_RATIO * min(plane.lengths_m)  # a head, between two pieces of the stripe
    on_face &= (others[which, X_START] > start) & (others[which, X_END] < end)
    assigned = np.flatnonzero((others[which, LASER] != UNLABELLED) & may_be_face & short & ~on_face)
    as_long = length_m[assigned].max(initial=0.0) > MIN_LENGTH_RATIO * min(plane.lengths_m)
    return replace(face, behind=bool(as_long) or len(set(number[assigned].tolist())) > 1)


def _beside_face(
    nearer: Float64[Array, "segment column=12"], on_face: Float64[Array, "selected column=12"]
) -> Float64[Array, "segment column=12"]:
    """Segments in front of a face, without its stripe among the centres on their lines beyond their ends.

    If the step is small, that stripe is nearly on the line of what is in front of it.
    """
    rows = nearer.copy()
    for own in on_face:
        for column, end, beyond in (
            (BEFORE_START, X_START, rows[:, X_START] - own[X_START]),
            (AFTER_END, X_END, own[X_END] - rows[:, X_END]),
        ):
            apart_px = np.abs(line_y_px(rows, rows[:, end]) - line_y_px(own, rows[:, end]))
            is_own = (rows[:, LASER] == own[LASER]) & (apart_px < SAME_STRIPE_PX)
            rows[is_own, column] -= np.clip(beyond, 0.0, rows[:, column])[is_own]
    return rows


def _as_measured(face: Face, segments: Float64[Array, "segment column=12"]) -> Face:
    """The face of segments as `_beside_face` leaves them, some merged, with all centres beyond their ends."""
    rows = face.segments.copy()
    for row in rows:
        for column, end in ((BEFORE_START, X_START), (AFTER_END, X_END)):
            same = segments[(segments[:, LASER] == row[LASER]) & (segments[:, end] == row[end])]
            apart_px = np.abs(line_y_px(same, row[end]) - line_y_px(row, row[end]))
            row[column] = same[apart_px.argmin(), column]
    opposite = None if face.opposite is None else _as_measured(face.opposite, segments)
    return replace(face, segments=rows, opposite=opposite)


def _in_front(
    ends_m: Float64[Array, "n end=2 xyz=3"], origin_m: Float64[Array, "xyz=3"], normal: Float64[Array, "xyz=3"]
) -> Bool[Array, "n"]:
    """Whether stripes with these ends are on surfaces in front of a plane (`IN_FRONT_M`)."""
    off_m = (ends_m - origin_m) @ normal
    return (off_m.min(axis=1) > IN_FRONT_M[0]) & (off_m.max(axis=1) < IN_FRONT_M[1])


def parallel_in_front(
    ends_m: Float64[Array, "n end=2 xyz=3"], origin_m: Float64[Array, "xyz=3"], normal: Float64[Array, "xyz=3"]
) -> Bool[Array, "n"]:
    """Whether stripes with these ends are on surfaces in front of a plane (`IN_FRONT_M`) and parallel to it."""
    slope_m = np.abs((ends_m[:, 1] - ends_m[:, 0]) @ normal)
    return _in_front(ends_m, origin_m, normal) & (slope_m < SURFACE_TILT_SD_RAD * _lengths_m(ends_m))


def displaced_lasers(
    face: Face, segments: Float64[Array, "segment column=12"], lasers: Sequence[int], rig: Rig
) -> tuple[int, ...]:
    """Lasers whose stripe was not selected, but which have one like those on the ring close to its plane.

    Such a stripe is that of the ring if the rig has changed; two selected stripes always agree with some ring. `lasers`
    are those that an unlabelled segment may belong to.
    """
    if len(face.lasers) != STRIPES_OF_A_PLANE:
        return ()
    if not len(others := _others(face.segments, segments)):
        return face.displaced
    plane = plane_of(face.segments, face.lasers, rig)
    shortest_m, longest_m = min(plane.lengths_m), max(plane.lengths_m)
    displaced = list(face.displaced)
    for laser in set(range(len(rig.lasers.names))).difference(face.lasers, face.displaced):
        own = _of_laser(others, laser, lasers)
        ends_m = segment_ends_m(own, [laser] * len(own), rig)
        length_m, off_m = _lengths_m(ends_m), (ends_m - plane.origin_m) @ plane.normal
        near = np.abs(off_m).max(axis=1) < np.where(plane.alike(ends_m), ALIKE_DISPLACED_M, DISPLACED_M)
        as_long = (length_m > shortest_m / MAX_TO_SHORTEST) & (length_m < MAX_TO_SHORTEST * longest_m)
        if bool((as_long & near & plane.on_band(ends_m)).any()):
            displaced.append(laser)
    return tuple(sorted(displaced))


def segment_ends_m(
    segments: Float64[Array, "n column=12"], lasers: Sequence[int] | Int64[Array, "n"], rig: Rig
) -> Float64[Array, "n end=2 xyz=3"]:
    """The ends of segments in space (m, camera frame), each on the light plane of its laser."""
    x_px = segments[:, [X_START, X_END]]
    y_px = segments[:, MIDDLE_Y, None] + segments[:, SLOPE, None] * (x_px - segments[:, MIDDLE_X, None])
    optics = lens(rig.camera)
    rays = np.ones((*x_px.shape, 3))
    rays[..., 0], rays[..., 1] = (x_px - optics.cx) / optics.fx, (y_px - optics.cy) / optics.fy
    if rig.bows:
        return sheet_points(rays, np.asarray(lasers)[:, None], rig)
    inverse_depth = rays @ planes_per_m(rig)[lasers, :, None]
    inverse_depth[inverse_depth == 0.0] = np.nan  # along the light plane
    ends_m: Float64[Array, "n end=2 xyz=3"] = rays / inverse_depth
    return ends_m


def _lengths_m(ends_m: Float64[Array, "n end=2 xyz=3"]) -> Float64[Array, "n"]:
    lengths_m: Float64[Array, "n"] = np.sqrt(((ends_m[:, 1] - ends_m[:, 0]) ** 2).sum(axis=1))
    return lengths_m


def _light_per_m(x: float, y: float, laser: int, rig: Rig) -> Float64[Array, "xyz=3"]:
    """The plane of a laser as in `planes_per_m`; of a bent sheet that where the ray (x, y, 1) meets it."""
    if not rig.bows:
        return planes_per_m(rig)[laser]
    normal, distance_m = light_planes(np.array([[x, y, 1.0]]), np.array([laser]), rig)
    per_m: Float64[Array, "xyz=3"] = normal[0] / distance_m
    return per_m


@lru_cache(maxsize=4)
def planes_per_m(rig: Rig) -> Float64[Array, "laser xyz=3"]:
    """The light planes as m / d in 1/m: points on them satisfy 1/z = (m / d) . (x, y, 1)."""
    planes: Float64[Array, "laser xyz=3"] = rig.lasers.normal / rig.lasers.distance_m[:, None]
    return planes


@lru_cache(maxsize=4)
def sheet_bends(rig: Rig) -> Float64[Array, "laser column=10"] | None:
    """The bends of the light planes as `ring_faces` takes them; None if all are flat.

    Columns: bow over the plane's distance, then projector, axis and the direction aside, as in `Bends`.
    """
    bent = bends_of(rig)
    if bent is None:
        return None
    ratio = bent.per_rad / rig.lasers.distance_m
    return np.ascontiguousarray(np.column_stack([ratio, bent.projector_m, bent.axis, bent.aside]))


@lru_cache(maxsize=4)
def _ring_params(camera: Camera) -> RingParams:
    matrix = camera.camera_matrix
    rows = np.linspace(0.0, camera.image_height - 1.0, 9)
    inside = (CUT_OFF_PX, camera.image_width - 1 - CUT_OFF_PX)
    left, right = (undistorted_rays(np.stack([np.full(9, x), rows], axis=-1), camera)[:, 0] for x in inside)
    columns = np.linspace(0.0, camera.image_width - 1.0, 9)
    above = (CUT_OFF_PX, camera.image_height - 1 - CUT_OFF_PX)
    top, bottom = (undistorted_rays(np.stack([columns, np.full(9, y)], axis=-1), camera)[:, 1] for y in above)
    return RingParams(
        focal_x=matrix[0, 0],
        focal_y=matrix[1, 1],
        principal_x=matrix[0, 2],
        principal_y=matrix[1, 2],
        left_x=float(left.max()),
        right_x=float(right.min()),
        top_y=float(top.max()),
        bottom_y=float(bottom.min()),
    )
