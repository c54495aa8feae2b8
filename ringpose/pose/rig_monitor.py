"""What a stream of shots shows: light planes that have moved, and a ring that is not round (method(7), 11 and 12).

A light plane that has moved leaves the same residuals in every shot, noise leaves other ones in each. Each shot
contributes the Schur complement of its own parameters in the information matrix of section 9: rows A q = y in the
errors q of the rig, and in the form of the ring, which shots of the same arc have in common. For each plane, the
likelihood that it has moved is compared with the likelihood of a rig within its calibration and stability. From the
shot on in which a plane is shown to have moved, the stream is measured with that plane as estimated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees, hypot, log, nan, sqrt

import numpy as np

from ringpose.estimate.nuisance import FORM_PARAMETERS, light_plane_bases, total_covariance
from ringpose.estimate.ring_estimate import chi2_quantile
from ringpose.geometry.rotations import tilt_basis, tilted
from ringpose.measure.status import sentences, with_findings
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.assumptions import TYPICAL_STABILITY, RigStability
from ringpose.types.finding import NOTHING, Finding
from ringpose.types.pose import PlaneEvidence, PoseFlag, PoseLine
from ringpose.types.rig import PLANE_PARAMETERS, PlaneCorrection, Rig, laser_parameters

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
        self._drift, self._corrected = Drift(), False

    def update(self, line: PoseLine) -> tuple[PoseLine, str | None]:
        """The line with the lasers' health and the flag of a drift, and a warning where one is detected.

        Poses that contradict given radii contribute nothing; nor do the paper's methods, which have no residuals.
        """
        if line.pose is not None and line.priors is None:
            return line, None
        contradictory = bool(line.flags & CONTRADICTORY)
        line = self._flagged(line)  # before this shot is counted: it was measured with the rig as it was
        before = self._drift.cause
        if line.plane_evidence is not None:
            if PoseFlag.RADIUS_INCONSISTENT not in line.flags and self._evidence.add(line.plane_evidence):
                self._shots, self._doubted = FORGETTING * self._shots + 1.0, FORGETTING * self._doubted
        elif contradictory:
            self._shots, self._doubted = FORGETTING * self._shots + 1.0, FORGETTING * self._doubted + 1.0
        chi2 = self._evidence.chi2_of_planes()
        names = self.rig.lasers.names
        health = {name: sqrt(max(own, 0.0) / len(PLANE_PARAMETERS)) for name, own in zip(names, chi2, strict=True)}
        if not self._evidence.shots:
            health = dict.fromkeys(names, nan)
        line = replace(line, rig_health=health)
        self._judge(chi2, line)
        cause = self._drift.cause
        return line, self._drift.sentence if cause and cause != before else None

    def _flagged(self, line: PoseLine) -> PoseLine:
        """The line with the flags of a drift that earlier shots have shown."""
        if not self._drift.finding:
            return line
        is_checked = self._corrected and PoseFlag.RIG_UNCHECKED not in line.flags
        findings = self._drift.finding | (NOTHING if is_checked else Finding.RIG_DOUBTED)
        return with_findings(line, findings, **self._drift.names)

    def _judge(self, chi2: Float64[Array, "laser"], line: PoseLine) -> None:
        """Name and correct a plane that has moved, or report that the rig has changed."""
        shots, evidence = self._shots, self._evidence
        if shots >= SHOTS_NEEDED and self._doubted > DOUBTED_FROM * shots:
            self._drift, self._corrected = Drift(finding=Finding.SHOTS_CONTRADICT), False
        elif chi2.max(initial=0.0) > evidence.limit:
            laser, turned = evidence.moved_laser(chi2)
            if laser is None:
                self._drift, self._corrected = Drift(finding=Finding.RIG_DISAGREES), False
                return
            moved = evidence.moved_plane(laser)
            depth_m = 0.5 if line.plane_evidence is None else float(line.plane_evidence.place_m[2])
            self._drift = Drift(
                # the middle of three planes hardly differs from a turn
                finding=Finding.PLANE_OR_CAMERA_MOVED if turned else Finding.PLANE_MOVED,
                laser=self.rig.lasers.names[laser],
                change=moved.description(depth_m),
            )
            self._corrected = not turned and shots - self._doubted >= SHOTS_TO_NAME
            if self._corrected:
                self._correct(moved)
        elif self._drift.finding is Finding.SHOTS_CONTRADICT and not self.rig.moved_planes:
            self._drift = (
                Drift()
            )  # contradictory shots are over; what the evidence shows holds until the rig is updated

    def _correct(self, moved: "MovedPlane") -> None:
        """Replace the plane in the rig for the next shots by the estimated plane with its covariance."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """What a stream has shown about the rig."""

    finding: Finding = NOTHING
    laser: str = ""
    """The laser whose plane has moved, if it is known."""
    change: str = ""
    """By how much, which differs from shot to shot."""

    @property
    def cause(self) -> Finding | str:
        """What has changed: the laser, or what the stream shows instead; nothing, if it has shown nothing."""
        return self.laser or self.finding

    @property
    def names(self) -> dict[str, str]:
        """What the sentence of the finding names."""
        return {"laser": self.laser, "change": self.change}

    @property
    def sentence(self) -> str:
        """The finding in words."""
        return sentences(self.finding, **self.names)


# Evidence of shots, and its tests

STREAM_SHOTS, FALSE_ALARM_SIGMAS = 50, 3.1
"""At most one in a thousand streams of this number of shots may have a false alarm: a normal quantile."""

MOVED_TILT_RAD, MOVED_DISTANCE_M = 0.05, 0.02
"""Standard deviations of a plane that has moved."""

SHOTS_LEFT_OUT = 2
"""Number of shots without which the others must still show a drift: one shot may have a wrong stripe."""

CLEARLY = 8.0
"""Margin in chi-squared by which one plane's error must explain more than any other's, or than a turn of the camera
against all planes, for the plane to be named: a factor of 50 in likelihood."""

SAME_TILT_RAD, SAME_PLACE_M = 0.003, 0.001
"""A shot nearer than this to one of the last poses shows nothing new: on a target at rest the noise is the same."""

POSES_REMEMBERED = 50
"""Number of last poses that new ones are compared with."""

_PLANE = len(PLANE_PARAMETERS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovedPlane:
    """The change of a light plane that has moved, as shots show it."""

    laser: int
    change: Float64[Array, "parameter=3"]
    """Tilts in radians and distance in metres, relative to the rig before."""
    covariance: Float64[Array, "parameter=3 parameter=3"]

    def description(self, depth_m: float) -> str:
        """Angle, and displacement in millimetres at the working distance."""
        tilt_rad = hypot(*self.change[:2].tolist())
        shift_m = hypot(depth_m * tilt_rad, float(self.change[2]))
        return f"has moved by {degrees(tilt_rad):.2f} degrees, {1e3 * shift_m:.2g} mm"


class RigEvidence:
    """The evidence of many shots for errors of a rig, and its tests."""

    def __init__(
        self, rig: Rig, stability: RigStability, shots_kept: int | None = None, left_out: int = SHOTS_LEFT_OUT
    ) -> None:
        self.rig = rig
        self._left_out = left_out
        self.parameters, self.prior = _parameters_and_prior(rig, stability)
        # a normal quantile z of a probability p becomes about sqrt(z^2 + 2 ln n) for p / n (Bonferroni)
        tests = len(rig.lasers.names) * STREAM_SHOTS
        self.limit = chi2_quantile(_PLANE, sqrt(FALSE_ALARM_SIGMAS**2 + 2.0 * np.log(tests)))
        """Chi-squared of a plane above which the rig has changed: for tests of each shot of a stream."""
        self._columns = np.array(
            [list(map(self.parameters.index, laser_parameters([name]))) for name in rig.lasers.names]
        )
        self._kept = shots_kept
        self._rows: list[Float64[Array, "row column"]] = []
        self._all: Float64[Array, "row column"] | None = None
        self._poses: list[tuple[Float64[Array, "3"], Float64[Array, "3"]]] = []

    @property
    def shots(self) -> int:
        """Number of shots whose evidence counts."""
        return len(self._rows)

    def add(self, evidence: PlaneEvidence) -> bool:
        """Add the rows of a shot and return whether it counts: one at the pose of a recent shot does not."""
        for normal, place_m in self._poses:
            tilt = np.linalg.norm(normal - evidence.normal)  # the chord of so small an angle
            if tilt < SAME_TILT_RAD and np.linalg.norm(place_m - evidence.place_m) < SAME_PLACE_M:
                return False
        self._poses = [*self._poses, (evidence.normal, evidence.place_m)][-POSES_REMEMBERED:]
        rows = np.zeros((len(evidence.rows), len(self.parameters) + 1))
        known = [index for index, name in enumerate(evidence.parameters) if name in self.parameters]  # others are exact
        rows[:, [self.parameters.index(evidence.parameters[index]) for index in known]] = evidence.rows[:, known]
        rows[:, -1] = evidence.rows[:, -1]
        self._rows.append(rows)
        if self._kept is not None:
            self._rows = self._rows[-self._kept :]
        self._all = None
        return True

    def chi2_of_planes(self, moved: Sequence[int] = ()) -> Float64[Array, "laser"]:
        """For each plane, by how much chi-squared falls if it has moved in addition to those in `moved`, Eq. (11.2).

        A fall above the limit must show in most shots.
        """
        stable, lasers = self._chi2(self._prior_if_moved(moved)), range(len(self.rig.lasers.names))
        chi2 = np.array([stable - self._chi2(self._prior_if_moved([*moved, laser])) for laser in lasers])
        for laser in np.flatnonzero(chi2 > self.limit).tolist():
            chi2[laser] = min(chi2[laser], self._explained_in_most_shots(laser, moved))
        return chi2

    def moved_laser(self, chi2: Float64[Array, "laser"]) -> tuple[int | None, bool]:
        """The laser whose plane has moved, and whether a rotation of the camera explains the evidence about as well.

        The laser is None if the plane of another laser, or the rotation of the camera, explains the evidence as well or
        better.
        """
        worst = int(np.argmax(chi2))
        turned = self._chi2(self.prior) - self._chi2(self._prior_if_camera_turned())
        if not (np.delete(chi2, worst) + CLEARLY < chi2[worst]).all() or turned >= chi2[worst] + CLEARLY:
            return None, False
        return worst, bool(turned + CLEARLY >= chi2[worst])

    def moved_plane(self, laser: int, moved: Sequence[int] = ()) -> MovedPlane:
        """The plane's change by the evidence, and its covariance, if the planes in `moved` may have moved, too."""
        mean, covariance = self.posterior(sorted({laser, *moved}))
        at = self.columns(laser)
        block = covariance[np.ix_(at, at)]
        return MovedPlane(laser=laser, change=mean[at], covariance=0.5 * (block + block.T))

    def posterior(
        self, moved: Sequence[int]
    ) -> tuple[Float64[Array, "parameter"], Float64[Array, "parameter parameter"]]:
        """Mean and covariance of the rig's errors by the evidence, if the planes of these lasers have moved."""
        prior, rows = self._prior_if_moved(moved), self._evidence()
        jacobian, target = rows[:, :-1], rows[:, -1]
        gain = np.linalg.solve(np.eye(len(target)) + jacobian @ prior @ jacobian.T, jacobian @ prior).T
        return gain @ target, prior - gain @ jacobian @ prior

    def columns(self, laser: int) -> Int64[Array, "3"]:
        """Indices of a light plane's three parameters among the rig's parameters."""
        columns: Int64[Array, "3"] = self._columns[laser]
        return columns

    def _evidence(self) -> Float64[Array, "row column"]:
        if self._all is None:
            self._all = np.zeros((0, len(self.parameters) + 1))
            if self._rows:
                self._all = np.asarray(np.linalg.qr(np.concatenate(self._rows), mode="r"))
        return self._all

    def _explained_in_most_shots(self, laser: int, moved: Sequence[int]) -> float:
        """By how much the estimated change of a plane reduces chi-squared in the shots but those that it explains best.

        A single shot with a wrong stripe may contradict the rig as strongly as a drift does in many shots.
        """
        change, prior = self.posterior([*moved, laser])[0], self._prior_if_moved(moved)
        falls = []
        for rows in self._rows:
            jacobian, target = rows[:, :-1], rows[:, -1]
            precision = np.linalg.inv(np.eye(len(target)) + jacobian @ prior @ jacobian.T)
            left = target - jacobian @ change
            falls.append(float(target @ precision @ target - left @ precision @ left))
        return float(sum(sorted(falls)[: len(falls) - self._left_out]))

    def _prior_if_moved(self, lasers: Sequence[int]) -> Float64[Array, "parameter parameter"]:
        prior = self.prior.copy()
        for laser in lasers:
            at = self.columns(laser)
            prior[at, at] += np.array([MOVED_TILT_RAD, MOVED_TILT_RAD, MOVED_DISTANCE_M]) ** 2
        return prior

    def _prior_if_camera_turned(self) -> Float64[Array, "parameter parameter"]:
        """Prior covariance if the camera has turned by r against all light planes: their normals n become n + r x n."""
        lasers, bases = self.rig.lasers, light_plane_bases(self.rig)
        root = np.zeros((len(self.parameters), 3))
        for laser, (normal, basis) in enumerate(zip(lasers.normal, bases, strict=True)):
            root[self.columns(laser)[:2]] = MOVED_TILT_RAD * np.cross(normal, basis)  # e . (r x n) = r . (n x e)
        return self.prior + root @ root.T

    def _chi2(self, prior: Float64[Array, "parameter parameter"]) -> float:
        """Chi-squared of y = A q + noise for q ~ N(0, prior), y^T (1 + A P A^T)^-1 y."""
        rows = self._evidence()
        if not len(rows):
            return 0.0
        jacobian, target = rows[:, :-1], rows[:, -1]
        return float(target @ np.linalg.solve(np.eye(len(target)) + jacobian @ prior @ jacobian.T, target))


