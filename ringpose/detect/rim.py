"""Which tracks lie on the ring's face: one a laser, all on one plane, their ends on two circles about one centre.

This is also what labels the stripes of a frame with several lasers on: every assignment of tracks to lasers is
scored by how well one planar ring explains it, order swaps included.

Tracks may be pieces of one stripe that speckle, a glint or a bracket broke. Whether two are one surface is not decided
beforehand: their union stands beside them, with the scatter that it has about one line, and the ring that explains it
best chooses.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ringpose.detect.stripes import MIN_SEGMENT_COLUMNS, TAKEN_BY_THE_FIT, lens
from ringpose.geometry.rays import undistorted_rays
from ringpose.kernels.lines import (
    CLIPPED,
    LASER,
    MIDDLE_X,
    MIDDLE_Y,
    SLOPE,
    X_END,
    X_START,
    CandidateParams,
    FaceParams,
    Group,
    RingParams,
    UnionParams,
    ring_faces,
)
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.detection import UNLABELLED
from ringpose.types.rig import Rig

DEPTH_RANGE_M = (0.05, 3.0)
"""Where a ring can be: wider on both sides than the 0.2 to 1 m that the method is made for."""

FACE_LENGTH_M = (0.003, 0.1)
"""Length of a stripe on the face: bands of adapter rings are 20 to 60 mm wide and crossed at 45 degrees or more."""

MAXIMUM_TILT_RAD = float(np.deg2rad(75))
"""Beyond this a face is too oblique to show a stripe of any length."""

MINIMUM_RADIUS_M = 0.2
"""The smallest adapter rings are half as large again."""

MINIMUM_BAND_M = 0.003
"""Narrower bands are edges, not faces."""

BORDER_PX = 15.0
"""Closer to the image's upper or lower border a stripe may well be missed."""

CUT_OFF_PX = 6.0
"""An end so close to the left or right border is where the image ends, not the face."""

CUT_OFF_ROWS_PX = 10.0
"""The same for the upper and lower border, where no stripe is measured whose section is not whole: 6.5 px at most."""

MIN_SPILT = 5
"""A track with fewer centres on its line beyond its ends has nothing to be joined to."""

MAX_GAP = 0.5
"""A gap of more than this share of both pieces together is no interruption."""

APART_PX, APART_SIGMAS = 1.0, 3.0
"""How far apart the lines may be in the middle of the gap: facets behind a stripe, and their own errors."""

MAX_DISTANCE_PX = 6.0
"""Lines farther apart than this are not compared any further."""

ROUNDS = 2
"""Pieces of three or four are joined two by two."""

CANDIDATES = 20
"""Tracks of the greatest merit that are tried for each laser."""

ACROSS_SIGMA_PX = 0.4
"""How far a track may lie from the plane's: noise of the line and of the calibration."""

ALONG_SIGMA_PX = 2.0
"""How far a track's end may lie from its circle, before it is refined."""

PLANE_LIMIT = 8.0
"""Squared sigmas over two above which tracks do not lie on one plane, for each laser."""

CIRCLE_LIMIT = 6.0
"""Squared sigmas over two above which ends do not lie on two circles, for each laser."""

DROPPED_END_PENALTY = 6.0
"""What it costs (in squared sigmas over two) to call one of six ends occluded: once in four hundred by chance."""

UNSEEN_PENALTY = 6.0
"""What it costs that a laser's stripe is not seen where the face would show it: occluded, or not this face."""

SPILL_PENALTY = 15.0
"""What it costs if all of a stripe's centres on a track's line lie beyond the track: a face ends with its track."""

COINCIDENCE_PENALTY, BEHIND_M = 3.0, (0.01, 0.3)
"""The same, at most, where they may be another laser's on the body so far behind: nearly parallel light planes draw its
stripes so close to one another that one in five faces has another's on its line."""

UNION_PENALTY = 3.0
"""What it costs that a track is put together: the body's stripes, broken by shadows and glints, gain by it as well."""

CLIPPED_PENALTY = 4.0
"""What it costs that a track leaves the image: there is no seeing whether it would have ended."""

USUAL_SCATTER_PX = 0.3
"""Of a stripe's centres about its line on metal."""

ENOUGH_COLUMNS = 120
"""A longer track is no more likely to be a face: the body behind has the longest."""

CONVINCING_SCORE = {3: 9.0, 2: 12.0, 1: 6.0}
"""Scores that tracks on foil hardly ever reach by chance, by number of tracks; two tracks are checked by little."""

