"""Joint covariance of camera and light planes, from the joint fit of boards and planes (ringpose-method(7), section 6).

Points of one view share the error of that board's pose, and all views share the camera's: a covariance from the
scatter of the points about the plane would be far too small. Where the views disagree by more than corners and stripes
explain (a bent board, an inexact print), the variances of these are widened to what they show.

How well depths are known along the light planes, before any noise of the shot itself.

How well a ring's centre is known by a calibration alone, before any noise of the shot itself.

A ring amplifies what depths say: its short arc ends half a metre from its centre, and where its outer stripes seem
nearer than the one between them it seems tilted, by a multiple of that.
"""

from dataclasses import dataclass

import numpy as np

from ringpose.calibrate.boards.corner_errors import maximum_likelihood_pose
from ringpose.calibrate.camera.parameters import parameter_names
from ringpose.calibrate.planes.joint_adjustment import (
    JointData,
    JointFit,
    corner_chi2,
    free_parameters,
    joint_fit,
    prior_information,
)
from ringpose.geometry.rays import intersect, project, rays
from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.closed_form import differentiated, pose_covariance
from ringpose.pose.measurements import pixels_wrt_ray_and_camera
from ringpose.pose.triangulation import point_covariance
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.camera import Camera
from ringpose.types.covariance import CAMERA_PARAMETERS, PLANE_PARAMETERS, ParameterCovariance, laser_parameters
from ringpose.types.options import Method
from ringpose.types.rig import LaserPlanes, Rig

SIGNIFICANCE = 3.0
"""Standard deviations by which the sum of squares must exceed its mean (chi-squared) to be more than chance."""


def planes_covariance(
    names: tuple[str, ...], fit: JointFit, given: Camera, excess: float, free_camera: bool
) -> ParameterCovariance:
    """Covariance of the camera's parameters (if the camera has one) and of each plane's two tilts and distance."""
    planes = laser_parameters(names)
    if given.covariance is None:
        count = len(planes)
        return ParameterCovariance(parameters=planes, data=excess * inverse_of_scaled(fit.information[:count, :count]))
    joint = _with_free_camera if free_camera else _with_given_camera
    data = joint(fit, given, excess, len(planes))
    return ParameterCovariance(parameters=parameter_names(given.distortion_model) + planes, data=(data + data.T) / 2)


def inverse_of_scaled(information: Float64[Array, "n n"]) -> Float64[Array, "n n"]:
    """Inverse of a normal matrix whose parameters have different units; zero for those that nothing depends on."""
    inverse = np.zeros_like(information)
    seen = np.flatnonzero(np.diag(information) > 0)
    scale = np.sqrt(np.diag(information)[seen])
    inner = information[np.ix_(seen, seen)] / np.outer(scale, scale)
    inverse[np.ix_(seen, seen)] = np.linalg.inv(inner) / np.outer(scale, scale)
    return inverse


def variance_excess(data: JointData, fit: JointFit) -> float:
    """Factor by which stripes tear at the boards more than chance has it; one where it is chance.

    What the squares grow by when stripes have to lie on common planes follows chi-squared: two numbers a stripe, less
    three for each plane.
    """
    camera = fit.state.camera
    boards = [(view, maximum_likelihood_pose(view.board, camera)[0]) for view in data.views]
    sigmas = data.corner_px.tolist()
    alone = sum(corner_chi2(*board, camera, sigma) for board, sigma in zip(boards, sigmas, strict=True))
    lasers = range(len(fit.state.distance_m))
    numbers = sum(_numbers(data, laser) for laser in lasers)
    grown = fit.chi2 - alone
    if numbers <= 0 or grown < numbers + SIGNIFICANCE * np.sqrt(2 * numbers):
        return 1.0
    return grown / numbers


def laser_disagreements(data: JointData, fit: JointFit) -> tuple[float, ...]:
    """For each laser: what the squares lose without its stripes, over the numbers that it gives; NaN if it gives none.

    One laser whose plane disagrees with the boards that the others agree with stands out.
    """
    found = []
    for laser in range(len(fit.state.distance_m)):
        numbers = _numbers(data, laser)
        others = joint_fit(data.without_laser(laser), fit.state)
        found.append((fit.chi2 - others.chi2) / numbers if numbers > 0 else float("nan"))
    return tuple(found)


def _numbers(data: JointData, laser: int) -> int:
    """Numbers that a laser's stripes give beyond those that its plane takes."""
    return 2 * sum(len(own[laser]) > 0 for own in data.rays) - len(PLANE_PARAMETERS)


