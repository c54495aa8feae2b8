"""Which tracks lie on the ring's face: one a laser, all on one plane, their ends on two circles about one centre.

This is also what labels the stripes of a frame with several lasers on: every assignment of tracks to lasers is
scored by how well one planar ring explains it, order swaps included.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ringpose.detect.collinear import collinear_tracks
from ringpose.detect.tracks import Track, lens
from ringpose.geometry.rays import undistorted_rays
from ringpose.kernels.ring import Group, RingRules, best_groups
from ringpose.types.arrays import Array, Bool, Float64, Int32
from ringpose.types.camera import Camera
from ringpose.types.rig import Rig
from ringpose.types.stripes import UNLABELLED

DEPTH_RANGE_M = (0.05, 3.0)
"""Where a ring can be: wider on both sides than the 0.2 to 1 m that the method is made for."""

FACE_LENGTH_M = (0.003, 0.1)
"""Length of a stripe on the face: bands of adapter rings are 20 to 60 mm wide and crossed at 45 degrees or more."""

MAXIMUM_TILT_RAD = float(np.deg2rad(75))
"""Beyond this a face is too oblique to show a stripe of any length."""

MINIMUM_RADIUS_M = 0.1
"""The smallest adapter rings are three times larger."""

MINIMUM_BAND_M = 0.003
"""Narrower bands are edges, not faces."""

BORDER_PX = 15.0
"""Closer to the image's upper or lower border a stripe may well be missed."""

CUT_OFF_PX = 6.0
"""An end so close to the left or right border is where the image ends, not the face."""

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

DROPPED_END_COST = 6.0
"""What it costs (in squared sigmas over two) to call one of six ends occluded: once in four hundred by chance."""

UNSEEN_COST = 6.0
"""What it costs that a laser's stripe is not seen where the face would show it: occluded, or not this face."""

SPILL_COST = 15.0
"""What it costs if all of a stripe's centres on a track's line lie beyond the track: a face ends with its track."""

UNION_COST = 3.0
"""What it costs that a track is put together: the body's stripes, broken by shadows and glints, gain by it as well."""

CLIPPED_COST = 4.0
"""What it costs that a track leaves the image: there is no seeing whether it would have ended."""

ENOUGH_COLUMNS = 120
"""A longer track is no more likely to be a face: the body behind has the longest."""

CONVINCING_SCORE = {3: 9.0, 2: 12.0, 1: 6.0}
"""Scores that tracks on foil hardly ever reach by chance, by number of tracks; two tracks are checked by little."""

TRACK_PRICE = 3.0
"""What another track must add to the score: a piece of foil that happens to lie in the plane adds less."""

