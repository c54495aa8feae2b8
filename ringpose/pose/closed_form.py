"""Methods `paper` and `paper-constrained`: the paper's closed form with its covariance (method(7), section 4).

Points come in batches, so that one call solves a pose and all the small displacements that its derivatives need.
Within a batch all points lie on the same edges.
"""

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from ringpose.estimate.covariance import (
    EDGE_ON_BELOW,
    UNKNOWN_FROM,
    WEAK_SD,
    exceeds_sd,
    standard_deviation,
)
from ringpose.estimate.nuisance import point_covariance
from ringpose.geometry.least_squares import damped_solution, inverse_condition
from ringpose.geometry.rays import GRAZING, nearest_plane, project, rays
from ringpose.geometry.rotations import tilt_basis
from ringpose.geometry.sheets import light_normals, sheet_points
from ringpose.kernels import _kernels, column_slices
from ringpose.measure.status import flags_of
from ringpose.types.arrays import EDGES, Array, Bool, Float64, Int64
from ringpose.types.detection import BreakPoints
from ringpose.types.finding import NOTHING, Finding
from ringpose.types.options import Method
from ringpose.types.pose import NoPose, RingPoints, RingPose
from ringpose.types.rig import Rig

MILLIMETRES = 1000.0
"""Millimetres per metre."""

SINGULAR_BELOW = 1e-3
"""q0: where smallest over largest singular value of the centre's equations falls below it, they are damped.

Three points with spacing a on a ring of radius R give about a / (2 R): the narrowest rig (1.5 degrees between
lasers, 0.2 m away) sees the largest ring of the launcher manuals (1.3 m) at 2e-3 and stays exact. Damped are points
on a straighter arc than any ring's, and stripes that nearly coincide (light planes that cross, at 0.19 m in the
paper's physical rig).
"""

MAX_DAMPING = SINGULAR_BELOW
"""lambda_max, in units of the largest singular value.

Equal to q0, so that the weakest direction keeps the share (q / q0)^2 of its undamped step from the mean of
the points: all of it at q0, nothing where the equations are singular.
"""

STEP = 1e-6
"""Step of the central differences, in units of the points' largest distance from their mean.

Small against the arc's height even of nearly collinear points (1e-3 of their extent), large against rounding
(1e-16 of their distance).
"""

_ARC_COLUMNS = column_slices("Arcs")

_ARC_COLUMNS = column_slices("Arcs")

MIN_LASERS_ON_AN_EDGE = 3
"""A circle needs three points on one edge; the other edge may have fewer."""

COLLINEAR_BELOW = 1e-6
"""Second over first singular value of the centred points; three points 10 mm apart on a 1.3 m ring have 2e-3."""

