"""What a pose assumes about the target's motion, the ring's form and the rig."""

from dataclasses import dataclass
from math import radians
from typing import Annotated

from ringpose.types import plausible
from ringpose.types.record import Key

RISK = 1e-5
"""Default probability with which an error may exceed its protection level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionPrior:
    """Standard deviations per axis of the ring centre's velocity and of its angular velocity."""

    speed_sd_m_s: Annotated[float, Key("Of the velocity of the ring's centre.", least=0.0)]
    rate_sd_rad_s: Annotated[float, Key("Of its angular velocity.", least=0.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class RigStability:
    """Standard deviations of the rig's parameters since its calibration (ringpose-method(7), section 11)."""

    plane_tilt_rad: Annotated[
        float, Key("Of the tilts of a light plane.", plausible=plausible.STABILITY_TILT_RAD, needed=True)
    ] = 0.0
    plane_distance_m: Annotated[
        float, Key("Of its distance.", plausible=plausible.STABILITY_DISTANCE_M, needed=True)
    ] = 0.0
    focal_ratio: Annotated[
        float, Key("Of the focal length, as a share.", plausible=plausible.STABILITY_FOCAL, needed=True)
    ] = 0.0

    def scaled(self, factor: float) -> "RigStability":
        """The standard deviations times a factor."""
        return RigStability(
            plane_tilt_rad=factor * self.plane_tilt_rad,
            plane_distance_m=factor * self.plane_distance_m,
            focal_ratio=factor * self.focal_ratio,
        )


TYPICAL_STABILITY = RigStability(plane_tilt_rad=1e-4, plane_distance_m=2e-5, focal_ratio=1e-4)
"""Stability of a rig whose file does not state its own: what temperature does to a light plane and a lens."""

MAX_SPEED_M_S, MAX_RATE_DEG_S = 0.05, 5.0
"""Two standard deviations of the default motion prior: what a dead satellite does."""

RING_TOLERANCE_M = 1e-4
"""Default standard deviation of a ring's edge from a circle, and of its face from a plane."""


def motion_prior(max_speed_m_s: float = MAX_SPEED_M_S, max_rate_deg_s: float = MAX_RATE_DEG_S) -> MotionPrior:
    """The prior whose two standard deviations per axis are these limits."""
    return MotionPrior(speed_sd_m_s=max_speed_m_s / 2, rate_sd_rad_s=radians(max_rate_deg_s) / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumptions:
    """Standard deviations of what a shot does not measure; the defaults leave image noise and calibration errors."""

    motion: Annotated[MotionPrior | None, Key("As `priors` of a pose line.", needed=True, words={None: "still"})] = None
    """None if the target is assumed to be still within a shot."""
    ring_tolerance_m: Annotated[float, Key("As `priors` of a pose line.", needed=True, least=0.0)] = 0.0
    stability: Annotated[RigStability, Key("As `priors.rig` of a pose line.", needed=True)] = RigStability()
    face_slope_rad: Annotated[float, Key("As `priors` of a pose line.", added=True, least=0.0)] = 0.0
    """Of the angle between the face, which may be conical, and the ring's plane."""


IDEAL = Assumptions()
"""A still target, a perfect ring, and a rig that has not changed since its calibration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AssumptionOptions:
    """What a user states about motion, ring and rig; None where the default of each shot is to be used."""

    still: bool = False
    max_speed_m_s: float | None = None
    """Two standard deviations per axis of the ring centre's velocity."""
    max_rate_deg_s: float | None = None
    """Two standard deviations per axis of the angular velocity."""
    ring_tolerance_m: float | None = None
    rig_stability: float = 1.0
    """Factor on the stability of the rig."""
    face_slope_deg: float = 0.0
    """Standard deviation of the slope of the ring's face."""
    risk: float = RISK
    """Probability with which an error may exceed its protection level."""

    def about_shot(self, stability: RigStability, *, still: bool) -> Assumptions:
        """The assumptions about a shot by a rig of this stability; `still`: whether the shot states that it was."""
        moving = self.max_speed_m_s is not None or self.max_rate_deg_s is not None
        motion = None
        if not self.still and (moving or not still):
            motion = motion_prior(
                MAX_SPEED_M_S if self.max_speed_m_s is None else self.max_speed_m_s,
                MAX_RATE_DEG_S if self.max_rate_deg_s is None else self.max_rate_deg_s,
            )
        tolerance_m = RING_TOLERANCE_M if self.ring_tolerance_m is None else self.ring_tolerance_m
        return Assumptions(
            motion=motion,
            ring_tolerance_m=tolerance_m,
            stability=stability.scaled(self.rig_stability),
            face_slope_rad=radians(self.face_slope_deg),
        )


USUAL = AssumptionOptions()
"""The defaults."""

NOISE_ONLY = AssumptionOptions(still=True, ring_tolerance_m=0.0, rig_stability=0.0)
"""Nothing but image noise and the errors of the calibration, as for Cramer-Rao bounds."""
