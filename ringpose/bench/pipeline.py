"""(answers, truth) -> one score a shot and method."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from ringpose.bench.answer import Answer
from ringpose.bench.score import Score, score
from ringpose.types.camera import Camera
from ringpose.types.truth import Truth


def scores(answers: Iterable[Answer], truths: Sequence[Truth], camera: Camera | None) -> list[Score]:
    """Every true shot, for every method that answered, in the order of the truth; a shot without a line is lost."""
    by_method = _by_method(answers)
    return [
        score(truth, by_shot.get(truth.shot), method, camera)
        for method, by_shot in by_method.items()
        for truth in truths
    ]


def without_truth(answers: Iterable[Answer], truths: Iterable[Truth]) -> list[str]:
    """Shots that were answered though no truth is known of them, in their order, each once."""
    known = {truth.shot for truth in truths}
    return list(dict.fromkeys(answer.shot for answer in answers if answer.shot not in known))


def answered_twice(answers: Iterable[Answer]) -> list[str]:
    """Shots with more than one line of one method; the last line is the one that is scored."""
    seen: set[tuple[str, str]] = set()
    twice: dict[str, None] = {}
    for answer in answers:
        if (answer.method, answer.shot) in seen:
            twice[answer.shot] = None
        seen.add((answer.method, answer.shot))
    return list(twice)


def _by_method(answers: Iterable[Answer]) -> Mapping[str, Mapping[str, Answer]]:
    """The answers of each method by shot; lines without a pose may not name their method."""
    every = list(answers)
    methods = list(dict.fromkeys(answer.method for answer in every if answer.method)) or [""]
    table: dict[str, dict[str, Answer]] = {method: {} for method in methods}
    for answer in every:
        for method in [answer.method] if answer.method else methods:
            table[method][answer.shot] = replace(answer, method=method)
    return table
