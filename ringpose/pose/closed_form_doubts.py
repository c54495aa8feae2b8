"""What the break points determine in closed form, and what to mind about it."""

import math

from ringpose.kernels.forms import ClosedForm, nearest_plane
from ringpose.pose.observability import (
    EDGE_ON_BELOW,
    TILT_SD_LIMIT_RAD,
    WEAK_SD,
    spreads_beyond,
    standard_deviation,
)
from ringpose.pose.uncertainty import PoseCovariance
from ringpose.types.break_points import BreakPoints
from ringpose.types.ring_points import RingPoints
from ringpose.types.ring_pose import NoPose, PoseFlag

LASERS_ON_AN_EDGE = 3
"""A circle needs three points; the other edge then adds what it has."""

COLLINEAR_BELOW = 1e-6
"""Second over first singular value of the centred points; three points 10 mm apart on a 1.3 m ring have 2e-3."""

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
