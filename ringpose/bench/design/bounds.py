"""Cramér-Rao bounds: the smallest errors that a rig, a ring and its place allow (ringpose-method(7), section 14).

The Fisher information is that of the measurements at the true ring, on both arcs, by features without errors that have
the covariances of detected ones. Errors of the rig are nuisance parameters, whose prior is the covariance in rig.yaml
plus that of its stability.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from ringpose.estimate.covariance import GRASP_UNKNOWN_FROM_M, WEAK_SD, exceeds_sd
from ringpose.estimate.linearization import PARAMETERS
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import BreakPoints, Detection
from ringpose.types.pose import PoseFlag, PoseLine, PoseResult, RingPose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bound:
    """Smallest covariances of an unbiased estimator, camera frame, for a ring without motion."""

    parameters: Float64[Array, "7 7"]
    """Covariance of the first seven `MEASURED_PARAMETERS`."""
    center_m2: Float64[Array, "3 3"]

    @property
    def center_sd_m(self) -> float:
        """Root of the mean square length of the centre's error."""
        return sqrt(float(np.trace(self.center_m2)))

    @property
    def normal_sd_rad(self) -> float:
        """Root of the mean square angle of the normal's error."""
        return sqrt(float(np.trace(self.parameters[:2, :2])))

    @property
    def radius_outer_sd_m(self) -> float:
        """Standard deviation of the outer radius."""
        return sqrt(float(self.parameters[6, 6]))

    @property
    def standard_deviations(self) -> dict[str, float]:
        """The three standard deviations of this bound, keyed by the names of the errors that they bound."""
        return {
            "center_m": self.center_sd_m,
            "normal_rad": self.normal_sd_rad,
            "radius_outer_m": self.radius_outer_sd_m,
        }


def determined_quantities(
    exact: Detection, line: PoseLine, bound: Bound | None, radius_inner_m: float
) -> tuple[str, ...]:
    """Which of `center` and `grasp` a shot determines within the limits from which `pose` flags them.

    `exact` are its features without errors, `line` is the pose from these: the grasp point is also determined where a
    bound of all parameters does not exist, by its stated covariance, if the shot shows that it is on a ring. Edges that
    may be straight flag either of them.
    """
    grasp_m2 = None if line.pose is None else line.pose.covariance_grasp_m2
    of_center = bound is not None and not exceeds_sd(bound.center_m2, WEAK_SD * radius_inner_m)
    of_center = of_center and PoseFlag.CENTER_WEAK not in line.flags
    of_grasp = grasp_m2 is not None and not exceeds_sd(grasp_m2, GRASP_UNKNOWN_FROM_M)
    of_grasp = of_grasp and PoseFlag.GRASP_WEAK not in line.flags
    of_grasp = of_grasp and shows_a_ring(exact, has_radii=line.priors is not None and line.priors.radius is not None)
    return tuple(name for name, is_known in (("center", of_center), ("grasp", of_grasp)) if is_known)


def shows_a_ring(exact: Detection, *, has_radii: bool) -> bool:
    """Whether a shot has a number that could contradict a ring: else what it shows may be any surface.

    A stripe's line and its two ends are four numbers, of as many unknowns: the plane's distance and slope along the
    stripe, the place of the ends on it and the width between them. A bar, a board or a part of the body has such ends,
    too. Visible edges, a second stripe with both ends, or the ends on both arcs with given radii have more numbers than
    unknowns. Without radii, ends of one stripe on both arcs are also those of two bars of equal width.
    """
    points = exact.break_points
    if not isinstance(points, BreakPoints):
        return False
    if exact.ring_edges is not None and len(exact.ring_edges.edge):
        return True
    seen = np.array([arc.seen for arc in points.arcs])
    numbers = 2 * int(seen.any(axis=(0, 2)).sum()) + int(seen.sum()) + 2 * has_radii
    return numbers > PARAMETERS


def cramer_rao(line: PoseLine | PoseResult) -> Bound | None:
    """The Cramér-Rao bound of a ring from its pose, estimated under `NOISE_ONLY` from features without errors.

    It is the covariance of that pose, as all residuals are zero and no feature is rejected: the inverse of Fisher's
    matrix over both arcs, with the priors of the rig's covariance and of given radii. `measurement` would not do, which
    leaves out the opposite arc for the sake of tracks. None if the features do not determine every parameter.
    """
    pose, priors = line.pose, line.priors
    if not isinstance(pose, RingPose) or priors is None or priors.regularization is not None:
        return None  # weak priors have moved the ring away from the true one
    parameters, center_m2 = pose.covariance, pose.covariance_center_m2
    if parameters is None or center_m2 is None or not (np.isfinite(parameters).all() and np.isfinite(center_m2).all()):
        return None
    return Bound(parameters=parameters, center_m2=center_m2)
