"""The lasers of each shot while a track may assign their stripes: all in every frame, else one after the other."""

from ringpose.types.session import Step

OFF_EVERY = 10
"""Number of shots with all lasers on for each frame without lasers, which shows the background."""

ALL, OFF = Step("all"), Step("off")


class TrackedSequence:
    """Chooses the steps of each shot by what the track has last reported.

    A frame with all lasers on has a single time, so that the target does not move within it.
    """

    def __init__(self) -> None:
        self._is_assigned = False
        self._since_off = 0

    def report(self, *, is_assigned: bool) -> None:
        """Whether the track will assign the stripes of the next frame with all lasers on; from any thread."""
        self._is_assigned = is_assigned

    def __call__(self, switched: tuple[Step, ...]) -> tuple[Step, ...]:
        """The steps of the next shot; `switched` are those of a shot in which the frames tell the lasers apart."""
        if not self._is_assigned:
            self._since_off = 0  # switched shots begin and end without lasers
            return switched
        self._since_off += 1
        if self._since_off < OFF_EVERY:
            return (ALL,)
        self._since_off = 0
        return (OFF, ALL)