TRACK_PENALTY = 3.0
"""What another track must add to the score: a piece of foil that happens to lie in the plane adds less."""

CLEAR_MARGIN = {3: 4.0, 2: 4.0, 1: math.inf}
"""Two labellings whose scores differ by less are both possible, by number of tracks; nothing checks that of a single
one: where stripes cross, what seems to be unseen is not, so that any other possible label is one too many."""

CONFIRMED = 3
"""Fewer tracks on one plane may be there by chance, so that it matters what else they may be."""

MAX_TO_SHORTEST = 2.5
"""Stripes cross a band at 45 degrees or more, one may be hidden by half; pieces of foil have any length."""

BODY_RANGE_M = (0.15, 1.5)
"""Where the body behind a ring is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Face:
    """The tracks on the ring's face."""

    lasers: tuple[int, ...]
    tracks: Float64[Array, "track column=11"]
    """Of each of these lasers; columns as in `TRACK_COLUMNS`."""
    score: float
    ambiguous: bool
    """Another labelling explains the same tracks about as well, or as the body's."""


def ring_face(tracks: Float64[Array, "track column=11"], lasers: Sequence[int], rig: Rig) -> Face | None:
    """The most convincing face, from as many lasers as agree on one; None if no track will do.

    `lasers` are those that an unlabelled track may belong to.
    """
    unlabelled = sum(1 << laser for laser in lasers)
    every, found = ring_faces(tracks, unlabelled, planes_per_m(rig), _rules(rig))
    groups: list[Group | None] = list(found)
    best = best_hypothesis(groups)
    while best is not None and not _alike(every[list(best.tracks)], best.lasers, rig):
        groups = [None if group is best else group for group in groups]
        best = best_hypothesis(groups)
    if best is None:
        return None
    chosen = every[list(best.tracks)]
    return Face(
        lasers=best.lasers,
        tracks=chosen,
        score=best.score,
        ambiguous=best.rival > best.score - CLEAR_MARGIN[len(best.tracks)]
        or (len(best.tracks) < CONFIRMED and may_be_background(chosen, best.lasers, lasers, rig)),
    )


def best_hypothesis(groups: Sequence[Group | None]) -> Group | None:
    """The largest group, unless a smaller one says more; None if none convinces.

    Nothing confirms a single track. Two are confirmed by one plane, and three by one plane and two circles, which
    is hardly ever so by chance: what three have less in score than other two may be the price of a broken track.
    Two beside a more convincing one are pieces of the body behind it.
    """
    one, two, three = (
        group if group is not None and group.score > CONVINCING_SCORE[len(group.tracks)] else None for group in groups
    )
    if one is not None and two is not None and not set(one.tracks) < set(two.tracks) and two.score < 2 * one.score:
        two = None
    if two is None or three is None:
        return three or two or one
    among = set(zip(two.lasers, two.tracks, strict=True)) < set(zip(three.lasers, three.tracks, strict=True))
    return three if three.score > two.score + (TRACK_PENALTY if among else -TRACK_PENALTY) else two


def _alike(tracks: Float64[Array, "track column=11"], lasers: Sequence[int], rig: Rig) -> bool:
    """Whether stripes may cross one band: none of them, but those that leave the image, much shorter than another."""
    rows = tracks.tolist()
    lengths_m = [math.dist(*_points_m(row, laser, rig)) for row, laser in zip(rows, lasers, strict=True)]
    whole_m = [length_m for row, length_m in zip(rows, lengths_m, strict=True) if not row[CLIPPED]]
    return not whole_m or max(lengths_m) < MAX_TO_SHORTEST * min(whole_m)


def may_be_background(
    tracks: Float64[Array, "track column=11"], own: Sequence[int], lasers: Sequence[int], rig: Rig
) -> bool:
    """Whether some track would be a stripe on the body behind the ring if it belonged to another of these lasers.

    It would then be longer than any face, and farther away than under its own laser, within reach.
    """
    for row, laser in zip(tracks.tolist(), own, strict=True):
        nearest, farthest = _depths_m(row, laser, rig)
        for other in lasers if row[LASER] == UNLABELLED else ():
            low, high = _depths_m(row, other, rig)
            farther = other != laser and low > max(nearest, BODY_RANGE_M[0]) and high < BODY_RANGE_M[1]
            if farther and high > farthest and math.dist(*_points_m(row, other, rig)) > FACE_LENGTH_M[1]:
                return True
    return False


