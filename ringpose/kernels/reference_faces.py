"""Readable NumPy twin of the kernel that looks for the ring's face among tracks: the oracle of its tests."""

import math

import numpy as np

from ringpose.kernels.faces import CandidateRules, FaceRules, Faces, RingRules, UnionRules
from ringpose.kernels.reference_groups import Pool, best_groups
from ringpose.kernels.ring import (
    CENTERS,
    CLIPPED,
    CORRELATION,
    LASER,
    MIDDLE_X,
    MIDDLE_Y,
    SCATTER,
    SLOPE,
    SPILT,
    TRACK_COLUMNS,
    X_END,
    X_START,
)
from ringpose.types.arrays import Array, Bool, Float64

Tracks = Float64[Array, "track column=11"]
Track = Float64[Array, "column=11"]


def ring_faces(tracks: Tracks, unlabelled: int, planes: Float64[Array, "laser xyz=3"], rules: FaceRules) -> Faces:
    """Twin of `ringpose.kernels.faces.ring_faces`."""
    unions = collinear_unions(tracks, rules.unions)
    every = np.concatenate([tracks, unions])
    return Faces(every, best_groups(_candidates(every, len(unions), unlabelled, planes, rules), rules.ring))


def collinear_unions(tracks: Tracks, rules: UnionRules) -> Float64[Array, "union column=11"]:
    """The unions of tracks that could be pieces of one stripe; none where nothing lies on the tracks' lines."""
    pieces = [track for track in tracks if track[SPILT] >= rules.least_spilt and not track[CLIPPED]]
    unions: list[Track] = []
    left = pieces
    for _ in range(int(rules.rounds)):
        left = [_union(first, second) for first in left for second in pieces if _meet(first, second, rules)]
        unions += left
    return np.array(unions).reshape(-1, len(TRACK_COLUMNS))


def _meet(first: Track, second: Track, rules: UnionRules) -> bool:
    """Whether the second track begins not far beyond the end of the first one, on its line."""
    gap, lengths = second[X_START] - first[X_END], _length(first) + _length(second)
    if first[LASER] != second[LASER] or not 0 < gap <= rules.longest_gap * lengths:
        return False
    middle = float(first[X_END] + gap / 2)
    apart = abs(_y(first, middle) - _y(second, middle))
    sigma = math.hypot(_sigma(first, middle, rules), _sigma(second, middle, rules))
    return bool(apart < min(rules.farthest_px, rules.apart_px + rules.apart_sigmas * sigma))


def _y(track: Track, x: float) -> float:
    return float(track[MIDDLE_Y] + track[SLOPE] * (x - track[MIDDLE_X]))


def _length(track: Track) -> float:
    return float(track[X_END] - track[X_START])


def _sigma(track: Track, x: float, rules: UnionRules) -> float:
    """Standard deviation of the line's ordinate."""
    columns = max(track[CENTERS] / track[CORRELATION] - rules.taken_by_fit, rules.least_columns)
    spread = max(_length(track), 1.0) / math.sqrt(12)
    return float(track[SCATTER] / math.sqrt(columns) * math.hypot(1.0, (x - track[MIDDLE_X]) / spread))


def _union(first: Track, second: Track) -> Track:
    """One track of both: the line and the scatter that all their centres together have."""
    parts = np.stack([first, second], axis=1)
    weight = parts[CENTERS] / parts[CENTERS].sum()
    middle_x, middle_y = weight @ parts[MIDDLE_X], weight @ parts[MIDDLE_Y]
    dx, dy = parts[MIDDLE_X] - middle_x, parts[MIDDLE_Y] - middle_y
    own = np.maximum(parts[X_END] - parts[X_START], 1.0) ** 2 / 12
    xx, xy = weight @ (own + dx**2), weight @ (own * parts[SLOPE] + dx * dy)
    yy = weight @ (own * parts[SLOPE] ** 2 + parts[SCATTER] ** 2 + dy**2)
    both = first.copy()
    both[CENTERS], both[X_END] = parts[CENTERS].sum(), second[X_END]
    both[[MIDDLE_X, MIDDLE_Y, SLOPE]] = middle_x, middle_y, xy / xx
    both[SCATTER] = math.sqrt(max(yy - xy**2 / xx, 0.0))
    both[CORRELATION] = parts[CORRELATION].max()
    both[SPILT] = np.maximum(parts[SPILT] - parts[CENTERS, ::-1], 0.0).sum()
    return both


