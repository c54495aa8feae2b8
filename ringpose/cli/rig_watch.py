"""Keeps an eye on the rig while poses go by, and says what there is to say about them."""

from dataclasses import replace

from ringpose.cli import messages
from ringpose.pose.advice import advice
from ringpose.pose.health import drift_warning, health_after, new_health
from ringpose.pose.method import Method
from ringpose.types.pose_line import PoseLine
from ringpose.types.ring_pose import PoseFlag


class RigWatch:
    """Carries the lasers' health from line to line, and warns once of each drift."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._health = new_health(len(names))
        self._warned = False

    def watched(self, line: PoseLine) -> PoseLine:
        """The line with the lasers' health."""
        if line.pose is None or line.pose.method != Method.ML or PoseFlag.RADIUS_DISAGREES in line.pose.flags:
            return line
        self._health = health_after(self._health, line.pose.plane_evidence)
        warning = drift_warning(self._health, self._names)
        if warning is not None and not self._warned:
            messages.say(f"{line.shot}: {warning}; run ringpose calibrate-planes")
        self._warned = warning is not None
        figures = dict(zip(self._names, self._health.figure.tolist(), strict=True))
        return replace(line, laser_health=figures)


def remarks_on(line: PoseLine) -> str:
    """Status, what is wrong and what would help, for the user who wants to know."""
    said = [line.reason or "", ", ".join(line.flags), "" if line.pose is None else advice(line.pose)]
    return "; ".join(each for each in said if each) or line.status
