"""The options of what is assumed about motion, ring and rig; the same in every command that estimates."""

from typing import Annotated

import typer

from ringpose.errors import UsageError
from ringpose.types.assumptions import MAX_TOLERANCE_M, AssumptionOptions

MAX_RATE_DEG_S = 720.0
"""Upper bound of a rate: no target turns twice a second."""

MAX_SPEED_M_S = 10.0
"""Upper bound of a speed; larger values are probably millimetres a second."""

MAX_STABILITY = 1e3
"""Upper bound of the factor: planes may then have moved by 6 degrees."""

Still = Annotated[bool, typer.Option("--still", help="The target does not move within a shot.")]
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
RingTolerance = Annotated[
    float | None,
    typer.Option(
        "--ring-tolerance",
        metavar="M",
        help="Standard deviation of the ring's edges from a circle, and of its face from a plane; default: 0.0001.",
    ),
]
RigStabilityFactor = Annotated[
    float,
    typer.Option(
        "--rig-stability", metavar="FACTOR", help="Factor on the rig's stability since its calibration; 0: unchanged."
    ),
]


def assumption_options(
    still: bool,
    max_speed_m_s: float | None,
    max_rate_deg_s: float | None,
    ring_tolerance_m: float | None,
    rig_stability: float,
) -> AssumptionOptions:
    """The options, checked."""
    given = {"--max-speed": max_speed_m_s, "--max-rate": max_rate_deg_s}
    for option, value in given.items():
        if still and value is not None:
            raise UsageError("--still", f"and {option} exclude each other", "leave one of them out")
    _check("--max-speed", max_speed_m_s, MAX_SPEED_M_S, "give metres a second")
    _check("--max-rate", max_rate_deg_s, MAX_RATE_DEG_S, "give degrees a second")
    _check("--ring-tolerance", ring_tolerance_m, MAX_TOLERANCE_M, "give metres")
    _check("--rig-stability", rig_stability, MAX_STABILITY, "give a factor, 1 for the stability in the rig file")
    return AssumptionOptions(
        still=still,
        max_speed_m_s=max_speed_m_s,
        max_rate_deg_s=max_rate_deg_s,
        ring_tolerance_m=ring_tolerance_m,
        rig_stability=rig_stability,
    )


def _check(option: str, value: float | None, limit: float, remedy: str) -> None:
    if value is not None and not 0 <= value < limit:
        raise UsageError(option, f"{value:g} is not a plausible value", remedy)