CLEAR_MARGIN = {3: 4.0, 2: 4.0, 1: math.inf}
"""Two labellings whose scores differ by less are both possible, by number of tracks; nothing checks that of a single
one: where stripes cross, what seems to be unseen is not, so that any other possible label is one too many."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Face:
    """The tracks on the ring's face."""

    tracks: tuple[tuple[int, Track], ...]
    """Laser and its track."""
    score: float
    ambiguous: bool
    """Another labelling explains the same tracks about as well."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidates:
    """Tracks with a laser each, sorted by laser."""

    track: Int32[Array, "candidate"]
    laser: Int32[Array, "candidate"]
    ends: Float64[Array, "candidate end=2 xy=2"]
    """Normalised image coordinates."""
    merit: Float64[Array, "candidate"]


def ring_face(tracks: Sequence[Track], lasers: Sequence[int], rig: Rig) -> Face | None:
    """The most convincing face, from as many lasers as agree on one; None if no track will do.

    `lasers` are those that an unlabelled track may belong to.
    """
    if not tracks:
        return None
    unions = collinear_tracks(tracks)
    tracks = [*tracks, *unions]
    candidates = face_candidates(tracks, lasers, rig, unions=len(unions))
    groups = best_groups(
        candidates.track, candidates.laser, candidates.ends, candidates.merit, _planes(rig), _rules(rig)
    )
    best = _most_convincing(groups)
    if best is None:
        return None
    return Face(
        tracks=tuple((int(candidates.laser[each]), tracks[candidates.track[each]]) for each in best.candidates),
        score=best.score,
        ambiguous=best.rival > best.score - CLEAR_MARGIN[len(best.candidates)],
    )


def _most_convincing(groups: tuple[Group, Group, Group]) -> Group | None:
    """The largest group, unless a smaller one says more; None if none convinces.

    Nothing confirms a single track. Two are confirmed by one plane, and three by one plane and two circles, which
    is hardly ever so by chance: what three have less in score than other two may be the price of a broken track.
    """
    one, two, three = (group if group.score > CONVINCING_SCORE[len(group.candidates)] else None for group in groups)
    if two is None or three is None:
        return three or two or one
    price = TRACK_PRICE if set(two.candidates) < set(three.candidates) else -TRACK_PRICE
    return three if three.score > two.score + price else two


def face_candidates(tracks: Sequence[Track], lasers: Sequence[int], rig: Rig, unions: int = 0) -> Candidates:
    """The tracks of greatest merit under every laser that they may belong to and that puts them at a possible place.

    So many tracks at the end are unions of others.
    """
    rays = _rays_of_ends(tracks, rig.camera)
    laser, track = np.nonzero(_allowed(tracks, lasers, rig) & _possible(rays, _planes(rig)))
    joined = len(tracks) - unions
    merits = {number: _merit(tracks[number]) - UNION_COST * (number >= joined) for number in set(track.tolist())}
    merit = np.array([merits[number] for number in track.tolist()], dtype=np.float64)
    order = np.lexsort((-merit, laser))
    rank = np.arange(len(order)) - np.searchsorted(laser, laser)
    kept = order[rank < CANDIDATES]
    return Candidates(
        track=track[kept].astype(np.int32),
        laser=laser[kept].astype(np.int32),
        ends=rays[track[kept], :, :2],
        merit=merit[kept],
    )


def _rays_of_ends(tracks: Sequence[Track], camera: Camera) -> Float64[Array, "track end=2 xyz=3"]:
    """Rays (x, y, 1) through the ends of tracks."""
    optics = lens(camera)
    ends_px = [((t.x_start, t.y(t.x_start), 0.0), (t.x_end, t.y(t.x_end), 0.0)) for t in tracks]
    rays: Float64[Array, "track end=2 xyz=3"] = np.array(ends_px) - (optics.cx, optics.cy, -1.0)
    rays /= (optics.fx, optics.fy, 1.0)
    return rays


def _allowed(tracks: Sequence[Track], lasers: Sequence[int], rig: Rig) -> Bool[Array, "laser track"]:
    """Which laser a track may belong to: its own, or one of those of unlabelled tracks."""
    every = range(len(rig.lasers.names))
    unlabelled = [laser in lasers for laser in every]
    return np.array(
        [unlabelled if track.laser == UNLABELLED else [laser == track.laser for laser in every] for track in tracks]
    ).T


def _possible(
    rays: Float64[Array, "track end=2 xyz=3"], planes: Float64[Array, "laser xyz=3"]
) -> Bool[Array, "laser track"]:
    """Whether stripes seen along these rays lie at the depth of a ring and are as long as its face is wide."""
    inverse_depth = planes @ rays.reshape(-1, 3).T
    at_depth = (inverse_depth > 1 / DEPTH_RANGE_M[1]) & (inverse_depth < 1 / DEPTH_RANGE_M[0])
    inside = at_depth[:, ::2] & at_depth[:, 1::2]
    depth = 1 / np.where(at_depth, inverse_depth, 1.0)
    along = rays[:, 1] * depth[:, 1::2, None] - rays[:, 0] * depth[:, ::2, None]
    squared_length = np.einsum("ltk,ltk->lt", along, along)
    shortest, longest = FACE_LENGTH_M
    possible: Bool[Array, "laser track"] = inside & (squared_length > shortest**2) & (squared_length < longest**2)
    return possible


def _merit(track: Track) -> float:
    """How much a track looks like a flat metal face: long for its scatter, and nothing on its line beyond its ends."""
    share = track.spilt / (track.spilt + track.count)
    straight = 2 * math.log(min(track.count, ENOUGH_COLUMNS)) - 0.5 * (track.scatter / 0.3) ** 2
    return straight - SPILL_COST * share - CLIPPED_COST * track.clipped


@lru_cache(maxsize=4)
def _planes(rig: Rig) -> Float64[Array, "laser xyz=3"]:
    """The light planes as m / d: 1/z = (m / d) . (x, y, 1) on them."""
    planes: Float64[Array, "laser xyz=3"] = rig.lasers.normal / rig.lasers.distance_m[:, None]
    return planes


@lru_cache(maxsize=4)
def _rules(rig: Rig) -> RingRules:
    matrix = rig.camera.camera_matrix
    rows = np.linspace(0.0, rig.camera.image_height - 1.0, 9)
    inside = (CUT_OFF_PX, rig.camera.image_width - 1 - CUT_OFF_PX)
    left, right = (undistorted_rays(np.stack([np.full(9, x), rows], axis=-1), rig.camera)[:, 0] for x in inside)
    return RingRules(
        focal_x=matrix[0, 0],
        focal_y=matrix[1, 1],
        principal_y=matrix[1, 2],
        image_height=rig.camera.image_height,
        border_px=BORDER_PX,
        along_sigma_px=ALONG_SIGMA_PX,
        across_sigma_px=ACROSS_SIGMA_PX,
        plane_limit=PLANE_LIMIT,
        circle_limit=CIRCLE_LIMIT,
        dropped_end_cost=DROPPED_END_COST,
        unseen_cost=UNSEEN_COST,
        maximum_tilt_rad=MAXIMUM_TILT_RAD,
        minimum_radius_m=MINIMUM_RADIUS_M,
        minimum_band_m=MINIMUM_BAND_M,
        left_x=float(left.max()),
        right_x=float(right.min()),
    )
