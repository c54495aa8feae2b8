"""Joint covariance of camera and light planes, and its effect on depths and on a ring's centre (method(7), section 6).

Points of one view share the error of that board's pose, and all views share the camera's errors: a covariance from the
scatter of the points about the plane would be far too small. If the views disagree by more than corners and stripes
explain (bent board, inaccurate print), all variances are scaled by that factor.

Depth and ring-centre uncertainties are those of the calibration alone, without the noise of the shot that is measured.
A ring amplifies depth errors: its arc is short and half a metre from its centre, so that small differences between the
stripes' depths tilt the ring and move its centre by a multiple of them.
"""

from collections.abc import Sequence

import numpy as np

from ringpose.calibrate.boards.corner_errors import maximum_likelihood_pose
from ringpose.calibrate.camera.parameters import parameter_names
from ringpose.calibrate.planes import joint_adjustment
from ringpose.calibrate.planes.stripes.extraction import triangulated
from ringpose.estimate.nuisance import point_covariance
from ringpose.geometry.least_squares import Eliminated, covariance_of_free
from ringpose.geometry.rays import project, rays
from ringpose.pose.closed_form import differentiated, pose_covariance
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.options import Method
from ringpose.types.rig import (
    PLANE_PARAMETERS,
    Camera,
    LaserPlanes,
    ParameterCovariance,
    Rig,
    bow_parameters,
    laser_parameters,
)

SIGNIFICANCE = 3.0
"""Significance of the chi-squared test, in its standard deviations above the mean."""

COLUMNS = 9
"""Positions along each stripe at which the depth uncertainty is evaluated."""

RADII_M = (0.567, 0.597)
"""Inner and outer radius of the ring whose centre is evaluated: the smaller of the paper's two rings."""


def planes_covariance(
    names: tuple[str, ...],
    information: Float64[Array, "shared shared"],
    data: joint_adjustment.JointData,
    excess: float,
) -> ParameterCovariance:
    """Covariance of the camera's parameters (if the given one has a covariance) and of the planes and their bends.

    `information` is the result of `joint_information`.
    """
    given, free_camera = data.camera, data.free_camera
    planes = laser_parameters(names) + bow_parameters(names[laser] for laser in data.bent)
    count = len(planes)
    information = information.copy()
    information[:count, :count] += excess * np.diag(data.prior)
    own = covariance_of_free(information[:count, :count])
    if given.covariance is None:
        return ParameterCovariance(parameters=planes, data=excess * own)
    if free_camera:
        # Inverse of the information with the camera's prior, reordered to camera, planes.
        free = np.append(np.ones(count, dtype=bool), joint_adjustment.free_parameters(given))
        prior = np.zeros_like(information)
        prior[count:, count:] = joint_adjustment.prior_information(given)
        joint = covariance_of_free(np.where(np.outer(free, free), information / excess + prior, 0.0))
        camera_first = np.roll(np.arange(len(joint)), len(joint) - count)
        joint = joint[np.ix_(camera_first, camera_first)]
    else:
        # The planes' own errors, and those that they inherit from the camera to first order.
        plane_wrt_camera = -own @ information[:count, count:]
        cross = given.covariance.data @ plane_wrt_camera.T
        joint = np.block([[given.covariance.data, cross], [cross.T, excess * own + plane_wrt_camera @ cross]])
    return ParameterCovariance(parameters=parameter_names(given.distortion_model) + planes, data=(joint + joint.T) / 2)


def variance_excess(data: joint_adjustment.JointData, state: joint_adjustment.JointState) -> float:
    """Factor by which variances are inflated to explain the disagreement of the views; 1 if it is not significant.

    The increase of chi-squared from boards placed by their corners alone to the joint solution has two degrees of
    freedom for each stripe, less three for each plane.
    """
    camera = state.camera
    separate = sum(
        joint_adjustment.corner_chi2(view, maximum_likelihood_pose(view.board, camera)[0], camera, corner_px)
        for view, corner_px in zip(data.views, data.corner_px.tolist(), strict=True)
    )
    increase = joint_adjustment.joint_chi2(data, state) - separate
    dof = sum(_degrees_of_freedom(data, laser) for laser in range(len(state.distance_m)))
    if dof <= 0 or increase < dof + SIGNIFICANCE * np.sqrt(2 * dof):
        return 1.0
    return increase / dof


