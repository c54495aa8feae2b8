"""Joint covariance of camera and light planes, and its effect on depths and on a ring's centre (method(7), section 6).

Points of one view share the error of that board's pose, and all views share the camera's errors: a covariance from the
scatter of the points about the plane would be far too small. If the views disagree by more than corners and stripes
explain (bent board, inaccurate print), all variances are scaled by that factor.

Depth and ring-centre uncertainties are those of the calibration alone, without the noise of the shot that is measured.
A ring amplifies depth errors: its arc is short and half a metre from its centre, so that small differences between the
stripes' depths tilt the ring and move its centre by a multiple of them.
"""

import numpy as np

from ringpose.calibrate.boards.corner_errors import maximum_likelihood_pose
from ringpose.calibrate.camera.parameters import covariance_of_free, parameter_names
from ringpose.calibrate.planes.joint_adjustment import (
    JointData,
    JointState,
    corner_chi2,
    free_parameters,
    joint_chi2,
    joint_fit,
    prior_information,
)
from ringpose.geometry.rays import intersect, pixels_wrt_ray_and_camera, project, rays
from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.closed_form import differentiated, pose_covariance
from ringpose.pose.triangulation import point_covariance
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.options import Method
from ringpose.types.rig import (
    CAMERA_PARAMETERS,
    PLANE_PARAMETERS,
    Camera,
    LaserPlanes,
    ParameterCovariance,
    Rig,
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
    given: Camera,
    excess: float,
    free_camera: bool,
) -> ParameterCovariance:
    """Covariance of the camera's parameters (if `given` has a covariance) and of each plane's tilts and distance.

    `information` is that of `joint_information`.
    """
    planes = laser_parameters(names)
    count = len(planes)
    own = covariance_of_free(information[:count, :count])
    if given.covariance is None:
        return ParameterCovariance(parameters=planes, data=excess * own)
    if free_camera:
        # Inverse of the information with the camera's prior, reordered to camera, planes.
        free = np.append(np.ones(count, dtype=bool), free_parameters(given))
        prior = np.zeros_like(information)
        prior[count:, count:] = prior_information(given)
        data = covariance_of_free(np.where(np.outer(free, free), information / excess + prior, 0.0))
        camera_first = np.roll(np.arange(len(data)), len(data) - count)
        data = data[np.ix_(camera_first, camera_first)]
    else:
        # The planes' own errors, and those that they inherit from the camera to first order.
        plane_wrt_camera = -own @ information[:count, count:]
        cross = given.covariance.data @ plane_wrt_camera.T
        data = np.block([[given.covariance.data, cross], [cross.T, excess * own + plane_wrt_camera @ cross]])
    return ParameterCovariance(parameters=parameter_names(given.distortion_model) + planes, data=(data + data.T) / 2)


def variance_excess(data: JointData, state: JointState) -> float:
    """Factor by which variances are inflated to explain the disagreement of the views; 1 if it is not significant.

    The increase of chi-squared from boards placed by their corners alone to the joint solution has two degrees of
    freedom for each stripe, less three for each plane.
    """
    camera = state.camera
    separate = sum(
        corner_chi2(view, maximum_likelihood_pose(view.board, camera)[0], camera, corner_px)
        for view, corner_px in zip(data.views, data.corner_px.tolist(), strict=True)
    )
    increase = joint_chi2(data, state) - separate
    dof = sum(_degrees_of_freedom(data, laser) for laser in range(len(state.distance_m)))
    if dof <= 0 or increase < dof + SIGNIFICANCE * np.sqrt(2 * dof):
        return 1.0
    return increase / dof


def laser_disagreements(data: JointData, state: JointState) -> tuple[float, ...]:
    """Increase of chi-squared by each laser's stripes, per degree of freedom; NaN where there are none.

    It identifies a laser whose plane contradicts the board poses on which the other lasers agree.
    """
    found, chi2 = [], joint_chi2(data, state)
    for laser in range(len(state.distance_m)):
        dof = _degrees_of_freedom(data, laser)
        others = data.without_laser(laser)
        found.append((chi2 - joint_chi2(others, joint_fit(others, state))) / dof if dof > 0 else float("nan"))
    return tuple(found)


def _degrees_of_freedom(data: JointData, laser: int) -> int:
    """Two for each of a laser's stripes, less the parameters of its plane."""
    return 2 * sum(len(own[laser].ray) > 0 for own in data.rays) - len(PLANE_PARAMETERS)


def depth_uncertainty(
    camera: Camera, lasers: LaserPlanes, covariance: ParameterCovariance, distances_m: tuple[float, ...]
) -> Float64[Array, "laser distance position"]:
    """Standard deviations of depths by the joint covariance (method(7), section 1).

    They hold along the stripe of each laser on planes perpendicular to the optical axis; NaN outside the image.
    """
    sd = np.full((len(lasers.names), len(distances_m), COLUMNS), np.nan)
    for laser, distance in np.ndindex(sd.shape[:2]):
        plane_m = float(lasers.distance_m[laser])
        pixels = _stripe_px(camera, lasers.normal[laser], plane_m, distances_m[distance])
        inside = np.isfinite(pixels).all(axis=1)
        if inside.any():
            jacobian = _depth_jacobian(camera, lasers, covariance.parameters, laser, pixels[inside])
            sd[laser, distance, inside] = np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance.data, jacobian).clip(0))
    return sd


def worst_depth_sd_m(
    camera: Camera, lasers: LaserPlanes, covariance: ParameterCovariance, distances_m: tuple[float, ...]
) -> Float64[Array, "laser distance"]:
    """Largest of these standard deviations along each stripe; NaN where none of it is in the image."""
    return np.fmax.reduce(depth_uncertainty(camera, lasers, covariance, distances_m), axis=-1)


