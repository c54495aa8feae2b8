"""The lasers of each shot while a track assigns their stripes."""

from ringpose.capture.source import OFF_EVERY, TrackedSequence
from ringpose.types.session import parsed_sequence


def test_the_sequence_is_switched_until_the_lasers_are_assigned_and_shows_the_background_now_and_then():
    sequence, switched = TrackedSequence(), parsed_sequence("off,1,2,3,off")
    assert sequence(switched) == switched
    sequence.report(is_assigned=True)

    steps = [tuple(step.text for step in sequence(switched)) for _ in range(2 * OFF_EVERY)]

    assert steps == [*[("all",)] * (OFF_EVERY - 1), ("off", "all")] * 2
    sequence.report(is_assigned=False)
    assert sequence(switched) == switched
