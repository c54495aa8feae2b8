"""How well a ring's centre is known by a calibration alone, before any noise of the shot itself.

A ring amplifies what depths say: its short arc ends half a metre from its centre, and where its outer stripes seem
nearer than the one between them it seems tilted, by a multiple of that.
"""

import numpy as np

from ringpose.geometry.rays import project
from ringpose.pose.closed_form import differentiated, pose_covariance
from ringpose.pose.triangulation import point_covariance
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.options import Method
from ringpose.types.rig import LaserPlanes, Rig

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