def laser_disagreements(data: joint_adjustment.JointData, state: joint_adjustment.JointState) -> tuple[float, ...]:
    """Increase of chi-squared by each laser's stripes, per degree of freedom; NaN where there are none.

    It identifies a laser whose plane contradicts the board poses on which the other lasers agree.
    """
    disagreements, chi2 = [], joint_adjustment.joint_chi2(data, state)
    for laser in range(len(state.distance_m)):
        dof = _degrees_of_freedom(data, laser)
        others = data.without_laser(laser)
        disagreements.append(
            (chi2 - joint_adjustment.joint_chi2(others, joint_adjustment.joint_fit(others, state))) / dof
            if dof > 0
            else float("nan")
        )
    return tuple(disagreements)


def _degrees_of_freedom(data: joint_adjustment.JointData, laser: int) -> int:
    """Degrees of freedom of a laser: two for each of its stripes, less the parameters of its plane."""
    return 2 * sum(len(own[laser].ray) > 0 for own in data.rays) - len(PLANE_PARAMETERS)


def sheet_height_m(
    data: joint_adjustment.JointData, state: joint_adjustment.JointState, excess: float
) -> tuple[float, float]:
    """How far behind the print the surface lies that carries the stripes beside it, and the standard deviation.

    Zero is expected: the sheet of the print. With a height h common to all views, a centre beside the print is at
    P = (D + h) r / (n_b . r), and the image of its light plane there is that of a plane at the distance d D / (D + h).
    Boards at different distances and tilts determine h, and stripes of which a part is on the print. One Gauss-Newton
    step finds it.
    """
    count = data.sheets
    information, gradient = np.diag(np.append(data.prior, 0.0)), np.zeros(count + 1)
    for index, (view, pose) in enumerate(zip(data.views, state.poses, strict=True)):
        corners = joint_adjustment.corner_rows(data, state, index)
        blocks = [np.column_stack([corners, np.zeros(len(corners))])]
        for laser, stripe in joint_adjustment.stripes_of(data, state, index):
            beside = view.beside_print(triangulated(view.stripes_px[laser], pose, state.camera), pose)
            depth_m = float(pose.rotation[:, 2] @ pose.translation_m)
            wrt_height = beside * state.distance_m[laser] / (depth_m * stripe.metres_per_pixel)
            wrt_height /= -data.center_px[index][laser]
            blocks.append(np.column_stack([joint_adjustment.stripe_rows(data, index, laser, stripe), wrt_height]))
        rows = np.concatenate(
            [np.sqrt(joint_adjustment.robust_weights(each[:, -2]))[:, None] * each for each in blocks]
        )
        reduced = Eliminated.of(rows[:, :6], np.column_stack([rows[:, 6 : 6 + count], rows[:, -1]]), rows[:, -2])
        information += reduced.information
        gradient += reduced.gradient
    covariance = covariance_of_free(information)
    return float((covariance @ gradient)[-1]), float(np.sqrt(excess * covariance[-1, -1]))


def worst_depth_sd_m(rig: Rig, distances_m: Sequence[float]) -> Float64[Array, "laser distance"]:
    """Largest standard deviation of depths along each stripe; NaN where none of it is in the image."""
    sd = np.full((len(rig.lasers.names), len(distances_m)), np.nan)
    for laser, index in np.ndindex(sd.shape):
        sd[laser, index] = np.fmax.reduce(depth_sd_m(rig, laser, distances_m[index]))
    return sd


def depth_sd_m(rig: Rig, laser: int, distance_m: float) -> Float64[Array, "position"]:
    """Standard deviations of depths by the rig's covariance (method(7), section 1), without noise of the image.

    A depth here is the distance from the camera along the ray of a pixel. Unlike z, it does not change with a rotation
    of the camera frame, as an error of the principal point causes it: such a rotation has no effect on anything
    calibrated with the same camera (`validation`), and beside the axis z is mostly uncertain by it.

    The values hold along the laser's stripe on the plane z = `distance_m`, at `COLUMNS` positions spread over the
    image; NaN outside the image.
    """
    camera, normal = rig.camera, rig.lasers.normal[laser]
    size = np.array([camera.image_width, camera.image_height])
    across = 1 if abs(normal[1]) >= abs(normal[0]) else 0
    along = 1 - across
    sd = np.full(COLUMNS, np.nan)
    if abs(normal[across]) < 1e-6:
        return sd
    pixels = np.full((COLUMNS, 2), (size - 1) / 2)
    pixels[:, along] = np.linspace(0, size[along] - 1, COLUMNS)
    points = rays(pixels, camera) * distance_m
    rest_m = rig.lasers.distance_m[laser] - normal[along] * points[:, along] - normal[2] * distance_m
    points[:, across] = rest_m / normal[across]
    inside = _in_image(points, camera)
    if inside.any():
        seen = points[inside]
        covariance = _points_covariance(seen, np.full(len(seen), laser), rig).reshape(len(seen), 3, len(seen), 3)
        along_ray = seen / np.linalg.norm(seen, axis=1, keepdims=True)
        sd[inside] = np.sqrt(np.einsum("ni,ninj,nj->n", along_ray, covariance, along_ray).clip(0))
    return sd