def _candidates(
    tracks: Tracks, unions: int, unlabelled: int, planes: Float64[Array, "laser xyz=3"], rules: FaceRules
) -> Pool:
    """The tracks of greatest merit under every laser that they may belong to and that puts them at a possible place.

    So many tracks at the end are unions of others.
    """
    ends = _normalised_ends(tracks, rules.ring)
    lasers = np.arange(len(planes))
    allowed = np.where(tracks[:, LASER] < 0, unlabelled >> lasers[:, None] & 1, tracks[:, LASER] == lasers[:, None])
    laser, track = np.nonzero((allowed == 1) & _possible(ends, planes, rules.candidates))
    is_union = np.arange(len(tracks)) >= len(tracks) - unions
    merit = (_merits(tracks, rules.candidates) - rules.candidates.union_cost * is_union)[track]
    meets = _meet_another(ends, tracks[:, LASER] < 0, unlabelled, planes, rules.candidates)
    unlikely = np.maximum(_spilt_costs(tracks, rules.candidates) - rules.candidates.coincidence_cost, 0.0)
    forgiven = unlikely[track] * meets[laser, track]
    order = np.lexsort((-merit - forgiven, laser))
    rank = np.arange(len(order)) - np.searchsorted(laser, laser)
    kept = order[rank < rules.candidates.most]
    return Pool(track[kept], laser[kept], ends[track[kept]], merit[kept], forgiven[kept], planes)


def _normalised_ends(tracks: Tracks, rules: RingRules) -> Float64[Array, "track end=2 xy=2"]:
    """Normalised image coordinates of the tracks' ends."""
    x = tracks[:, [X_START, X_END]]
    y = tracks[:, [MIDDLE_Y]] + tracks[:, [SLOPE]] * (x - tracks[:, [MIDDLE_X]])
    principal, focal = (rules.principal_x, rules.principal_y), (rules.focal_x, rules.focal_y)
    ends: Float64[Array, "track end=2 xy=2"] = (np.stack([x, y], axis=-1) - principal) / focal
    return ends


def _possible(
    ends: Float64[Array, "track end=2 xy=2"], planes: Float64[Array, "laser xyz=3"], rules: CandidateRules
) -> Bool[Array, "laser track"]:
    """Whether stripes seen there lie at the depth of a ring and are as long as its face is wide."""
    rays = np.concatenate([ends, np.ones((len(ends), 2, 1))], axis=-1)
    inverse_depth = np.einsum("lk,tek->lte", planes, rays)
    at_depth = (inverse_depth > 1 / rules.farthest_m) & (inverse_depth < 1 / rules.nearest_m)
    points = rays / np.where(at_depth, inverse_depth, 1.0)[..., None]
    length = np.linalg.norm(points[:, :, 1] - points[:, :, 0], axis=-1)
    possible: Bool[Array, "laser track"] = (
        at_depth.all(axis=-1) & (length > rules.shortest_m) & (length < rules.longest_m)
    )
    return possible


def _meet_another(
    ends: Float64[Array, "track end=2 xy=2"],
    is_unlabelled: Bool[Array, "track"],
    unlabelled: int,
    planes: Float64[Array, "laser xyz=3"],
    rules: CandidateRules,
) -> Bool[Array, "laser track"]:
    """Whether what lies on a track's line may be another laser's stripe on the body behind the face."""
    rays = np.concatenate([ends, np.ones((len(ends), 2, 1))], axis=-1)
    inverse_depth = np.einsum("lk,tek->lte", planes, rays).mean(axis=-1)
    with np.errstate(divide="ignore"):
        depth = 1 / inverse_depth
    behind = depth[None] - depth[:, None]  # of the other laser's, for each laser, other and track
    others = ~np.eye(len(planes), dtype=bool) & (unlabelled >> np.arange(len(planes)) & 1 == 1)
    at_body = (behind > rules.behind_least_m) & (behind < rules.behind_most_m) & others[..., None]
    meets: Bool[Array, "laser track"] = at_body.any(axis=1) & is_unlabelled
    return meets


def _spilt_costs(tracks: Tracks, rules: CandidateRules) -> Float64[Array, "track"]:
    """What centres on the tracks' lines beyond them cost."""
    costs: Float64[Array, "track"] = rules.spill_cost * tracks[:, SPILT] / (tracks[:, SPILT] + tracks[:, CENTERS])
    return costs


def _merits(tracks: Tracks, rules: CandidateRules) -> Float64[Array, "track"]:
    """How much tracks look like a flat metal face: long for their scatter, and nothing on their line beyond."""
    straight = 2 * np.log(np.minimum(tracks[:, CENTERS], rules.enough_columns))
    rough = 0.5 * (tracks[:, SCATTER] / rules.usual_scatter_px) ** 2
    merits: Float64[Array, "track"] = (
        straight - rough - _spilt_costs(tracks, rules) - rules.clipped_cost * tracks[:, CLIPPED]
    )
    return merits