def _parameters_and_prior(
    rig: Rig, stability: RigStability
) -> tuple[tuple[str, ...], Float64[Array, "parameter parameter"]]:
    """Names of the rig's parameters, with those of all light planes, and of the ring's form, and their covariance."""
    total = total_covariance(rig, stability)
    more = tuple(name for name in total_covariance(rig, TYPICAL_STABILITY).parameters if name not in total.parameters)
    known, names = len(total.parameters), (*total.parameters, *more, *FORM_PARAMETERS)
    covariance = np.zeros((len(names), len(names)))
    covariance[:known, :known] = total.data
    of_form = range(len(names) - len(FORM_PARAMETERS), len(names))
    covariance[of_form, of_form] = 1.0
    return names, covariance


def evidence_for_file(line: PoseLine) -> PlaneEvidence | None:
    """The evidence of a recorded shot for errors of the rig in the file: corrections of its planes are taken back."""
    evidence = line.plane_evidence
    if evidence is None or line.priors is None or PoseFlag.RADIUS_INCONSISTENT in line.flags:
        return None
    rows = evidence.rows.copy()
    for laser, correction in line.priors.moved_planes.items():
        columns = [evidence.parameters.index(name) for name in laser_parameters([laser])]
        rows[:, -1] += rows[:, columns] @ correction.change
    return replace(evidence, rows=rows)