def _points_m(row: Sequence[float], laser: int, rig: Rig) -> list[tuple[float, float, float]]:
    """The ends of a track in the camera frame, if it belongs to that laser."""
    optics, (a, b, c) = lens(rig.camera), _plane_numbers(rig)[laser]
    points = []
    for x_px in (row[X_START], row[X_END]):
        x = (x_px - optics.cx) / optics.fx
        y = (row[MIDDLE_Y] + row[SLOPE] * (x_px - row[MIDDLE_X]) - optics.cy) / optics.fy
        depth = 1 / (a * x + b * y + c or math.nan)
        points.append((x * depth, y * depth, depth))
    return points


def _depths_m(row: Sequence[float], laser: int, rig: Rig) -> tuple[float, float]:
    """Depths of a track's nearer and farther end; one behind the camera has a negative one."""
    start, end = (depth for _, _, depth in _points_m(row, laser, rig))
    return min(start, end), max(start, end)


@lru_cache(maxsize=4)
def _plane_numbers(rig: Rig) -> list[list[float]]:
    numbers: list[list[float]] = planes_per_m(rig).tolist()
    return numbers


@lru_cache(maxsize=4)
def planes_per_m(rig: Rig) -> Float64[Array, "laser xyz=3"]:
    """The light planes as m / d: 1/z = (m / d) . (x, y, 1) on them."""
    planes: Float64[Array, "laser xyz=3"] = rig.lasers.normal / rig.lasers.distance_m[:, None]
    return planes


@lru_cache(maxsize=4)
def _rules(rig: Rig) -> FaceParams:
    unions = UnionParams(
        min_beyond_ends=MIN_SPILT,
        max_gap=MAX_GAP,
        separation_px=APART_PX,
        separation_sigmas=APART_SIGMAS,
        max_separation_px=MAX_DISTANCE_PX,
        rounds=ROUNDS,
        fit_dof=TAKEN_BY_THE_FIT,
        min_columns=MIN_SEGMENT_COLUMNS,
    )
    candidates = CandidateParams(
        min_depth_m=DEPTH_RANGE_M[0],
        max_depth_m=DEPTH_RANGE_M[1],
        min_length_m=FACE_LENGTH_M[0],
        max_length_m=FACE_LENGTH_M[1],
        typical_scatter_px=USUAL_SCATTER_PX,
        max_counted_columns=ENOUGH_COLUMNS,
        spill_penalty=SPILL_PENALTY,
        coincidence_penalty=COINCIDENCE_PENALTY,
        min_behind_m=BEHIND_M[0],
        max_behind_m=BEHIND_M[1],
        clipped_penalty=CLIPPED_PENALTY,
        union_penalty=UNION_PENALTY,
        most=CANDIDATES,
    )
    return FaceParams(unions, candidates, _ring_rules(rig.camera))


def _ring_rules(camera: Camera) -> RingParams:
    matrix = camera.camera_matrix
    rows = np.linspace(0.0, camera.image_height - 1.0, 9)
    inside = (CUT_OFF_PX, camera.image_width - 1 - CUT_OFF_PX)
    left, right = (undistorted_rays(np.stack([np.full(9, x), rows], axis=-1), camera)[:, 0] for x in inside)
    columns = np.linspace(0.0, camera.image_width - 1.0, 9)
    above = (CUT_OFF_ROWS_PX, camera.image_height - 1 - CUT_OFF_ROWS_PX)
    top, bottom = (undistorted_rays(np.stack([columns, np.full(9, y)], axis=-1), camera)[:, 1] for y in above)
    return RingParams(
        focal_x=matrix[0, 0],
        focal_y=matrix[1, 1],
        principal_x=matrix[0, 2],
        principal_y=matrix[1, 2],
        image_height=camera.image_height,
        border_px=BORDER_PX,
        along_sigma_px=ALONG_SIGMA_PX,
        across_sigma_px=ACROSS_SIGMA_PX,
        plane_limit=PLANE_LIMIT,
        circle_limit=CIRCLE_LIMIT,
        dropped_end_penalty=DROPPED_END_PENALTY,
        unseen_penalty=UNSEEN_PENALTY,
        max_tilt_rad=MAXIMUM_TILT_RAD,
        min_radius_m=MINIMUM_RADIUS_M,
        min_band_m=MINIMUM_BAND_M,
        left_x=float(left.max()),
        right_x=float(right.min()),
        top_y=float(top.max()),
        bottom_y=float(bottom.min()),
    )
