"""Which tracks lie on the ring's face: one a laser, all on one plane, their ends on two circles about one centre.

This is also what labels the stripes of a frame with several lasers on: every assignment of tracks to lasers is
scored by how well one planar ring explains it, order swaps included.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float64, Int64

from ringpose.detect.tracks import Track
from ringpose.geometry.circles import concentric_arcs
from ringpose.geometry.rays import intersect, undistorted_rays
from ringpose.types.arrays import Array
from ringpose.types.rig import Rig
from ringpose.types.stripes import UNLABELLED

DEPTH_RANGE_M = (0.05, 3.0)
"""Where a ring can be: wider on both sides than the 0.2 to 1 m that the method is made for."""

BORDER_PX = 15
"""Closer to the image's upper or lower border a stripe may well be missed."""

MINIMUM_RADIUS_M = 0.1
"""The smallest adapter rings are three times larger."""

MINIMUM_BAND_M = 0.003
"""Narrower bands are edges, not faces."""

FACE_LENGTH_M = (0.003, 0.3)
"""Length of a stripe on the face: bands of adapter rings are 20 to 60 mm wide, crossed obliquely at worst."""

MAXIMUM_TILT_RAD = np.deg2rad(75)
"""Beyond this a face is too oblique to show a stripe of any length."""

CANDIDATES = 20
"""Longest and straightest tracks that are tried for each laser."""

ACROSS_SIGMA_PX = 0.4
"""How far a track may lie from the plane's: noise of the line and of the calibration."""

ALONG_SIGMA_PX = 2.0
"""How far a track's end may lie from its circle, before it is refined."""

DROPPED_END_COST = 6.0
"""What it costs (in squared sigmas over two) to call one of six ends occluded: once in four hundred by chance."""

PLANE_LIMIT = 8.0
"""Squared sigmas over two above which tracks do not lie on one plane, for each laser."""

CIRCLE_LIMIT = 6.0
"""Squared sigmas over two above which ends do not lie on two circles, for each laser."""

ON_LINE_PX = 2.5
"""Centres so close to a face's line are on its surface; the nearest body behind a ring jumps by 4 px at 1 m."""

SPILL_COST = 15.0
"""What it costs if all of a stripe's centres on a track's line lie beyond the track: a face ends with its track."""

UNSEEN_COST = 6.0
"""What it costs that a laser's stripe is not seen where the face would show it: occluded, or not this face."""

CONVINCING_SCORE = {3: 9.0, 2: 12.0, 1: 6.0}
"""Scores that tracks on foil hardly ever reach by chance, by number of tracks; two tracks are checked by little."""

CLIPPED_COST = 4.0
"""What it costs that a track leaves the image: there is no seeing whether it would have ended."""

ENOUGH_COLUMNS = 120
"""A longer track is no more likely to be a face: the body behind has the longest."""

TRACK_PRICE = 4.0
"""What another track must add to the score: a piece of foil that happens to lie in the plane adds less."""

CLEAR_MARGIN = 4.0
"""Two labellings whose scores differ by less are both possible."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidates:
    """Tracks with a laser each, and their ends in the camera frame under that assumption."""

    track: Int64[Array, "candidate"]
    laser: Int64[Array, "candidate"]
    rays: Float64[Array, "candidate end=2 xyz=3"]
    points: Float64[Array, "candidate end=2 xyz=3"]
    merit: Float64[Array, "candidate"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Face:
    """The tracks on the ring's face."""

    tracks: tuple[tuple[int, Track], ...]
    """Laser and its track."""
    score: float
    ambiguous: bool
    """Another labelling explains the same tracks about as well."""


def ring_face(
    tracks: Sequence[Track], centers: Float64[Array, "center xyl=3"], lasers: Sequence[int], rig: Rig
) -> Face | None:
    """The most convincing face, from as many lasers as agree on one; None if no track will do.

    `centers` are all stripe centres: x, y in undistorted pixels, and their laser or `UNLABELLED`;
    `lasers` are those that an unlabelled track may belong to.
    """
    candidates = face_candidates(tracks, centers, lasers, rig)
    faces = []
    for size, convincing in CONVINCING_SCORE.items():
        groups, score = _scored_groups(candidates, size, rig)
        if len(score) and score.max() > convincing:
            best = int(np.argmax(score))
            face = Face(
                tracks=tuple((int(candidates.laser[each]), tracks[candidates.track[each]]) for each in groups[best]),
                score=float(score[best]),
                ambiguous=_ambiguous(candidates, groups, score, best),
            )
            faces.append((face.score - TRACK_PRICE * size, face))
    return max(faces, key=lambda each: each[0])[1] if faces else None


