"""The options of what is assumed about motion, ring and rig; the same in every command that estimates."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import typer

from ringpose.cli.app import ASSUMED, check_plausible
from ringpose.errors import UsageError
from ringpose.types.assumptions import AssumptionOptions
from ringpose.types.plausible import FACE_SLOPE_DEG, MAX_RATE_DEG_S, RING_TOLERANCE_M, SPEED_M_S, STABILITY_FACTOR

MaxSpeed = Annotated[
    float | None,
    typer.Option(
        "--max-speed",
        metavar="M_PER_S",
        help="Two standard deviations, per axis, of the velocity of the ring's centre; default: 0.05.",
    ),
]
MaxRate = Annotated[
    float | None,
    typer.Option(
        "--max-rate",
        metavar="DEG_PER_S",
        help="Two standard deviations, per axis, of the ring's angular velocity; default: 5.",
    ),
]


@dataclass(frozen=True, slots=True)
class Assumed:
    """The options of what a pose assumes, as given; None where the default of each shot is used."""

    PURPOSE: ClassVar = ASSUMED

    still: Annotated[bool, typer.Option("--still", help="The target does not move within a shot.")] = False
    max_speed: MaxSpeed = None
    max_rate: MaxRate = None
    ring_tolerance: Annotated[
        float | None,
        typer.Option(
            "--ring-tolerance",
            metavar="M",
            help="Standard deviation of the ring's edges from a circle, and of its face from a plane; default: 0.0001.",
        ),
    ] = None
    rig_stability: Annotated[
        float,
        typer.Option(
            "--rig-stability",
            metavar="FACTOR",
            help="Factor on the rig's stability since its calibration; 0: unchanged.",
        ),
    ] = 1.0

    face_slope: Annotated[
        float,
        typer.Option(
            "--face-slope",
            metavar="DEG",
            help="Standard deviation of the slope of the ring's face, which may be conical.",
        ),
    ] = 0.0

    @property
    def options(self) -> AssumptionOptions:
        """The options, checked."""
        for option, given in (("--max-speed", self.max_speed), ("--max-rate", self.max_rate)):
            if self.still and given is not None:
                raise UsageError("--still", f"and {option} exclude each other", "leave one of them out")
        check_plausible("--max-speed", self.max_speed, SPEED_M_S)
        check_plausible("--max-rate", self.max_rate, MAX_RATE_DEG_S)
        check_plausible("--ring-tolerance", self.ring_tolerance, RING_TOLERANCE_M)
        check_plausible("--rig-stability", self.rig_stability, STABILITY_FACTOR)
        check_plausible("--face-slope", self.face_slope, FACE_SLOPE_DEG)
        return AssumptionOptions(
            still=self.still,
            max_speed_m_s=self.max_speed,
            max_rate_deg_s=self.max_rate,
            ring_tolerance_m=self.ring_tolerance,
            rig_stability=self.rig_stability,
            face_slope_deg=self.face_slope,
        )