OFF_PLANE = 0.01
"""Distance of the centre from the ring's plane, in radii, from which it is flagged as weak.

Method `paper` hardly enforces the plane, so that noise moves its centre along the normal by decimetres, which a
first-order covariance does not show; in-plane methods are not affected.
"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedForm:
    """Solutions of the closed form for a batch of point sets; lengths in metres, camera frame."""

    normal: Float64[Array, "batch xyz=3"]
    offset_m: Float64[Array, "batch"]
    """The ring's plane is `normal . point = offset_m`."""
    center_m: Float64[Array, "batch xyz=3"]
    radius_m: Float64[Array, "batch edge=2"]
    grasp_m: Float64[Array, "batch xyz=3"]
    condition: Float64[Array, "batch"]
    damped: Bool[Array, "batch"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseCovariance:
    """Covariances of one pose; NaN where the quantity itself is NaN."""

    parameters: Float64[Array, "7 7"]
    """Covariance of tilt_1, tilt_2, offset_m, center_1_m, center_2_m, radius_inner_m, radius_outer_m."""
    center_m2: Float64[Array, "3 3"]
    grasp_m2: Float64[Array, "3 3"]


def closed_form_pose(
    break_points: BreakPoints, rig: Rig, method: Method = Method.PAPER_CONSTRAINED
) -> RingPose | NoPose:
    """Pose of the ring in the camera frame by one of the paper's methods, or the reason why there is none."""
    points = triangulated(break_points, rig)
    undetermined = why_undetermined(points, break_points)
    if undetermined is not None:
        return undetermined
    form, covariance = form_and_covariance(points, break_points, rig, method)
    residual_rms_px = prediction_rms_px(form, points, break_points, rig)
    if covariance is not None and standard_deviation(covariance.parameters[:2, :2]) > UNKNOWN_FROM:
        return NoPose.COLLINEAR
    if not math.isfinite(residual_rms_px):
        return NoPose.NOT_FINITE
    radius_inner_m, radius_outer_m = form.radius_m[0].tolist()
    return RingPose(
        center_m=form.center_m[0],
        normal=form.normal[0],
        radius_inner_m=radius_inner_m,
        radius_outer_m=radius_outer_m,
        grasp_m=form.grasp_m[0],
        method=method.value,
        condition_number=float(form.condition[0]),
        residual_rms_px=residual_rms_px,
        covariance=None if covariance is None else covariance.parameters,
        covariance_center_m2=None if covariance is None else covariance.center_m2,
        covariance_grasp_m2=None if covariance is None else covariance.grasp_m2,
        flags=flags_of(what_is_open(form, covariance)),
    )


def why_undetermined(points: RingPoints, break_points: BreakPoints) -> NoPose | None:
    """The reason why these points determine no pose; None if they do.

    A break point that cannot be triangulated rejects the whole shot: its laser is wrong, and the pose of the others
    would be wrong without any sign of it.
    """
    seen = points.seen
    if (break_points.seen & ~seen).any():
        return NoPose.UNTRIANGULATED
    if max(map(sum, zip(*seen.tolist(), strict=True)), default=0) < MIN_LASERS_ON_AN_EDGE:
        return NoPose.TOO_FEW_BREAK_POINTS
    positions = points.position_m[seen]
    _, distance_m, singular_values = nearest_plane(positions)
    if singular_values[1] <= COLLINEAR_BELOW * singular_values[0]:
        return NoPose.COLLINEAR
    if abs(distance_m) < EDGE_ON_BELOW * float(np.linalg.norm(positions.mean(axis=0))):
        return NoPose.EDGE_ON
    return None


def form_and_covariance(
    points: RingPoints, break_points: BreakPoints, rig: Rig, method: Method
) -> tuple[ClosedForm, PoseCovariance | None]:
    """The method's solution, a batch of one, and its covariance.

    None if the covariance of a seen break point, or of the rig, is not finite.
    """
    laser, edges = np.nonzero(points.seen)
    positions, covariance_px2 = points.position_m[laser, edges], break_points.covariance_px2[laser, edges]
    covariance_m2 = (
        point_covariance(positions, covariance_px2, laser, rig) if np.isfinite(covariance_px2).all() else None
    )
    if covariance_m2 is None or not np.isfinite(covariance_m2).all():
        return FORMS[method](positions[None], edges), None
    form, jacobian = differentiated(positions, edges, method)
    return form, pose_covariance(jacobian, covariance_m2)


def pose_covariance(
    jacobian: Float64[Array, "13 coordinate"], covariance_m2: Float64[Array, "coordinate coordinate"]
) -> PoseCovariance:
    """Covariance J Sigma J^T of a solution at points whose joint covariance is given, to first order.

    First order is enough while the centre's standard deviation is a few percent of the radius. Beyond that (flag
    CENTER_WEAK) the centre's distribution is skew: the arc's height is measured, the centre's distance is
    proportional to its inverse, and the true centre may lie many of these standard deviations away.
    """
    joint = jacobian @ covariance_m2 @ jacobian.T
    return PoseCovariance(parameters=joint[:7, :7], center_m2=joint[7:10, 7:10], grasp_m2=joint[10:, 10:])


def prediction_rms_px(form: ClosedForm, points: RingPoints, break_points: BreakPoints, rig: Rig) -> float:
    """Root mean square distance between measured and predicted break points, in pixels (with distortion).

    The predicted point is where ring plane, light plane and the sphere of the edge's radius about the centre meet (on
    the edge itself if the centre lies in the ring plane). If the light plane misses the sphere, it is the point of the
    stripe's line that is nearest to the centre. NaN if there is no such point in front of the camera. `form` is a batch
    of one.
    """
    laser, edge = np.nonzero(points.seen)
    normal, seen_m = form.normal[0], points.position_m[laser, edge]
    light_normal = light_normals(seen_m, laser, rig)

    # each point moved within its light plane, the shortest way, onto the ring's plane
    uphill = normal - (light_normal @ normal)[:, None] * light_normal
    step_m = (form.offset_m[0] - seen_m @ normal) / _nan_if_grazing(uphill @ normal)
    on_both_m = seen_m + step_m[:, None] * uphill

    direction = np.cross(normal, light_normal)
    direction /= _nan_if_grazing(np.linalg.norm(direction, axis=1))[:, None]
    predicted_m = nearest_crossing(on_both_m, direction, form.center_m[0], form.radius_m[0, edge])
    difference_px = project(predicted_m, rig.camera) - break_points.position_px[laser, edge]
    return math.sqrt(float(np.sum(difference_px**2)) / len(difference_px))


def _nan_if_grazing(length: Float64[Array, "n"]) -> Float64[Array, "n"]:
    return np.where(length > GRAZING, length, np.nan)


def what_is_open(form: ClosedForm, covariance: PoseCovariance | None) -> Finding:
    """What a pose (a batch of one) leaves open: of damped equations the centre, whatever its covariance is."""
    radii_m = form.radius_m[0]
    smallest_m = float(np.nanmin(radii_m))
    findings = NOTHING
    if form.damped[0]:
        findings |= Finding.CENTER_OPEN | Finding.RADIUS_OPEN
    if np.isnan(radii_m).any():
        findings |= Finding.RADIUS_OPEN
    if abs(form.normal[0] @ form.center_m[0] - form.offset_m[0]) > OFF_PLANE * smallest_m:
        findings |= Finding.CENTER_OPEN
    if covariance is not None and exceeds_sd(covariance.center_m2, WEAK_SD * smallest_m):
        findings |= Finding.CENTER_OPEN
    if covariance is not None and bool((np.diag(covariance.parameters)[5:] > (WEAK_SD * smallest_m) ** 2).any()):
        findings |= Finding.RADIUS_OPEN
    return findings


def paper_form(points_m: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]) -> ClosedForm:
    """Method `paper`, read literally: plane, centre, radii and the mean of the points as the grasp point.

    In millimetres, as in the paper: the row of the plane, of size 1e-3, then has hardly any weight beside rows of size
    1e2, so that the centre leaves the ring's plane: exact on exact points, decimetres off along the normal with the
    noise of a real image. Kept as a baseline.
    """
    points = MILLIMETRES * points_m
    mean = points.mean(axis=1)
    plane = damped_solution(points, np.ones(points.shape[:2]), np.zeros(len(points)))  # P . n = 1, Eq. (4.1)
    length = np.linalg.norm(plane, axis=-1)

    # K R = M with R measured from the mean of the points, Eq. (4.3): equal distances, then n . R = 1
    rows, targets = equal_distance_rows(points - mean[:, None], edges)
    plane_target = 1.0 - np.sum(plane * mean, axis=-1)
    step, quotient = damped_center(
        np.concatenate([rows, plane[:, None]], axis=1), np.concatenate([targets, plane_target[:, None]], axis=1)
    )
    center = mean + step
    return ClosedForm(
        normal=_facing(plane / length[:, None], mean),
        offset_m=-1.0 / length / MILLIMETRES,
        center_m=center / MILLIMETRES,
        radius_m=mean_radii(points, edges, center) / MILLIMETRES,
        grasp_m=mean / MILLIMETRES,
        condition=1.0 / np.maximum(quotient, np.finfo(float).tiny),
        damped=quotient < SINGULAR_BELOW,
    )


