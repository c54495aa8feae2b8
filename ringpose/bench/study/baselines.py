"""Baselines: older and simpler methods of pose estimation, on the same detections as the others.

Each returns a pose in the camera frame without a covariance, or the reason why it has none. They are given what favours
them: break points and edge points that the detector has already found and separated from the background.
"""

from collections.abc import Callable, Mapping
from math import inf, nan

import cv2
import numpy as np

from ringpose.geometry.rays import intersect, nearest_plane, rays, towards_camera, undistorted_pixels
from ringpose.geometry.rotations import tilt_basis, tilted
from ringpose.pose.closed_form import constrained_form, mean_radii, triangulated, why_undetermined
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.detection import BreakPoints, Detection, RingEdgePoints
from ringpose.types.pose import KnownRadii, NoPose, RingPose
from ringpose.types.rig import Rig
from ringpose.types.study import StudyMethod

MIN_ELLIPSE_POINTS = 20
"""Minimum number of visible points of the outer edge for an ellipse; `cv2.fitEllipse` needs five."""

PARALLEL_BELOW = 1e-9
"""Sine of the angle between two chords below which their bisectors count as parallel."""

TINY_M = 1e-12

MAX_RADIUS_M = 100.0
"""A larger ring is a fit that diverged."""

Baseline = Callable[[Detection, Rig, KnownRadii], RingPose | NoPose | str]


def bisectors_pose(detection: Detection, rig: Rig, radii: KnownRadii) -> RingPose | NoPose | str:
    """Centre where the perpendicular bisectors of an edge's two chords intersect; mean of both edges.

    This is the method of double-line and earlier structured-light systems (method(7), section 4): with chords that are
    nearly parallel the intersection is far away. The radii are not used.
    """
    points = _points_in_space(detection, rig)
    if not isinstance(points, tuple):
        return points
    points_m, edges = points
    normal, distance_m = _facing_plane(points_m)
    basis = tilt_basis(normal)
    centers = []
    for edge in (0, 1):
        on_edge = (points_m @ basis.T)[edges == edge]
        if len(on_edge) < 3:
            continue
        chords = on_edge[1:3] - on_edge[:2]
        lengths = np.linalg.norm(chords, axis=1)
        if abs(chords[0, 0] * chords[1, 1] - chords[0, 1] * chords[1, 0]) < PARALLEL_BELOW * lengths.prod():
            continue
        middles = 0.5 * (on_edge[1:3] + on_edge[:2])
        centers.append(np.linalg.solve(chords, (chords * middles).sum(axis=1)))
    if not centers:
        return "the chords' bisectors are parallel"
    center_m = np.mean(centers, axis=0) @ basis + distance_m * normal
    radius_m = mean_radii(points_m[None], edges, center_m[None])[0]
    return _pose(StudyMethod.BISECTORS, center_m, normal, radius_m, points_m)


def points_pose(detection: Detection, rig: Rig, radii: KnownRadii) -> RingPose | NoPose | str:
    """Plane by total least squares, then two concentric circles by least squares of the radial distances, unweighted.

    Starts from `paper-constrained`. The radii are not used.
    """
    points = _points_in_space(detection, rig)
    if not isinstance(points, tuple):
        return points
    points_m, edges = points
    if len(points_m) < 5 or len(set(edges.tolist())) < 2:
        return NoPose.TOO_FEW_BREAK_POINTS
    normal, distance_m = _facing_plane(points_m)
    basis = tilt_basis(normal)
    in_plane = points_m @ basis.T
    start = constrained_form(points_m[None], edges)
    which = np.eye(2)[edges]

    def residuals(x: Float64[Array, "4"]) -> Float64[Array, "point"]:
        distance: Float64[Array, "point"] = np.linalg.norm(in_plane - x[:2], axis=1) - which @ x[2:]
        return distance

    from scipy.optimize import least_squares

    solved = least_squares(residuals, np.concatenate([basis @ start.center_m[0], start.radius_m[0]]))
    if not solved.success or float(np.abs(solved.x).max()) > MAX_RADIUS_M:
        return "the least-squares fit of the circles diverges"
    center_m = solved.x[:2] @ basis + distance_m * normal
    return _pose(StudyMethod.POINTS, center_m, normal, solved.x[2:], points_m)