def face_candidates(
    tracks: Sequence[Track], centers: Float64[Array, "center xyl=3"], lasers: Sequence[int], rig: Rig
) -> Candidates:
    """Every track under every laser that it may belong to, where that puts it at a possible depth."""
    pairs = [
        (number, laser)
        for number, track in enumerate(tracks)
        for laser in (lasers if track.laser == UNLABELLED else [track.laser])
    ]
    track = np.array([number for number, _ in pairs], dtype=np.int64)
    laser = np.array([laser for _, laser in pairs], dtype=np.int64)
    ends = np.array([[[t.x_start, t.y(t.x_start)], [t.x_end, t.y(t.x_end)]] for t in tracks]).reshape(-1, 2, 2)
    rays = undistorted_rays(ends[track], rig.camera)
    points = intersect(rays, rig.lasers.normal[laser][:, None], rig.lasers.distance_m[laser][:, None])
    merit = np.array([_merit(each, centers) for each in tracks])[track] if len(track) else np.zeros(0)

    with np.errstate(invalid="ignore"):
        possible = np.all((points[..., 2] > DEPTH_RANGE_M[0]) & (points[..., 2] < DEPTH_RANGE_M[1]), axis=-1)
        length_m = np.linalg.norm(points[:, 1] - points[:, 0], axis=-1)
        possible &= (length_m > FACE_LENGTH_M[0]) & (length_m < FACE_LENGTH_M[1])
    kept = np.zeros(len(track), dtype=bool)
    for each in range(len(rig.lasers.names)):
        of_laser = np.flatnonzero(possible & (laser == each))
        kept[of_laser[np.argsort(-merit[of_laser], kind="stable")[:CANDIDATES]]] = True
    return Candidates(track=track[kept], laser=laser[kept], rays=rays[kept], points=points[kept], merit=merit[kept])


def _merit(track: Track, centers: Float64[Array, "center xyl=3"]) -> float:
    """How much a track looks like a flat metal face: long for its scatter, and nothing on its line beyond its ends."""
    x, y = centers[(centers[:, 2] == track.laser) | (track.laser == UNLABELLED), :2].T
    on_line = np.abs(y - track.middle_y - track.slope * (x - track.middle_x)) < ON_LINE_PX
    near = np.abs(x - track.middle_x) < 1.5 * track.length + 40
    outside = (x < track.x_start - 2) | (x > track.x_end + 2)
    spilt = np.count_nonzero(on_line & near & outside)
    share = spilt / (spilt + len(track.centers))
    straight = 2 * np.log(min(len(track.centers), ENOUGH_COLUMNS)) - 0.5 * (track.scatter / 0.3) ** 2
    return float(straight - SPILL_COST * share - CLIPPED_COST * track.clipped)


def _scored_groups(
    candidates: Candidates, size: int, rig: Rig
) -> tuple[Int64[Array, "group size"], Float64[Array, "group"]]:
    """Groups of candidates of different lasers that one planar ring explains, with their scores."""
    groups = _groups(candidates, size)
    if not len(groups):
        return groups, np.zeros(0)
    cost, tilt, unseen = _plane_cost(candidates, groups, rig)
    possible = (cost < PLANE_LIMIT * size) & (tilt < MAXIMUM_TILT_RAD)
    groups, cost, tilt = groups[possible], cost[possible] + UNSEEN_COST * unseen[possible], tilt[possible]
    if size > 1 and len(groups):
        circle = _circle_cost(candidates.points[groups], rig.camera.camera_matrix[0, 0])
        possible = circle < CIRCLE_LIMIT * size
        groups, cost, tilt = groups[possible], cost[possible] + circle[possible], tilt[possible]
    return groups, candidates.merit[groups].sum(axis=-1) - cost - 0.5 * (tilt / 0.5) ** 2


def _groups(candidates: Candidates, size: int) -> Int64[Array, "group size"]:
    """All choices of candidates of different lasers and different tracks."""
    chosen = []
    for lasers in combinations(np.unique(candidates.laser), size):
        of_laser = [np.flatnonzero(candidates.laser == laser) for laser in lasers]
        chosen.append(np.stack(np.meshgrid(*of_laser, indexing="ij"), axis=-1).reshape(-1, size))
    groups = np.concatenate(chosen) if chosen else np.empty((0, size), dtype=np.int64)
    track = np.sort(candidates.track[groups], axis=-1)
    different: Int64[Array, "group size"] = groups[np.all(np.diff(track, axis=-1) > 0, axis=-1)]
    return different


