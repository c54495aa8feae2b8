"""Limits on errors and counts, and the messages about those that are exceeded."""

import math
from collections.abc import Mapping, Sequence

from ringpose.bench.score import Judgement, Outcome
from ringpose.bench.summary import Summary


def error_limits(
    center_mm: float | None, normal_deg: float | None, radius_mm: float | None, grasp_mm: float | None
) -> dict[str, float]:
    """Limits on RMSEs by the names of `QUANTITIES`, in metres and radians, without those that are None."""
    wanted = {
        "center_m": (center_mm, 1e-3),
        "normal_rad": (normal_deg, math.pi / 180),
        "radius_inner_m": (radius_mm, 1e-3),
        "radius_outer_m": (radius_mm, 1e-3),
        "grasp_m": (grasp_mm, 1e-3),
    }
    return {name: value * unit for name, (value, unit) in wanted.items() if value is not None}


def exceeded_error_limits(summaries: Sequence[Summary], limits: Mapping[str, float]) -> list[str]:
    """A message for each group whose RMSE exceeds a limit, and for each limit to which no group has an error."""
    sentences = []
    for name, limit in limits.items():
        held = [line for line in summaries if name in line.errors]
        if not held:
            sentences.append(f"{name}: no shot has such an error, limit {limit:.4g}")
        sentences += [
            f"{name}: RMSE {line.errors[name].rmse:.4g} of {_group(line)} exceeds {limit:.4g}"
            for line in held
            if line.errors[name].rmse > limit
        ]
    return sentences


def exceeded_count_limits(summaries: Sequence[Summary], missed: int | None, wrong: int | None) -> list[str]:
    """A message for each method with more missed and lost shots, or more wrong quantities, than the limits."""
    sentences = []
    for line in summaries:
        if line.group:
            continue
        lost = line.outcomes[Outcome.MISSED] + line.outcomes[Outcome.LOST]
        if missed is not None and lost > missed:
            sentences.append(f"missed and lost: {lost} shots of {_group(line)} exceed {missed}")
        off = line.wrong.count(Judgement.WRONG)
        if wrong is not None and off > wrong:
            sentences.append(f"wrong: {off} quantities of {_group(line)} exceed {wrong}")
    return sentences


def _group(line: Summary) -> str:
    named = ", ".join(f"{key} {value}" for key, value in line.group.items()) or "all shots"
    return f"{named} ({line.method})" if line.method else named
