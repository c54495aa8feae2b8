"""How far the motion goes on while it plays."""

import numpy as np

SPEEDS, IN_STEP = ("0.25", "0.5", "1", "2", "4"), "each shot measured"
"""Seconds of the motion in a second; in step, the time advances by `STEP_S` when its state has been measured."""

STEP_S = 0.2

TYPING_S = 2.0
"""Time for which the motion waits after the time was set, as the rest of a number may still be typed."""


class Playback:
    """Computes by how much the time advances; `step_s` is called at short intervals."""

    def __init__(self) -> None:
        self._asked_s = self._held_until_s = -np.inf

    def hold(self, now_s: float) -> None:
        """Stop the motion for `TYPING_S` because the user has set the time."""
        self._held_until_s = now_s + TYPING_S

    def step_s(self, now_s: float, speed: str | None, *, is_measured: bool) -> float:
        """Time by which the motion goes on since the last call; `speed` is None while it does not play."""
        since_s = now_s - max(self._asked_s, self._held_until_s)
        self._asked_s = now_s
        if speed is None or since_s < 0 or not np.isfinite(since_s):
            return 0.0
        if speed == IN_STEP:
            return STEP_S if is_measured else 0.0
        return since_s * float(speed)