def constrained_form(points_m: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]) -> ClosedForm:
    """Method `paper-constrained`: the same equations in the ring's plane; radii, and the mid-band grasp point.

    The plane is the nearest one to the points. The paper scales it to P . n = 1, which fails for a plane through the
    camera; the smallest singular vector of the centred points does not.
    """
    mean = points_m.mean(axis=1)
    from_mean = points_m - mean[:, None]
    axes = np.linalg.svd(from_mean)[2]
    normal, in_plane = _facing(axes[:, 2], mean), axes[:, :2]
    rows, targets = equal_distance_rows(from_mean, edges)
    step, quotient = damped_center(rows @ in_plane.swapaxes(1, 2), targets)  # Eq. (4.3) in the plane's coordinates
    center = mean + np.einsum("bk,bkx->bx", step, in_plane)
    return ClosedForm(
        normal=normal,
        offset_m=np.sum(normal * mean, axis=-1),
        center_m=center,
        radius_m=mean_radii(points_m, edges, center),
        grasp_m=mid_band_point(points_m, edges, normal),
        condition=1.0 / np.maximum(quotient, np.finfo(float).tiny),
        damped=quotient < SINGULAR_BELOW,
    )


FORMS = {Method.PAPER: paper_form, Method.PAPER_DETECTOR: paper_form, Method.PAPER_CONSTRAINED: constrained_form}
"""The closed form of each method."""


