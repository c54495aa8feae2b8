"""What the break points determine, and how well."""

import math

import numpy as np

from ringpose.kernels.forms import ClosedForm, nearest_plane
from ringpose.pose.uncertainty import PoseCovariance
from ringpose.types.arrays import Array, Float64
from ringpose.types.break_points import BreakPoints
from ringpose.types.ring_points import RingPoints
from ringpose.types.ring_pose import NoPose, PoseFlag

LASERS_ON_AN_EDGE = 3
"""A circle needs three points; the other edge then adds what it has."""

COLLINEAR_BELOW = 1e-6
"""Second over first singular value of the centred points; three points 10 mm apart on a 1.3 m ring have 2e-3."""

EDGE_ON_BELOW = 0.01
"""Sine of the angle at which the camera looks onto the ring's plane: 0.6 degrees, far less than any face shows."""

TILT_SD_LIMIT_RAD = 0.5
"""Standard deviation of the normal's direction (30 degrees) from which the points are a line within their errors.

Far below it the lever of the radius has made the centre weak, which is flagged.
"""

WEAK_SD = 0.05
"""Standard deviation of the centre, or of a radius, in radii, from which it is flagged as weak.

The centre follows from the height of the arc, and its distance is the inverse of that height. At 5 % the truth is
within 5 of the first-order standard deviations in all but one of 30 000 cases, at 10 % in all but one of 2000.
"""

OFF_PLANE = 0.01
"""Distance of the centre from the ring's plane, in radii, from which it is flagged as weak.

Method `paper` hardly enforces the plane: its centre then slides along the normal by decimetres, which no
first-order covariance tells; in-plane methods are never concerned.
"""


def why_undetermined(points: RingPoints, break_points: BreakPoints) -> NoPose | None:
    """Reason why these points determine no pose, or None.

    One break point that cannot be triangulated spoils all: it shows that a label is wrong, and a pose from the
    others would look right and be wrong.
    """
    seen = points.seen
    if (break_points.seen & ~seen).any():
        return NoPose.UNTRIANGULATED
    if max(map(sum, zip(*seen.tolist(), strict=True)), default=0) < LASERS_ON_AN_EDGE:
        return NoPose.TOO_FEW_BREAK_POINTS
    positions = points.position_m[seen]
    _, distance_m, singular_values = nearest_plane(positions)
    if singular_values[1] <= COLLINEAR_BELOW * singular_values[0]:
        return NoPose.COLLINEAR
    if abs(distance_m) < EDGE_ON_BELOW * math.hypot(*(positions.sum(axis=0) / len(positions)).tolist()):
        return NoPose.EDGE_ON
    return None


def why_unusable(residual_rms_px: float, covariance: PoseCovariance | None) -> NoPose | None:
    """Reason why a computed pose is none, or None."""
    if covariance is not None and standard_deviation(covariance.parameters[:2, :2]) > TILT_SD_LIMIT_RAD:
        return NoPose.COLLINEAR
    return None if math.isfinite(residual_rms_px) else NoPose.NOT_FINITE


def pose_flags(form: ClosedForm, covariance: PoseCovariance | None) -> PoseFlag:
    """What to mind about a pose (a batch of one); a damped centre is a weak one, whatever its covariance says."""
    radii_m = form.radius_m[0].tolist()
    flags = PoseFlag(0)
    if form.damped[0]:
        flags |= PoseFlag.DAMPED | PoseFlag.CENTER_WEAK | PoseFlag.RADIUS_WEAK
    if any(map(math.isnan, radii_m)):
        flags |= PoseFlag.RADIUS_WEAK
    smallest_m = min(radius_m for radius_m in radii_m if not math.isnan(radius_m))
    if abs(form.normal[0] @ form.center_m[0] - form.offset_m[0]) > OFF_PLANE * smallest_m:
        flags |= PoseFlag.CENTER_WEAK
    return flags if covariance is None else flags | _weak_flags(covariance, WEAK_SD * smallest_m)


def _weak_flags(covariance: PoseCovariance, limit_m: float) -> PoseFlag:
    """Which of centre and radii have a standard deviation over the limit."""
    flags = PoseFlag(0)
    if spreads_beyond(covariance.center_m2, limit_m):
        flags |= PoseFlag.CENTER_WEAK
    inner_m2, outer_m2 = covariance.parameters.diagonal().tolist()[5:]
    if inner_m2 > limit_m**2 or outer_m2 > limit_m**2:
        flags |= PoseFlag.RADIUS_WEAK
    return flags


def spreads_beyond(covariance: Float64[Array, "3 3"], limit: float) -> bool:
    """Whether the standard deviation is over the limit in some direction; mostly seen without eigenvalues.

    The largest variance is at least the largest on the diagonal, and at most their sum.
    """
    variances = covariance.diagonal().tolist()
    if max(variances) > limit**2:
        return True
    return not sum(variances) <= limit**2 and standard_deviation(covariance) > limit


def standard_deviation(covariance: Float64[Array, "n n"]) -> float:
    """In the direction in which it is largest."""
    if len(covariance) == 2:
        (first, mixed), (_, second) = covariance.tolist()
        return math.sqrt(max(0.5 * (first + second) + math.hypot(0.5 * (first - second), mixed), 0.0))
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