def _with_given_camera(fit: JointFit, given: Camera, excess: float, planes: int) -> Float64[Array, "n n"]:
    """The planes follow a camera that was wrong: their own errors, and those they have from it."""
    assert given.covariance is not None
    own = inverse_of_scaled(fit.information[:planes, :planes])
    by_camera = -own @ fit.information[:planes, planes:]
    cross = given.covariance.data @ by_camera.T
    return np.block([[given.covariance.data, cross], [cross.T, excess * own + by_camera @ cross]])


def _with_free_camera(fit: JointFit, given: Camera, excess: float, planes: int) -> Float64[Array, "n n"]:
    """Both as they come out of the fit with the camera's prior, in the order camera, planes."""
    information = fit.information / excess
    free = np.append(np.ones(planes, dtype=bool), free_parameters(given))
    prior = np.zeros_like(information)
    prior[planes:, planes:] = prior_information(given)
    information = np.where(np.outer(free, free), information + prior, 0.0)
    covariance = inverse_of_scaled(information)
    camera_first = np.roll(np.arange(len(covariance)), len(covariance) - planes)
    return covariance[np.ix_(camera_first, camera_first)]


COLUMNS = 9
"""Places along each stripe at which the depth is judged."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthUncertainty:
    """Standard deviation of depths along the stripe of each laser on a wall across the optical axis."""

    distances_m: tuple[float, ...]
    depth_sd_m: Float64[Array, "laser distance place"]
    """NaN where the stripe is out of the image."""

    @property
    def worst_m(self) -> Float64[Array, "laser distance"]:
        """The largest along each stripe; NaN where none of it is in the image."""
        filled = np.nan_to_num(self.depth_sd_m, nan=-1.0).max(axis=-1)
        return np.where(filled >= 0, filled, np.nan)


def depth_uncertainty(
    camera: Camera, lasers: LaserPlanes, covariance: ParameterCovariance, distances_m: tuple[float, ...]
) -> DepthUncertainty:
    """What the joint covariance of camera and planes means for triangulated depths (ringpose-method(7), section 1)."""
    by_laser = [
        [_depth_sd_m(camera, lasers, covariance, laser, distance_m) for distance_m in distances_m]
        for laser in range(len(lasers.names))
    ]
    return DepthUncertainty(distances_m=distances_m, depth_sd_m=np.array(by_laser))


def _depth_sd_m(
    camera: Camera, lasers: LaserPlanes, covariance: ParameterCovariance, laser: int, distance_m: float
) -> Float64[Array, "place"]:
    pixels = _stripe_px(camera, lasers.normal[laser], float(lasers.distance_m[laser]), distance_m)
    inside = np.isfinite(pixels).all(axis=1)
    sd = np.full(len(pixels), np.nan)
    if inside.any():
        jacobian = _depth_jacobian(camera, lasers, covariance.parameters, laser, pixels[inside])
        sd[inside] = np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance.data, jacobian).clip(0))
    return sd


def _stripe_px(
    camera: Camera, normal: Float64[Array, "xyz=3"], distance_m: float, wall_m: float
) -> Float64[Array, "place xy=2"]:
    """Pixels along the stripe on the wall z = wall_m, as far as they are in the image."""
    size = np.array([camera.image_width, camera.image_height])
    across = 1 if abs(normal[1]) >= abs(normal[0]) else 0
    edge = np.full((COLUMNS, 2), (size - 1) / 2)
    edge[:, 1 - across] = np.linspace(0, size[1 - across] - 1, COLUMNS)
    place = rays(edge, camera) * wall_m
    steep = normal[across]
    if abs(steep) < 1e-6:
        return np.full((COLUMNS, 2), np.nan)
    other = 1 - across
    place[:, across] = (distance_m - normal[other] * place[:, other] - normal[2] * wall_m) / steep
    pixels = project(place, camera)
    inside = np.all((pixels > -0.5) & (pixels < size - 0.5), axis=1)
    return np.where(inside[:, None], pixels, np.nan)


def _depth_jacobian(
    camera: Camera, lasers: LaserPlanes, parameters: tuple[str, ...], laser: int, pixels: Float64[Array, "n xy=2"]
) -> Float64[Array, "n parameter"]:
    """Derivative of z = d / (m . r), r = (x, y, 1), by the parameters: z / d for d, -z m . dr / (m . r) for the ray."""
    normal, distance_m = lasers.normal[laser], lasers.distance_m[laser]
    directions = rays(pixels, camera)
    points = intersect(directions, normal, np.array(float(distance_m)))
    cosine = directions @ normal
    by_plane = np.column_stack([-(points @ tilt_basis(normal).T), np.ones(len(points))]) / cosine[:, None]
    by_ray, by_camera = pixels_wrt_ray_and_camera(directions[:, :2], camera)
    ray_by_camera = -np.linalg.solve(by_ray, by_camera)
    depth_by_camera = -(points[:, 2] / cosine)[:, None] * np.einsum("i,nip->np", normal[:2], ray_by_camera)
    return _in_order(depth_by_camera, by_plane, parameters, lasers.names[laser])


def _in_order(
    by_camera: Float64[Array, "n camera"],
    by_plane: Float64[Array, "n plane=3"],
    parameters: tuple[str, ...],
    laser: str,
) -> Float64[Array, "n parameter"]:
    own = dict(zip(laser_parameters([laser]), by_plane.T, strict=True))
    own |= dict(zip(CAMERA_PARAMETERS, by_camera.T, strict=False))
    zero = np.zeros(len(by_plane))
    return np.column_stack([own.get(name, zero) for name in parameters])


RADII_M = (0.567, 0.597)
"""Of the ring whose centre is judged: the smaller of the paper's two."""