def equal_distance_rows(
    points: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]
) -> tuple[Float64[Array, "batch row xyz=3"], Float64[Array, "batch row"]]:
    """Rows 2 (P_m - P_l) . R = |P_m|^2 - |P_l|^2: R is as far from P_m as from the edge's first point P_l, Eq. (4.2).

    An edge seen by k lasers gives k - 1 rows.
    """
    on_edge = [np.flatnonzero(edges == edge) for edge in range(len(EDGES))]
    first = np.concatenate([np.repeat(numbers[:1], max(len(numbers) - 1, 0)) for numbers in on_edge])
    other = np.concatenate([numbers[1:] for numbers in on_edge])
    square = np.sum(points**2, axis=-1)
    return 2.0 * (points[:, other] - points[:, first]), square[:, other] - square[:, first]


def damped_center(
    rows: Float64[Array, "batch row column"], targets: Float64[Array, "batch row"]
) -> tuple[Float64[Array, "batch column"], Float64[Array, "batch"]]:
    """Damped least-squares solution of the centre's equations, measured from the mean of the points, and their q.

    lambda^2 = lambda_max^2 (1 - (q / q0)^2) below q0, none above, Eq. (4.4): a well-conditioned case stays exact, a
    singular one stays finite.
    """
    quotient = inverse_condition(rows)
    share = np.minimum(quotient / SINGULAR_BELOW, 1.0)
    return damped_solution(rows, targets, MAX_DAMPING * np.sqrt(1.0 - share**2)), quotient


def mean_radii(
    points: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"], center: Float64[Array, "batch xyz=3"]
) -> Float64[Array, "batch edge=2"]:
    """Mean distance of each edge's points from the centre, Eq. (4.5); NaN for an edge that was not seen."""
    distance = np.linalg.norm(points - center[:, None], axis=-1)
    unseen = np.full(len(points), np.nan)
    radii = [distance[:, edges == e].mean(axis=-1) if (edges == e).any() else unseen for e in range(len(EDGES))]
    return np.stack(radii, axis=-1)


def mid_band_point(
    points: Float64[Array, "batch point xyz=3"],
    edges: Int64[Array, "point"],
    normal: Float64[Array, "batch xyz=3"],
) -> Float64[Array, "batch xyz=3"]:
    """Grasp point c + (r_i + r_o)/2 e, with e in the plane from the centre towards the mean of the points (section 5).

    It is not computed from the centre, which may be weak: Eq. (4.2) is biased towards small circles, whose centre lies
    among the points. Two arcs of any curvature, 0 included, give the same point. NaN if an edge was not seen.
    """
    if len(set(edges.tolist())) < len(EDGES):
        return np.full_like(normal, np.nan)
    mean = points.mean(axis=1)
    between = points[:, edges == 1].mean(axis=1) - points[:, edges == 0].mean(axis=1)
    x_axis = between - np.sum(between * normal, axis=-1, keepdims=True) * normal
    length = np.linalg.norm(x_axis, axis=-1, keepdims=True)
    x_axis /= np.where(length > 0, length, np.nan)
    axes = np.stack([x_axis, np.cross(normal, x_axis)], axis=1)
    arcs = arc_equations((points - mean[:, None]) @ axes.swapaxes(1, 2), edges)
    outward = (axes[:, 0] + arcs.lean * axes[:, 1]) / np.hypot(1.0, arcs.lean)
    grasp: Float64[Array, "batch xyz=3"] = mean + arc_crossings(arcs).mean(axis=-1, keepdims=True) * outward
    return grasp


def nearest_crossing(
    point: Float64[Array, "n xyz=3"],
    direction: Float64[Array, "n xyz=3"],
    center: Float64[Array, "3"],
    radius: Float64[Array, "n"],
) -> Float64[Array, "n xyz=3"]:
    """Crossings of lines with spheres about one centre: for each line, the crossing nearer to its given point.

    A line in the circle's plane meets circle and sphere at the same points. For a line that does not meet the sphere,
    its point nearest to the centre is returned. `direction` has unit length.
    """
    along = np.sum((center - point) * direction, axis=-1)
    foot = point + along[:, None] * direction
    half_chord = np.sqrt(np.maximum(radius**2 - np.sum((foot - center) ** 2, axis=-1), 0.0))
    step = along + np.where(along > 0, -half_chord, half_chord)
    crossing: Float64[Array, "n xyz=3"] = point + step[:, None] * direction
    return crossing