# The form of the ring (ringpose-method(7), section 12)
#
# On the arc that one shot sees, a ring that is not round looks like a round ring with another radius, which depends on
# the place of the arc: the radii of a stream of shots differ by more than their errors. A wave of order k and amplitude
# a changes the radius that a short arc shows by up to (k^2 - 1) a: 8 a for order 3.

SAME_RING = 0.1
"""Relative difference of the mean radii up to which shots show the same ring: rings of other types differ by more."""

MIN_SHOTS = 4
"""Number of shots from which their radii are compared."""

_LIMIT_SIGMAS = sqrt(FALSE_ALARM_SIGMAS**2 + 2.0 * log(STREAM_SHOTS))
"""Limit of the test after each shot, as a normal quantile (Bonferroni, as for the planes)."""

_EDGES = 2

_MAX_SQUARED_DEVIATION = chi2_quantile(_EDGES, FALSE_ALARM_SIGMAS)
"""What a shot contributes at most: one of a thousand right shots deviates more."""

_REFITS = 3
"""Number of times that a ring is fitted to the shots that agree with it."""


class FormMonitor:
    """Compares the radii of the last shots of a ring, and flags the following ones if they differ."""

    def __init__(self) -> None:
        self._shots: list[tuple[Float64[Array, "edge=2"], Float64[Array, "edge=2 edge=2"]]] = []
        self._spread = ""

    def update(self, line: PoseLine) -> tuple[PoseLine, str | None]:
        """The line with the flags of a form that earlier shots have shown, and a warning where one is detected.

        Radii that are given, or assumed from the catalogue, show nothing; nor do shots that have a flag of their own.
        """
        pose = line.pose
        if pose is None or pose.covariance is None or line.priors is None or line.priors.radius is not None:
            return line, None
        radius_m = np.array([pose.radius_inner_m, pose.radius_outer_m])
        flagged = self._flagged(line)
        if line.status != "ok" or not bool(np.isfinite([*radius_m, *pose.covariance[5:7, 5:7].ravel()]).all()):
            return flagged, None
        to_curvature = -1.0 / radius_m**2  # the errors of curvatures are Gaussian even where those of radii are not
        covariance = pose.covariance[5:7, 5:7] * to_curvature[:, None] * to_curvature
        same = [shot for shot in self._shots if abs(shot[0] * radius_m - 1.0).max() < SAME_RING]
        self._shots = [*(same if same else []), (1.0 / radius_m, covariance)][-SHOTS_KEPT:]
        known, self._spread = self._spread, self._excessive_spread()
        is_new = self._spread and not known
        return flagged, sentences(Finding.RADII_DIFFER, spread=self._spread) if is_new else None

    def _flagged(self, line: PoseLine) -> PoseLine:
        if not self._spread or line.pose is None:
            return line
        return with_findings(line, Finding.RADII_DIFFER, spread=self._spread)

    def _excessive_spread(self) -> str:
        """Standard deviation of the radii of a ring that is not round, in millimetres; empty if the radii agree."""
        count = len(self._shots)
        if count < MIN_SHOTS or _disagreement(self._shots) <= chi2_quantile(_EDGES * (count - 1), _LIMIT_SIGMAS):
            return ""
        return f"{1e3 * float(np.std([1.0 / curvature[1] for curvature, _ in self._shots])):.2g} mm"


