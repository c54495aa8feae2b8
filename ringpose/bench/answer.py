"""What was answered about one shot, as far as it can be compared with the truth."""

from dataclasses import dataclass

from jaxtyping import Float64

from ringpose.types.arrays import Array
from ringpose.types.ring_pose import NoPose, PoseFlag, RingPose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """One line of poses; what it does not say is None."""

    shot: str
    method: str
    flags: tuple[str, ...] = ()
    posed: bool = True
    """False for a line without a pose."""
    center_m: Float64[Array, "xyz=3"] | None = None
    normal: Float64[Array, "xyz=3"] | None = None
    radius_inner_m: float | None = None
    radius_outer_m: float | None = None
    grasp_m: Float64[Array, "xyz=3"] | None = None
    covariance: Float64[Array, "7 7"] | None = None
    """Of tilt_1, tilt_2, offset_m, center_1_m, center_2_m, radius_inner_m, radius_outer_m."""
    covariance_center_m2: Float64[Array, "3 3"] | None = None


def answer_of(shot: str, method: str, result: RingPose | NoPose | None) -> Answer:
    """The answer that a pose is; None where not even break points were found."""
    if not isinstance(result, RingPose):
        return Answer(shot=shot, method=method, posed=False)
    return Answer(
        shot=shot,
        method=method,
        flags=tuple(str(flag.name).lower() for flag in PoseFlag if flag in result.flags),
        center_m=result.center_m,
        normal=result.normal,
        radius_inner_m=_seen(result.radius_inner_m),
        radius_outer_m=_seen(result.radius_outer_m),
        grasp_m=result.grasp_m,
        covariance=result.covariance,
        covariance_center_m2=result.covariance_center_m2,
    )


def _seen(radius_m: float) -> float | None:
    return radius_m if radius_m == radius_m else None
