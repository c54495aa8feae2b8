"""(answers, truth) -> one score a shot and method, and how the two were matched."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from ringpose.bench.score import Answer, Score, score
from ringpose.types.camera import Camera
from ringpose.types.truth import Truth


@dataclass(frozen=True, slots=True, kw_only=True)
class Matching:
    """Which pose lines belong to which truths."""

    truths: int
    matched: int
    """Shots of the truth that have a line."""
    without_truth: tuple[str, ...]
    """Shots that have a line but no truth, each once."""
    repeated: tuple[str, ...]
    """Shots with more than one line of one method; the last line is scored."""
    unsorted: bool
    """Whether the shots are in another order than in the truth; this changes no figure."""


def scores(answers: Iterable[Answer], truths: Sequence[Truth], camera: Camera | None) -> list[Score]:
    """Every true shot, for every method that answered, in the order of the truth; a shot without a line is lost."""
    by_method = _by_method(answers)
    return [
        score(truth, by_shot.get(truth.shot), method, camera)
        for method, by_shot in by_method.items()
        for truth in truths
    ]


def matching(answers: Sequence[Answer], truths: Iterable[Truth]) -> Matching:
    """How pose lines and truths were matched by the names of their shots."""
    place = {truth.shot: number for number, truth in enumerate(truths)}
    lines = Counter((answer.method, answer.shot) for answer in answers)
    shots = list(dict.fromkeys(answer.shot for answer in answers))
    places = [place[shot] for shot in shots if shot in place]
    return Matching(
        truths=len(place),
        matched=len(places),
        without_truth=tuple(shot for shot in shots if shot not in place),
        repeated=tuple(dict.fromkeys(shot for (_, shot), count in lines.items() if count > 1)),
        unsorted=places != sorted(places),
    )


def _by_method(answers: Iterable[Answer]) -> Mapping[str, Mapping[str, Answer]]:
    """The answers of each method by shot; lines without a pose may not name their method."""
    every = list(answers)
    methods = list(dict.fromkeys(answer.method for answer in every if answer.method)) or [""]
    table: dict[str, dict[str, Answer]] = {method: {} for method in methods}
    for answer in every:
        for method in [answer.method] if answer.method else methods:
            table[method][answer.shot] = replace(answer, method=method)
    return table
