"""Errors of the light planes over a stream of shots (ringpose-method(7), section 11).

A light plane that has moved leaves the same residuals in every shot, noise leaves other ones in each. From the shot on
in which the evidence (`ringpose.pose.plane_evidence`) shows a plane that has moved, the stream is measured with that
plane as estimated.
"""

from dataclasses import replace
from math import nan, sqrt

import numpy as np

from ringpose.geometry.rotations import tilt_basis, tilted
from ringpose.pose.plane_evidence import MovedPlane, RigEvidence
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import RigStability
from ringpose.types.pose import PoseFlag, PoseLine
from ringpose.types.rig import PLANE_PARAMETERS, PlaneCorrection, Rig

FORGETTING = 0.98
"""Weight of earlier shots in the share of contradictory ones: about fifty count."""

SHOTS_KEPT = 50
"""Number of last shots whose evidence counts."""

SHOTS_NEEDED = 10.0
"""No warning about contradictory shots is issued before this number of shots."""

SHOTS_TO_NAME = 4.0
"""Number of shots from which a plane that has moved is corrected."""

DOUBTED_FROM = 0.4
"""Share of contradictory shots without evidence from which the rig is reported as changed, whatever the others show."""

CONTRADICTED = "most of the last shots contradict one ring: a light plane or the camera has moved"
DISAGREES = "the stripes disagree with the rig: a light plane or the camera has moved"
"""Reasons of lines after a drift that is not explained by one plane."""

CONTRADICTORY = PoseFlag.STRIPE_REJECTED | PoseFlag.ASSIGNMENT_AMBIGUOUS | PoseFlag.INCONSISTENT
"""Flags of a shot whose stripes do not fit one ring as they were assigned."""


class DriftMonitor:
    """Accumulates the evidence of a stream of pose lines, and corrects the rig for a plane that has moved."""

    def __init__(self, rig: Rig, stability: RigStability) -> None:
        self.rig = rig
        """The rig for the next shot: a plane that has moved is where the stream shows it."""
        self._given, self._stability = rig, stability
        self._evidence = RigEvidence(rig, stability, SHOTS_KEPT)
        self._shots, self._doubted = 0.0, 0.0
        self._reason, self._corrected = "", False

    def update(self, line: PoseLine) -> tuple[PoseLine, str | None]:
        """The line with the lasers' health and the flag of a drift, and a warning where one is detected.

        Poses that contradict given radii contribute nothing; nor do the paper's methods, which have no residuals.
        """
        if line.pose is not None and line.priors is None:
            return line, None
        contradictory = bool(line.flags & CONTRADICTORY)
        line = self._flagged(line)  # before this shot is counted: it was measured with the rig as it was
        before = self._reason.partition(" by ")[0]
        if line.plane_evidence is not None:
            if PoseFlag.RADIUS_INCONSISTENT not in line.flags and self._evidence.add(line.plane_evidence):
                self._shots, self._doubted = FORGETTING * self._shots + 1.0, FORGETTING * self._doubted
        elif contradictory:
            self._shots, self._doubted = FORGETTING * self._shots + 1.0, FORGETTING * self._doubted + 1.0
        chi2 = self._evidence.chi2_of_planes()
        names = self.rig.lasers.names
        health = {name: sqrt(max(each, 0.0) / len(PLANE_PARAMETERS)) for name, each in zip(names, chi2, strict=True)}
        if not self._evidence.shots:
            health = dict.fromkeys(names, nan)
        line = replace(line, rig_health=health)
        self._judge(chi2, line)
        cause = self._reason.partition(" by ")[0]  # the figures change with every shot
        return line, self._reason if cause and cause != before else None

    def _flagged(self, line: PoseLine) -> PoseLine:
        """The line with the flags of a drift that was detected before it."""
        if not self._reason:
            return line
        flags = line.flags | PoseFlag.RIG_DRIFT
        if not self._corrected or PoseFlag.RIG_UNCHECKED in line.flags:
            flags |= PoseFlag.INCONSISTENT
        reason = "; ".join(filter(None, [line.reason, self._reason]))
        pose = None if line.pose is None else replace(line.pose, flags=line.pose.flags | flags)
        return replace(line, flags=flags, pose=pose, reason=reason)

    def _judge(self, chi2: Float64[Array, "laser"], line: PoseLine) -> None:
        """Name and correct a plane that has moved, or report that the rig has changed."""
        shots, evidence = self._shots, self._evidence
        if shots >= SHOTS_NEEDED and self._doubted > DOUBTED_FROM * shots:
            self._reason, self._corrected = CONTRADICTED, False
        elif chi2.max(initial=0.0) > evidence.limit:
            laser, turned = evidence.moved_laser(chi2)
            if laser is None:
                self._reason, self._corrected = DISAGREES, False
                return
            moved = evidence.moved_plane(laser)
            depth_m = 0.5 if line.plane_evidence is None else float(line.plane_evidence.place_m[2])
            self._reason = f"the light plane of laser {self.rig.lasers.names[laser]} {moved.description(depth_m)}"
            self._corrected = not turned and shots - self._doubted >= SHOTS_TO_NAME
            if self._corrected:
                self._correct(moved)
            elif turned:  # the middle of three planes hardly differs from a turn
                self._reason = f"{self._reason}, or the camera has turned"
        elif self._reason == CONTRADICTED and not self.rig.moved_planes:
            self._reason = (
                ""  # contradictory shots are over; what the evidence has shown holds until the rig is updated
            )

    def _correct(self, moved: MovedPlane) -> None:
        """Measure the next shots with the plane as estimated, with its covariance instead of the calibration's."""
        lasers, laser, given = self.rig.lasers, moved.laser, self._given.lasers
        normal, distance_m = lasers.normal.copy(), lasers.distance_m.copy()
        normal[laser] = tilted(normal[laser], moved.change[:2])
        distance_m[laser] += moved.change[2]
        tilts = tilt_basis(given.normal[laser]) @ normal[laser] / (given.normal[laser] @ normal[laser])
        correction = PlaneCorrection(
            change=np.append(tilts, distance_m[laser] - given.distance_m[laser]), covariance=moved.covariance
        )
        self.rig = replace(
            self.rig,
            lasers=replace(lasers, normal=normal, distance_m=distance_m),
            moved_planes={**self.rig.moved_planes, lasers.names[laser]: correction},
        )
        self._evidence = RigEvidence(self.rig, self._stability, SHOTS_KEPT)