def _disagreement(shots: Sequence[tuple[Float64[Array, "edge=2"], Float64[Array, "edge=2 edge=2"]]]) -> float:
    """Sum of the squared deviations of the curvatures from one ring, each in units of its variance and bounded.

    The ring is the one with the least sum of those found from the curvatures of each shot. A few wrong shots, however
    far they are off, are not evidence: of a ring that is not round, most shots deviate.
    """
    curvature = np.stack([each for each, _ in shots])
    information = np.linalg.inv([covariance for _, covariance in shots])
    weighted = (information @ curvature[..., None])[..., 0]

    def chi2_of(rings: Float64[Array, "ring edge=2"]) -> Float64[Array, "ring shot"]:
        inner, outer = (curvature - rings[:, None]).transpose(2, 0, 1)
        chi2: Float64[Array, "ring shot"] = (
            information[:, 0, 0] * inner * inner
            + 2.0 * information[:, 0, 1] * inner * outer
            + information[:, 1, 1] * outer * outer
        )
        return chi2

    chi2 = chi2_of(curvature)
    for _ in range(_REFITS):
        agrees = chi2 < _MAX_SQUARED_DEVIATION
        normal_matrix = np.tensordot(agrees, information, axes=1)
        chi2 = chi2_of(np.linalg.solve(normal_matrix, (agrees @ weighted)[..., None])[..., 0])
    return float(np.minimum(chi2, _MAX_SQUARED_DEVIATION).sum(axis=1).min())
