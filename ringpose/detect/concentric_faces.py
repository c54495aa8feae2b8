"""Two faces at one height about one axis: the shot leaves open which of them is the ring's.

A stripe crosses them in pieces on one line. A groove in a face, a bolt or a cable also leaves pieces on one line, but
what is seen between them is nearer than the plane, or no deeper than the gap is wide; and the gaps of two stripes are
at one distance from the axis only if their ends are on circles about it.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ringpose.detect.rim import Face, SegmentPlane, is_of_laser, plane_of, segment_ends_m
from ringpose.detect.stripes import lens, line_y_px
from ringpose.kernels.lines import LASER, X_END, X_START
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import JudgedRing
from ringpose.types.rig import Rig

SAME_EDGE_PX = 6.0
"""Largest difference of the ends of two stripes' gaps from one circle: three standard deviations of ends before they
are measured (`RingParams.along_sigma_px`)."""

SAME_LINE_PX = 1.0
"""Largest distance of a piece of another face from the selected stripe's line."""


def several_faces(
    face: Face,
    segments: Float64[Array, "segment column=12"],
    lasers: Sequence[int],
    ring: JudgedRing | None,
    rig: Rig,
) -> bool:
    """Whether the stripes show another face beside the selected one, or a gap in it, with edges about the same axis.

    Two stripes show the gap at the same distances, or one of which the others are farther from the axis. `lasers` are
    those that an unlabelled segment may belong to. Without a ring the edges count as straight.
    """
    pieces = [_pieces(segments, selected) for selected in face.segments] if len(face.lasers) > 1 else []
    if max(map(len, pieces), default=0) <= 1:
        return False
    plane = plane_of(face.segments, face.lasers, rig)
    tolerance_m = SAME_EDGE_PX * float(plane.origin_m[2]) / lens(rig.camera).fx
    gaps = {}
    for laser, of_laser in zip(face.lasers, pieces, strict=True):
        own = segments[is_of_laser(segments, laser, lasers)]
        gaps[laser] = _gaps_m(own, of_laser, laser, plane, ring, rig)
    reached_m = [_nearest_to_axis_m(ends_m, ring) for ends_m in plane.ends_m]
    for laser, gap_m in ((laser, gap_m) for laser, of_laser in gaps.items() for gap_m in of_laser):
        if float(np.ptp(gap_m)) < tolerance_m:
            continue
        shown = [any(float(np.abs(other - gap_m).max()) < tolerance_m for other in gaps[each]) for each in face.lasers]
        beside = [
            each != laser and near_m > float(gap_m.min()) for each, near_m in zip(face.lasers, reached_m, strict=True)
        ]
        if sum(shown) > 1 or sum(shown) + sum(beside) == len(shown):
            return True
    return False


def _pieces(
    segments: Float64[Array, "segment column=12"], selected: Float64[Array, "column=12"]
) -> Float64[Array, "piece column=12"]:
    """The segments of a stripe's laser on its line that are part of it or its neighbours, from left to right."""
    of_laser = segments[segments[:, LASER] == selected[LASER]]
    ends_px = of_laser[:, [X_START, X_END]].T
    apart_px = np.abs(line_y_px(of_laser, ends_px) - line_y_px(selected, ends_px)).max(axis=0)
    rows = of_laser[apart_px < SAME_LINE_PX]
    rows = rows[rows[:, X_START].argsort()]
    first = int(np.count_nonzero(rows[:, X_END] < selected[X_START]))
    end = len(rows) - int(np.count_nonzero(rows[:, X_START] > selected[X_END]))
    return rows[max(first - 1, 0) : end + 1]


def _gaps_m(
    own: Float64[Array, "segment column=12"],
    pieces: Float64[Array, "piece column=12"],
    laser: int,
    plane: SegmentPlane,
    ring: JudgedRing | None,
    rig: Rig,
) -> list[Float64[Array, "2"]]:
    """Distances from the axis of the ends beside each deep gap between pieces of a stripe on the plane."""
    others, gaps = own[~(own[:, None] == pieces).all(axis=2).any(axis=1)], []
    for left, right in pairwise(pieces):
        edges_m = _edges_m(np.stack([left, right]), laser, plane, ring, rig)
        if edges_m is not None and _is_deep(others, left[X_END], right[X_START], laser, plane, rig, edges_m):
            gaps.append(edges_m)
    return gaps


def _nearest_to_axis_m(ends_m: Float64[Array, "end=2 xyz=3"], ring: JudgedRing | None) -> float:
    """Least distance of a stripe's line from the axis; 0 if that is not known."""
    if ring is None or ring.curvature_per_m <= 0.0:
        return 0.0
    along = (ends_m[1] - ends_m[0]) / np.linalg.norm(ends_m[1] - ends_m[0])
    from_axis_m = ends_m[0] - ring.origin_m - ring.axes[0] / ring.curvature_per_m
    return float(np.linalg.norm(from_axis_m - (from_axis_m @ along) * along))


def _edges_m(
    pieces: Float64[Array, "2 column=12"],
    laser: int,
    plane: SegmentPlane,
    ring: JudgedRing | None,
    rig: Rig,
) -> Float64[Array, "2"] | None:
    """Distances from the axis of the ends beside the gap between two pieces; None if the axis lies between them."""
    (start_m, left_m), (right_m, end_m) = segment_ends_m(pieces, [laser, laser], rig)
    if ring is None or ring.curvature_per_m <= 0.0:
        along = (plane.ends_m[:, 1] - plane.ends_m[:, 0]).mean(axis=0)
        edges_m: Float64[Array, "2"] = np.stack([left_m, right_m]) @ (along / np.linalg.norm(along))
        return edges_m
    center_m = ring.origin_m + ring.axes[0] / ring.curvature_per_m
    if (left_m - center_m) @ (end_m - start_m) < 0.0 < (right_m - center_m) @ (end_m - start_m):
        return None
    distances_m: Float64[Array, "2"] = np.linalg.norm(np.stack([left_m, right_m]) - center_m, axis=1)
    return distances_m


def _is_deep(
    others: Float64[Array, "segment column=12"],
    left_px: float,
    right_px: float,
    laser: int,
    plane: SegmentPlane,
    rig: Rig,
    edges_m: Float64[Array, "2"],
) -> bool:
    """Whether what is seen in a gap, if anything, is behind the plane, and deeper somewhere than the gap is wide."""
    inside = others[(others[:, X_START] < right_px) & (others[:, X_END] > left_px)].copy()
    if not len(inside):
        return True
    inside[:, X_START] = np.maximum(inside[:, X_START], left_px)
    inside[:, X_END] = np.minimum(inside[:, X_END], right_px)
    depth_m = -(segment_ends_m(inside, [laser] * len(inside), rig) - plane.origin_m) @ plane.normal
    return bool(depth_m.mean(axis=1).min() > 0.0 and depth_m.max() > np.ptp(edges_m))