def ellipse_pose(detection: Detection, rig: Rig, radii: KnownRadii) -> RingPose | NoPose | str:
    """Pose of the circle of known radius whose image is the ellipse fitted to the visible outer edge.

    An ellipse allows two poses. The one whose inner circle fits the visible inner edge better is taken, or, without a
    visible inner edge, the one that faces the camera more.
    """
    edges = _visible_edges(detection)
    if edges is None:
        return "fewer than 20 points of the outer edge are visible"
    conic = fitted_conic(undistorted_pixels(edges.position_px[edges.edge == 1], rig.camera), rig)
    poses = [] if conic is None else circle_poses(conic, float(radii.radius_m[1]))
    if not poses:
        return "the ellipse through the visible edge is degenerate"
    directions = rays(edges.position_px, rig.camera)
    inner = edges.edge == 0

    def criterion(pose: tuple[Float64[Array, "3"], Float64[Array, "3"]]) -> float:
        if not inner.any():
            return float(pose[1][2])
        off_m = _radial_distances_m(*pose, directions[inner], edges.edge[inner], radii)
        return float(np.abs(off_m).mean()) if np.isfinite(off_m).all() else inf

    center_m, normal = min(poses, key=criterion)
    return _edge_pose(StudyMethod.ELLIPSE, center_m, normal, directions, radii)


def ellipse_refined_pose(detection: Detection, rig: Rig, radii: KnownRadii) -> RingPose | NoPose | str:
    """The ellipse's pose, refined by least squares of the distances of all visible points from both edges."""
    start = ellipse_pose(detection, rig, radii)
    edges = _visible_edges(detection)
    if not isinstance(start, RingPose) or edges is None:
        return start
    directions = rays(edges.position_px, rig.camera)
    axis_m = intersect(np.array([[0.0, 0.0, 1.0]]), start.normal, np.asarray(start.normal @ start.center_m))[0]
    outward = np.nan_to_num(start.center_m - axis_m)  # from the point of the ring's plane on the optical axis
    nearest_m = start.center_m - start.radius_outer_m * outward / max(float(np.linalg.norm(outward)), TINY_M)
    px_per_m = float(rig.camera.camera_matrix[0, 0] / np.linalg.norm(nearest_m))

    def residuals(x: Float64[Array, "5"]) -> Float64[Array, "point"]:
        normal = tilted(start.normal, x[3:])
        off_m = _radial_distances_m(start.center_m + x[:3], normal, directions, edges.edge, radii)
        return np.nan_to_num(off_m * px_per_m, nan=1e3)

    from scipy.optimize import least_squares

    solved = least_squares(residuals, np.zeros(5), x_scale=0.01)
    if not solved.success:
        return "the refinement of the ellipse diverges"
    center_m, normal = start.center_m + solved.x[:3], tilted(start.normal, solved.x[3:])
    if not center_m[2] > 0:
        return "the refinement of the ellipse ends behind the camera"
    return _edge_pose(StudyMethod.ELLIPSE_REFINED, center_m, normal, directions, radii)


BASELINES: Mapping[StudyMethod, Baseline] = {
    StudyMethod.BISECTORS: bisectors_pose,
    StudyMethod.POINTS: points_pose,
    StudyMethod.ELLIPSE: ellipse_pose,
    StudyMethod.ELLIPSE_REFINED: ellipse_refined_pose,
}


def fitted_conic(position_px: Float64[Array, "point xy=2"], rig: Rig) -> Float64[Array, "3 3"] | None:
    """Conic x^T Q x = 0 in normalised coordinates of the ellipse fitted to undistorted pixels; None if degenerate."""
    origin_px = position_px.mean(axis=0)  # fitEllipse computes with single precision
    (x, y), axes_px, angle_deg = cv2.fitEllipse((position_px - origin_px).astype(np.float32))
    half = 0.5 * np.array(axes_px)
    if not bool(np.isfinite([x, y, *half]).all()) or not bool((half > 0).all()):
        return None
    turn = np.radians(angle_deg)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    to_unit = np.eye(3)  # from pixels to coordinates in which the ellipse is the unit circle
    to_unit[:2, :2] = axes / half[:, None]
    to_unit[:2, 2] = -to_unit[:2, :2] @ (origin_px + np.array([x, y]))
    to_unit = to_unit @ rig.camera.camera_matrix
    conic: Float64[Array, "3 3"] = to_unit.T @ np.diag([1.0, 1.0, -1.0]) @ to_unit
    return conic / float(np.abs(conic).max())


