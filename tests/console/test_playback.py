"""How far the motion goes on while it plays, by a clock of the test."""

import numpy as np
import pytest

from ringpose.console.playback import IN_STEP, STEP_S, TYPING_S, Playback


def test_at_a_speed_the_motion_goes_on_with_the_clock_and_stands_while_it_does_not_play():
    playback = Playback()
    asked = [(10.0, "1"), (10.1, "1"), (10.3, "2"), (11.0, None), (11.1, "0.5")]

    steps = [playback.step_s(now_s, speed, is_measured=False) for now_s, speed in asked]

    np.testing.assert_allclose(steps, [0.0, 0.1, 0.4, 0.0, 0.05])


def test_in_step_the_motion_goes_on_when_its_state_has_been_measured():
    playback = Playback()
    measured = [True, False, False, True]

    steps = [playback.step_s(float(k), IN_STEP, is_measured=each) for k, each in enumerate(measured)]

    assert steps[1:] == [0.0, 0.0, STEP_S]


@pytest.mark.parametrize("speed", ["1", IN_STEP])
def test_after_the_time_was_set_it_stands_until_the_rest_can_be_typed(speed):
    playback = Playback()
    playback.step_s(0.0, speed, is_measured=True)
    playback.hold(0.5)
    playback.hold(1.0)  # the next digit

    assert playback.step_s(0.9 + TYPING_S, speed, is_measured=True) == 0.0
    assert playback.step_s(1.1 + TYPING_S, speed, is_measured=True) == pytest.approx(
        STEP_S if speed == IN_STEP else 0.1
    )
