"""Stripes as points in space, with covariances."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.options import PoseFrame
from ringpose.types.record import Form, Key


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripePoints:
    """Points where the light of lasers meets a surface, in the order of the stripes' pieces and columns."""

    position_m: Annotated[Float64[Array, "point xyz=3"], Key("Position at the time of its frame.")]
    covariance_m2: Annotated[
        Float64[Array, "point xyz=3 xyz=3"],
        Key(
            "Covariance of the position: that of `noise_m`, which is the point's own, and that of the errors that "
            "points have in common: of camera and light planes, with their stability, and in the frames tool and base "
            "of the mount and the robot's poses. Null where the stripe's standard deviation is unknown.",
            gaps=True,
        ),
    ]
    noise_m: Annotated[
        Float64[Array, "point xyz=3"],
        Key(
            "Displacement of the point by one standard deviation of its stripe's centre, along its ray's light plane. "
            "Centres within a grain of speckle, a few columns, share this error; further ones are independent.",
            gaps=True,
        ),
    ]
    intensity_dn: Annotated[
        Float64[Array, "point"], Key("Grey value of the stripe over the background, at its centre.", gaps=True)
    ]
    laser: Annotated[Int64[Array, "point"], Key("Number of the laser, from 0: a place in `lasers`.", least=0)]
    stamp_s: Annotated[
        Float64[Array, "point"], Key("Mid exposure of the frame that shows it; null if it is unknown.", gaps=True)
    ]
    position_px: Annotated[Float64[Array, "point xy=2"], Key("The stripe's centre in the image, distorted.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """Centres of stripes that gave no point, by the reason."""

    laser_unknown: Annotated[
        int,
        Key(
            "In frames with several lasers on, those beside the stripes on the ring's face, or on the stripes of two "
            "lasers: which laser they belong to is not known.",
            least=0,
        ),
    ] = 0
    no_intersection: Annotated[
        int, Key("Those whose rays meet their light plane behind the camera: reflections.", least=0)
    ] = 0
    no_robot_pose: Annotated[int, Key("Those at whose time the robot's pose is not known.", least=0)] = 0

    @property
    def total(self) -> int:
        """Their number."""
        return self.laser_unknown + self.no_intersection + self.no_robot_pose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShotPoints:
    """The points of one shot."""

    software: Annotated[str, Key("Program and version that wrote the record.", null="", added=True)] = ""
    shot: Annotated[str, Key("As in the pose line.")]
    stamp_s: Annotated[float, Key("As in the pose line.", null=math.nan)]
    frame: Annotated[PoseFrame, Key("Frame of the vectors: `camera`, `tool` or `base`.")]
    lasers: Annotated[tuple[str, ...], Key("Names of the rig's lasers.", form=Form.DISTINCT)]
    points: Annotated[StripePoints, Key("The points; lists of the same length, which may be 0.")]
    left_out: Annotated[LeftOut, Key("How many centres of stripes gave no point.")]
    calibration_covariance: Annotated[
        bool,
        Key(
            "Whether the covariances include that of the calibration of camera and light planes: false if the rig file "
            "has none, so that the points are less accurate than they state."
        ),
    ]
    rig: Annotated[str, Key("SHA-256 of the rig file.", null="", pattern="^[0-9a-f]{64}$")] = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointCloud:
    """Points of several shots, without their covariances, for a picture."""

    frame: PoseFrame
    shots: tuple[str, ...]
    position_m: Float64[Array, "point xyz=3"]
    laser: Int64[Array, "point"]
    shot: Int64[Array, "point"]
    """Number of the point's shot, from 0: a place in `shots`."""
    thinned_by: int = 1
    """One point of so many is there."""


NO_POINTS = StripePoints(
    position_m=np.zeros((0, 3)),
    covariance_m2=np.zeros((0, 3, 3)),
    noise_m=np.zeros((0, 3)),
    intensity_dn=np.zeros(0),
    laser=np.zeros(0, dtype=np.int64),
    stamp_s=np.zeros(0),
    position_px=np.zeros((0, 2)),
)