def _stripe_px(
    camera: Camera, normal: Float64[Array, "xyz=3"], distance_m: float, z_m: float
) -> Float64[Array, "position xy=2"]:
    """Pixels along the stripe on the plane z = z_m, spread over the image; NaN outside the image."""
    size = np.array([camera.image_width, camera.image_height])
    across = 1 if abs(normal[1]) >= abs(normal[0]) else 0
    along = 1 - across
    if abs(normal[across]) < 1e-6:
        return np.full((COLUMNS, 2), np.nan)
    pixels = np.full((COLUMNS, 2), (size - 1) / 2)
    pixels[:, along] = np.linspace(0, size[along] - 1, COLUMNS)
    points = rays(pixels, camera) * z_m
    points[:, across] = (distance_m - normal[along] * points[:, along] - normal[2] * z_m) / normal[across]
    pixels = project(points, camera)
    inside = np.all((pixels > -0.5) & (pixels < size - 0.5), axis=1)
    return np.where(inside[:, None], pixels, np.nan)


def _depth_jacobian(
    camera: Camera, lasers: LaserPlanes, parameters: tuple[str, ...], laser: int, pixels: Float64[Array, "n xy=2"]
) -> Float64[Array, "n parameter"]:
    """Derivatives of the depth z = d / (m . r), r = (x, y, 1), with respect to the named parameters.

    dz/dd = 1 / (m . r), and dz = -z m . dr / (m . r) for a change of the ray.
    """
    normal, distance_m = lasers.normal[laser], lasers.distance_m[laser]
    directions = rays(pixels, camera)
    points = intersect(directions, normal, np.array(float(distance_m)))
    denominator = directions @ normal
    wrt_plane = np.column_stack([-(points @ tilt_basis(normal).T), np.ones(len(points))]) / denominator[:, None]
    pixel_wrt_ray, pixel_wrt_camera = pixels_wrt_ray_and_camera(directions[:, :2], camera)
    ray_wrt_camera = -np.linalg.solve(pixel_wrt_ray, pixel_wrt_camera)  # the pixel is held constant
    wrt_camera = -(points[:, 2] / denominator)[:, None] * np.einsum("i,nip->np", normal[:2], ray_wrt_camera)
    columns = dict(zip(laser_parameters([lasers.names[laser]]), wrt_plane.T, strict=True))
    columns |= dict(zip(CAMERA_PARAMETERS, wrt_camera.T, strict=False))
    zero = np.zeros(len(points))
    return np.column_stack([columns.get(name, zero) for name in parameters])


def ring_center_sd_m(
    camera: Camera, lasers: LaserPlanes, covariance: ParameterCovariance, distance_m: float
) -> Float64[Array, "xyz=3"]:
    """Standard deviations of the centre of a ring that faces the camera, its arc in the middle of the stripes.

    NaN if not all stripes cross the arc within the image. The calibration errors are propagated through the constrained
    closed form (method(7), section 4); its sensitivity differs from the maximum-likelihood ring's by a tenth at 1 m.
    """
    points, edges = _break_points_m(lasers, distance_m)
    laser = np.repeat(np.arange(len(lasers.names)), 2)
    pixels = project(points, camera)
    inside = np.all((pixels > -0.5) & (pixels < np.array([camera.image_width, camera.image_height]) - 0.5), axis=1)
    if not inside.all() or len(lasers.names) < 2:
        return np.full(3, np.nan)
    rig = Rig(camera=camera, lasers=lasers, covariance=covariance)
    points_covariance = point_covariance(points, np.zeros((len(points), 2, 2)), laser, rig)
    _, jacobian = differentiated(points, edges, Method.PAPER_CONSTRAINED)
    variance = pose_covariance(jacobian, points_covariance).center_m2
    return np.sqrt(np.diag(variance).clip(0))


def _break_points_m(
    lasers: LaserPlanes, distance_m: float
) -> tuple[Float64[Array, "point xyz=3"], Int64[Array, "point"]]:
    """Intersections of the ring's edges with the stripes on the plane z = distance_m, and their edges; NaN if none.

    The ring's centre is (c, y0), c its mean radius and y0 the median stripe, so that the middle of its arc lies on the
    optical axis. On the stripe y = p x + q, (x - c)^2 + (y - y0)^2 = R^2 is quadratic in x: a x^2 + 2 b x + d = 0.
    """
    across, position_m, slope = _stripes(lasers, distance_m)
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


def _stripes(lasers: LaserPlanes, distance_m: float) -> tuple[int, Float64[Array, "laser"], Float64[Array, "laser"]]:
    """Stripes on the plane z = distance_m: the image axis across them, their positions on that axis, their slopes."""
    across = int(np.argmax(np.abs(lasers.normal[:, :2]).sum(axis=0)))
    component = lasers.normal[:, across]
    position_m = (lasers.distance_m - lasers.normal[:, 2] * distance_m) / component
    return across, position_m, -lasers.normal[:, 1 - across] / component


def stripes_apart_m(lasers: LaserPlanes, distance_m: float) -> float:
    """Distance between the outermost stripes on the plane z = distance_m."""
    _, position_m, _ = _stripes(lasers, distance_m)
    return float(np.ptp(position_m))


def of_camera(covariance: ParameterCovariance) -> ParameterCovariance:
    """The part of a joint covariance that the camera causes: its own, and that of the planes correlated with it."""
    plane = np.array(["." in name for name in covariance.parameters])
    camera = covariance.data[np.ix_(~plane, ~plane)]
    regression = covariance.data[:, ~plane] @ np.linalg.pinv(camera, hermitian=True)
    data = regression @ camera @ regression.T
    return ParameterCovariance(parameters=covariance.parameters, data=(data + data.T) / 2)
