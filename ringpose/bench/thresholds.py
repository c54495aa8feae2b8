"""What must not be exceeded."""

from collections.abc import Mapping, Sequence

from ringpose.bench.score import Outcome
from ringpose.bench.summary import Summary


def missed_error_limits(summaries: Sequence[Summary], limits: Mapping[str, float]) -> list[str]:
    """A sentence for each limit on an RMSE that a group exceeds, and for each that no group could be held to."""
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


def missed_count_limits(summaries: Sequence[Summary], limits: Mapping[tuple[Outcome, ...], int]) -> list[str]:
    """A sentence for each method with more shots of some outcomes than allowed, all groups together."""
    return [
        f"{' and '.join(outcomes)}: {count} shots of {_group(line)} exceed {limit}"
        for outcomes, limit in limits.items()
        for line in summaries
        if not line.group and (count := sum(line.outcomes[outcome] for outcome in outcomes)) > limit
    ]


def _group(line: Summary) -> str:
    named = ", ".join(f"{key} {value}" for key, value in line.group.items()) or "all shots"
    return f"{named} ({line.method})" if line.method else named
