"""Keeps an eye on the rig while poses go by, and says what there is to say about them."""

from dataclasses import replace

from ringpose.cli import messages
from ringpose.pose.drift import advice, drift_warning, health_after, new_health
from ringpose.types.options import Method
from ringpose.types.pose import PoseFlag, PoseLine


class DriftMonitor:
    """Carries the lasers' health from line to line, and warns once of each drift."""

    def __init__(self, names: tuple[str, ...], method: Method) -> None:
        self._names = names
        self._method = method
        self._health = new_health(len(names))
        self._warned = False

    def watched(self, line: PoseLine) -> PoseLine:
        """The line with the lasers' health; one without a pose, or of another ring than was said, tells nothing new."""
        if self._method is not Method.ML:
            return line
        if line.pose is not None and PoseFlag.RADIUS_DISAGREES not in line.pose.flags:
            self._health = health_after(self._health, line.pose.plane_evidence)
            self._warn(line.shot)
        figures = dict(zip(self._names, self._health.figure.tolist(), strict=True))
        return replace(line, laser_health=figures)

    def _warn(self, shot: str) -> None:
        """Once, until the rig is well again."""
        warning = drift_warning(self._health, self._names)
        if warning is not None and not self._warned:
            messages.say(f"{shot}: {warning}; run ringpose calibrate-planes")
        self._warned = warning is not None


def remarks_on(line: PoseLine) -> str:
    """Status, what is wrong and what would help, for the user who wants to know."""
    said = [line.reason or "", ", ".join(line.flags), "" if line.pose is None else advice(line.pose)]
    return "; ".join(each for each in said if each) or line.status