class ArcEquations(NamedTuple):
    """Two concentric arcs: bend (x^2 + y^2) + x + lean y + level = 0, x and y from the mean of their points.

    `bend` is half the curvature (for `lean` 0), `lean` the tangent of the angle between their common radius and the
    x axis, and `level` the position of each arc along x.
    """

    bend: Float64[Array, "*batch 1"]
    lean: Float64[Array, "*batch 1"]
    level: Float64[Array, "*batch arc=2"]


def arc_equations(points: Float64[Array, "*batch n xy=2"], arc: Int64[Array, "n"]) -> ArcEquations:
    """Two arcs about one centre through points in a plane that cross the x axis steeply; `arc` is 0 or 1.

    The detector tests groups of stripes by the same fit, which kernels/lines/arcs.c describes.
    """
    rows = np.empty((*points.shape[:-2], 4))
    centred = np.ascontiguousarray(points - points.mean(axis=-2, keepdims=True)).reshape(-1, *points.shape[-2:])
    _kernels.arcs(centred, np.ascontiguousarray(arc), rows.reshape(-1, 4))
    return ArcEquations(**{name: rows[..., columns] for name, columns in _ARC_COLUMNS.items()})


def arc_crossings(arcs: ArcEquations) -> Float64[Array, "*batch arc=2"]:
    """Signed distance from the mean of the points to each arc, along the radius through the mean; positive towards +x.

    The smaller root t of bend t^2 + s t + level = 0, s = sqrt(1 + lean^2), written without a division by bend.
    """
    denominator = np.hypot(1.0, arcs.lean)
    root = np.sqrt(np.maximum(denominator**2 - 4.0 * arcs.bend * arcs.level, 0.0))
    crossings: Float64[Array, "*batch arc=2"] = -2.0 * arcs.level / (denominator + root)
    return crossings


def _facing(
    normal: Float64[Array, "batch xyz=3"], point: Float64[Array, "batch xyz=3"]
) -> Float64[Array, "batch xyz=3"]:
    """The normals with the sign for which they point from `point` towards the camera's centre."""
    away = np.sum(normal * point, axis=-1, keepdims=True) > 0
    return np.where(away, -normal, normal)


class Differentiated(NamedTuple):
    """A closed-form solution and its Jacobian."""

    form: ClosedForm
    """A batch of one."""
    jacobian: Float64[Array, "13 coordinate"]
    """Derivatives of the seven parameters, the centre and the grasp point by the points' x1 y1 z1 x2 ..."""


def differentiated(
    points_m: Float64[Array, "point xyz=3"], edges: Int64[Array, "point"], method: Method
) -> Differentiated:
    """The closed form's solution at these points, and its Jacobian by central differences."""
    count = points_m.size
    step_m = STEP * float(np.linalg.norm(points_m - points_m.mean(axis=0), axis=1).max())
    displacement = step_m * np.concatenate([np.eye(count), -np.eye(count), np.zeros((1, count))])
    form = FORMS[method](points_m + displacement.reshape(-1, *points_m.shape), edges)
    values = _solution_values(form, form.normal[-1])
    solution = ClosedForm(**{field.name: getattr(form, field.name)[-1:] for field in fields(ClosedForm)})
    return Differentiated(solution, (values[:count] - values[count:-1]).T / (2.0 * step_m))


def _solution_values(form: ClosedForm, normal: Float64[Array, "3"]) -> Float64[Array, "batch 13"]:
    """The seven parameters about a given unit normal, then the centre and the grasp point.

    The tilts are those of `geometry.rotations.tilted`; center_1 and center_2 are, to first order in the tilts, the
    centre's coordinates along the two vectors of that normal's tilt basis, which tilt with the ring (Eq. (8.3)).
    """
    basis = tilt_basis(normal)
    tilt = form.normal @ basis.T / (form.normal @ normal)[:, None]
    in_plane = form.center_m @ basis.T - (form.center_m @ normal)[:, None] * tilt
    return np.concatenate([tilt, form.offset_m[:, None], in_plane, form.radius_m, form.center_m, form.grasp_m], axis=-1)


def triangulated(break_points: BreakPoints, rig: Rig) -> RingPoints:
    """Intersections of the rays of the break points with their light planes.

    NaN where a break point was not seen, and where its ray is parallel to the plane or meets it behind the camera.
    """
    directions = rays(break_points.position_px, rig.camera)
    position = sheet_points(directions, np.arange(len(rig.lasers.names))[:, None], rig)
    return RingPoints(position_m=position)