def _plane_cost(
    candidates: Candidates, groups: Int64[Array, "group size"], rig: Rig
) -> tuple[Float64[Array, "group"], Float64[Array, "group"], Int64[Array, "group"]]:
    """How well one plane explains each group.

    Squared sigmas over two of the tracks' ends from the lines in which that plane meets the light planes, its
    tilt, and the number of other lasers whose stripe the image would show but that are not in the group.
    """
    points = candidates.points[groups].reshape(len(groups), -1, 3)
    normal, distance = _planes(points)
    rays = candidates.rays[groups]
    across = rays[..., 1] - _ordinate(normal[:, None], distance[:, None], candidates.laser[groups], rays[..., 0], rig)
    cost = 0.5 * np.sum((across * rig.camera.camera_matrix[1, 1] / ACROSS_SIGMA_PX) ** 2, axis=(1, 2))
    if groups.shape[1] == 1:
        cost = np.zeros(len(groups))  # one line lies in many planes

    every = np.broadcast_to(np.arange(len(rig.lasers.names)), (len(groups), len(rig.lasers.names)))
    middle_x = np.broadcast_to(rays[..., 0].mean(axis=(1, 2))[:, None, None], (*every.shape, 1))
    row = _ordinate(normal[:, None], distance[:, None], every, middle_x, rig)[..., 0] * rig.camera.camera_matrix[1, 1]
    row += rig.camera.camera_matrix[1, 2]
    with np.errstate(invalid="ignore"):
        shown = (row > BORDER_PX) & (row < rig.camera.image_height - BORDER_PX)
    in_group = np.any(candidates.laser[groups][:, None] == every[..., None], axis=-1)
    unseen = np.count_nonzero(shown & ~in_group, axis=-1)
    return np.where(np.isfinite(cost), cost, np.inf), np.arccos(np.clip(np.abs(normal[:, 2]), 0, 1)), unseen


def _planes(points: Float64[Array, "group n xyz=3"]) -> tuple[Float64[Array, "group 3"], Float64[Array, "group"]]:
    """Planes nearest to the points; for the two ends of a single track one facing the camera."""
    middle = points.mean(axis=1, keepdims=True)
    if points.shape[1] == 2:
        normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(points), 3))
    else:
        normal = np.linalg.svd(points - middle, full_matrices=False)[2][:, -1]
    return normal, np.sum(normal * middle[:, 0], axis=-1)


def _ordinate(
    normal: Float64[Array, "group 1 3"],
    distance: Float64[Array, "group 1"],
    laser: Int64[Array, "group laser"],
    x: Float64[Array, "group laser end"],
    rig: Rig,
) -> Float64[Array, "group laser end"]:
    """Normalised y, at normalised x, of the line in which a plane n . P = d meets a light plane m . P = e.

    There both give the same point t r of a ray r, so (e n - d m) . r = 0.
    """
    line = rig.lasers.distance_m[laser][..., None] * normal - distance[..., None] * rig.lasers.normal[laser]
    with np.errstate(divide="ignore", invalid="ignore"):
        ordinate: Float64[Array, "group laser end"] = (
            -(line[..., None, 0] * x + line[..., None, 2]) / line[..., None, 1]
        )
    return ordinate


def _circle_cost(points: Float64[Array, "group laser end=2 xyz=3"], focal_px: float) -> Float64[Array, "group"]:
    """Squared sigmas over two of the ends from two circles about one centre; one end of six may be occluded."""
    ends = points.shape[1] * 2
    everything = _concentric_cost(points, np.ones(ends, dtype=bool), focal_px)
    if ends < 6:
        return everything
    dropped = [_concentric_cost(points, np.arange(ends) != each, focal_px) for each in range(ends)]
    cost: Float64[Array, "group"] = np.minimum(everything, np.min(dropped, axis=0) + DROPPED_END_COST)
    return cost


def _concentric_cost(
    points: Float64[Array, "group laser end=2 xyz=3"], used: Array, focal_px: float
) -> Float64[Array, "group"]:
    """The same for a given choice of the ends; infinite for rings that nobody builds."""
    lasers = points.shape[1]
    flat, depth_m = _along_and_across(points)
    arcs = concentric_arcs(flat[:, used], np.tile([0, 1], lasers)[used])
    cost = 0.5 * np.sum((arcs.outside / depth_m[:, None] * focal_px / ALONG_SIGMA_PX) ** 2, axis=-1)
    buildable = (np.abs(arcs.curvature) < 1 / MINIMUM_RADIUS_M) | (lasers > 2)  # noise bends arcs of close lasers
    return np.where(buildable & (arcs.band > MINIMUM_BAND_M), cost, np.inf)


def _along_and_across(
    points: Float64[Array, "group laser end=2 xyz=3"],
) -> tuple[Float64[Array, "group n 2"], Float64[Array, "group"]]:
    """The ends in their plane, x along the stripes from start to end, and their mean depth."""
    middle = points.mean(axis=(1, 2))
    centred = (points - middle[:, None, None]).reshape(len(points), -1, 3)
    normal = np.linalg.svd(centred, full_matrices=False)[2][:, 2]
    along = (points[:, :, 1] - points[:, :, 0]).mean(axis=1)
    along -= np.sum(along * normal, axis=-1, keepdims=True) * normal
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    axes = np.stack([along, np.cross(normal, along)], axis=-1)
    flat: Float64[Array, "group n 2"] = centred @ axes
    return flat, middle[:, 2]


def _ambiguous(
    candidates: Candidates, groups: Int64[Array, "group size"], score: Float64[Array, "group"], best: int
) -> bool:
    """Whether the same tracks under other lasers explain nearly as much as the best group."""
    tracks = np.sort(candidates.track[groups], axis=-1)
    same_tracks = np.all(tracks == tracks[best], axis=-1)
    rivals = score[same_tracks & (np.arange(len(groups)) != best)]
    return bool(len(rivals) and rivals.max() > score[best] - CLEAR_MARGIN)