def ring_center_sd_m(
    camera: Camera, lasers: LaserPlanes, covariance: ParameterCovariance, distance_m: float
) -> Float64[Array, "xyz=3"]:
    """Standard deviations of the centre of a ring that faces the camera, its arc in the middle of the stripes.

    NaN where not all stripes cross the arc within the image. The closed form of method(7), section 4, in the ring's
    plane: how the most likely ring follows a wrong rig differs from it by a tenth at 1 m.
    """
    points, edges = _break_points_m(lasers, distance_m)
    laser = np.repeat(np.arange(len(lasers.names)), 2)
    pixels = project(points, camera)
    seen = np.all((pixels > -0.5) & (pixels < np.array([camera.image_width, camera.image_height]) - 0.5), axis=1)
    if not seen.all() or len(lasers.names) < 2:
        return np.full(3, np.nan)
    rig = Rig(camera=camera, lasers=lasers, covariance=covariance)
    by_rig = point_covariance(points, np.zeros((len(points), 2, 2)), laser, rig)
    _, jacobian = differentiated(points, edges, Method.PAPER_CONSTRAINED)
    deviation: Float64[Array, "xyz=3"] = np.sqrt(np.diag(pose_covariance(jacobian, by_rig).center_m2).clip(0))
    return deviation


def stripes_apart_m(lasers: LaserPlanes, distance_m: float) -> float:
    """How far the outermost stripes lie apart on a wall across the optical axis."""
    _, place, _ = _stripes(lasers, distance_m)
    return float(np.ptp(place))


def of_camera(covariance: ParameterCovariance) -> ParameterCovariance:
    """What of a joint covariance comes from the camera: its own, and the planes as they follow it."""
    plane = np.array(["." in name for name in covariance.parameters])
    follow = covariance.data[:, ~plane] @ np.linalg.pinv(covariance.data[np.ix_(~plane, ~plane)], hermitian=True)
    data = follow @ covariance.data[np.ix_(~plane, ~plane)] @ follow.T
    return ParameterCovariance(parameters=covariance.parameters, data=(data + data.T) / 2)


def _stripes(lasers: LaserPlanes, distance_m: float) -> tuple[int, Float64[Array, "laser"], Float64[Array, "laser"]]:
    """The camera's axis across the stripes, where they cross it on the wall z = distance_m, and their slopes there."""
    across = int(np.argmax(np.abs(lasers.normal[:, :2]).sum(axis=0)))
    steep = lasers.normal[:, across]
    place = (lasers.distance_m - lasers.normal[:, 2] * distance_m) / steep
    return across, place, -lasers.normal[:, 1 - across] / steep


def _break_points_m(
    lasers: LaserPlanes, distance_m: float
) -> tuple[Float64[Array, "point xyz=3"], Int64[Array, "point"]]:
    """Where the ring's edges cut the stripes on the wall; NaN where they do not.

    The ring's centre lies beside the axis by its mean radius, so that along the stripe x = p t + q, y of the ring's
    middle, (x - c)^2 + (y - y0)^2 = R^2 is quadratic in x.
    """
    across, place, slope = _stripes(lasers, distance_m)
    radius = np.tile(RADII_M, len(place))
    offset, slope = np.repeat(place - np.median(place), 2), np.repeat(slope, 2)
    side = float(np.mean(RADII_M))
    square, half = 1 + slope**2, slope * offset - side
    with np.errstate(invalid="ignore"):
        along = (-half - np.sqrt(half**2 - square * (side**2 + offset**2 - radius**2))) / square
    points = np.full((len(radius), 3), distance_m)
    points[:, 1 - across] = along
    points[:, across] = np.repeat(place, 2) + slope * along
    return points, np.tile([0, 1], len(place))