def circle_poses(
    conic: Float64[Array, "3 3"], radius_m: float
) -> list[tuple[Float64[Array, "3"], Float64[Array, "3"]]]:
    """Centres and normals, towards the camera, of the circles of this radius whose image is a conic: two, or none.

    Chen, Wu and Wada, "Camera calibration with two arbitrary coplanar circles", ECCV 2004, from the eigenvalues
    l1 >= l2 > 0 > l3 of the conic and its eigenvectors.
    """
    values, vectors = np.linalg.eigh(conic)
    if np.sum(values > 0) == 1:
        values, vectors = -values[::-1], vectors[:, ::-1]
    (l3, l2, l1), axes = values.tolist(), vectors[:, ::-1]
    if not (l1 >= l2 > 0 > l3):
        return []
    across, along = np.sqrt((l1 - l2) / (l1 - l3)), np.sqrt((l2 - l3) / (l1 - l3))
    depth_m = l2 * radius_m / np.sqrt(-l1 * l3)
    poses = []
    for side in (1.0, -1.0):
        normal = axes @ np.array([side * across, 0.0, -along])
        center_m = depth_m * (axes @ np.array([side * l3 / l2 * across, 0.0, -l1 / l2 * along]))
        center_m = center_m if center_m[2] > 0 else -center_m
        poses.append((center_m, towards_camera(normal, center_m)))
    return poses


def _points_in_space(
    detection: Detection, rig: Rig
) -> tuple[Float64[Array, "point xyz=3"], Int64[Array, "point"]] | NoPose | str:
    """The triangulated break points and their edges, or why they determine no pose."""
    points = detection.break_points
    if not isinstance(points, BreakPoints):
        return str(points.value)
    in_space = triangulated(points, rig)
    why = why_undetermined(in_space, points)
    if why is not None:
        return why
    laser, edges = np.nonzero(in_space.seen)
    return in_space.position_m[laser, edges], edges


def _facing_plane(points_m: Float64[Array, "point xyz=3"]) -> tuple[Float64[Array, "3"], float]:
    """The nearest plane, with its normal towards the camera."""
    normal = towards_camera(nearest_plane(points_m)[0], points_m.mean(axis=0))
    return normal, float(normal @ points_m.mean(axis=0))


def _visible_edges(detection: Detection) -> RingEdgePoints | None:
    edges = detection.ring_edges
    return None if edges is None or np.count_nonzero(edges.edge == 1) < MIN_ELLIPSE_POINTS else edges


def _radial_distances_m(
    center_m: Float64[Array, "3"],
    normal: Float64[Array, "3"],
    directions: Float64[Array, "point xyz=3"],
    edges: Int64[Array, "point"],
    radii: KnownRadii,
) -> Float64[Array, "point"]:
    """Signed distances of rays from their edges, in the ring's plane; NaN for a ray that does not meet the plane."""
    points_m = intersect(directions, normal, np.asarray(normal @ center_m))
    distance: Float64[Array, "point"] = np.linalg.norm(points_m - center_m, axis=1) - radii.radius_m[edges]
    return distance


def _edge_pose(
    method: StudyMethod,
    center_m: Float64[Array, "3"],
    normal: Float64[Array, "3"],
    directions: Float64[Array, "point xyz=3"],
    radii: KnownRadii,
) -> RingPose | str:
    points_m = intersect(directions, normal, np.asarray(normal @ center_m))
    points_m = points_m[np.isfinite(points_m[:, 0])]
    if not len(points_m):
        return "the rays of the visible edge do not meet the ring's plane"
    return _pose(method, center_m, normal, radii.radius_m, points_m)


def _pose(
    method: StudyMethod,
    center_m: Float64[Array, "3"],
    normal: Float64[Array, "3"],
    radius_m: Float64[Array, "2"],
    points_m: Float64[Array, "point xyz=3"],
) -> RingPose:
    """The pose with its grasp point on the middle of the band, in the direction of the mean of the points."""
    outward = points_m.mean(axis=0) - center_m
    outward -= (outward @ normal) * normal
    length = float(np.linalg.norm(outward))
    grasp_m = center_m + radius_m.mean() * (outward / length if length > 0 else tilt_basis(normal)[0])
    return RingPose(
        center_m=center_m,
        normal=normal,
        radius_inner_m=float(radius_m[0]),
        radius_outer_m=float(radius_m[1]),
        grasp_m=grasp_m,
        method=method.value,
        condition_number=nan,
        residual_rms_px=nan,
    )