def _in_image(points: Float64[Array, "n xyz=3"], camera: Camera) -> Bool[Array, "n"]:
    """Which points are projected into the image."""
    pixels, size = project(points, camera), np.array([camera.image_width, camera.image_height])
    return np.asarray(np.all((pixels > -0.5) & (pixels < size - 0.5), axis=1))


def _points_covariance(
    points: Float64[Array, "n xyz=3"], laser: Int64[Array, "n"], rig: Rig
) -> Float64[Array, "coordinate coordinate"]:
    """Covariance of points on light planes by the errors of the rig alone."""
    return point_covariance(points, np.zeros((len(points), 2, 2)), laser, rig)


def ring_center_sd_m(rig: Rig, distance_m: float) -> Float64[Array, "xyz=3"]:
    """Standard deviations of the centre of a ring that faces the camera, its arc in the middle of the stripes.

    NaN if not all stripes cross the arc within the image. The calibration errors are propagated through the constrained
    closed form (method(7), section 4); its sensitivity differs from the maximum-likelihood ring's by a tenth at 1 m.
    """
    points, edges = _break_points_m(rig.lasers, distance_m)
    if not _in_image(points, rig.camera).all() or len(rig.lasers.names) < 2:
        return np.full(3, np.nan)
    covariance = _points_covariance(points, np.repeat(np.arange(len(rig.lasers.names)), 2), rig)
    _, jacobian = differentiated(points, edges, Method.PAPER_CONSTRAINED)
    return np.sqrt(np.diag(pose_covariance(jacobian, covariance).center_m2).clip(0))


def _break_points_m(
    lasers: LaserPlanes, distance_m: float
) -> tuple[Float64[Array, "point xyz=3"], Int64[Array, "point"]]:
    """Intersections of the ring's edges with the stripes on the plane z = distance_m, and their edges; NaN if none.

    The ring's centre is (c, y0), c its mean radius and y0 the median stripe, so that the middle of its arc lies on the
    optical axis. On the stripe y = p x + q, (x - c)^2 + (y - y0)^2 = R^2 is quadratic in x: a x^2 + 2 b x + d = 0.
    """
    across = int(np.argmax(np.abs(lasers.normal[:, :2]).sum(axis=0)))
    component = lasers.normal[:, across]
    position_m = (lasers.distance_m - lasers.normal[:, 2] * distance_m) / component
    slope = -lasers.normal[:, 1 - across] / component
    radius = np.tile(RADII_M, len(position_m))
    offset, slope = np.repeat(position_m - np.median(position_m), 2), np.repeat(slope, 2)
    center = float(np.mean(RADII_M))
    a, b, d = 1 + slope**2, slope * offset - center, center**2 + offset**2 - radius**2
    with np.errstate(invalid="ignore"):
        along = (-b - np.sqrt(b**2 - a * d)) / a
    points = np.full((len(radius), 3), distance_m)
    points[:, 1 - across] = along
    points[:, across] = np.repeat(position_m, 2) + slope * along
    return points, np.tile([0, 1], len(position_m))


def of_camera(covariance: ParameterCovariance) -> ParameterCovariance:
    """The part of a joint covariance that the camera causes: its own, and that of planes correlated with it."""
    plane = np.array(["." in name for name in covariance.parameters])
    camera = covariance.data[np.ix_(~plane, ~plane)]
    regression = covariance.data[:, ~plane] @ np.linalg.pinv(camera, hermitian=True)
    data = regression @ camera @ regression.T
    return ParameterCovariance(parameters=covariance.parameters, data=(data + data.T) / 2)
