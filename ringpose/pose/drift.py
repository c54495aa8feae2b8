"""Errors of the light planes over a stream of shots (ringpose-method(7), section 11).

A light plane that has moved leaves the same residuals in every shot, noise leaves other ones in each. The information
of the shots on the rig's parameters is accumulated; for each plane, the likelihood that it has moved is compared with
the likelihood of a rig within its calibration and stability. From then on, the stream is measured with that plane as
estimated.
"""

from dataclasses import dataclass, replace
from math import degrees, hypot, nan, sqrt

import numpy as np

from ringpose.estimate.hypotheses import chi2_quantile
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.nuisance import light_plane_bases, rig_errors, rig_jacobian, total_covariance
from ringpose.estimate.residuals import PARAMETERS, RIDGE, Estimate
from ringpose.geometry.rotations import angle_between, tilted
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.assumptions import TYPICAL_STABILITY, RigStability
from ringpose.types.covariance import PLANE_PARAMETERS, laser_parameters
from ringpose.types.pose import PlaneEvidence, PoseFlag, PoseLine
from ringpose.types.rig import Rig

FORGETTING = 0.98
"""Weight of earlier shots in the share of contradictory ones: about fifty count."""

STREAM_SHOTS, FALSE_ALARM_SIGMAS = 50, 3.1
"""At most one stream of so many shots in a thousand may have a false alarm: a normal quantile."""

MOVED_TILT_RAD, MOVED_DISTANCE_M = 0.05, 0.02
"""Standard deviations of a plane that has moved."""

SHOTS_KEPT = 50
"""Number of last shots whose evidence counts."""

SHOTS_LEFT_OUT = 2
"""Number of shots without which the others must still show a drift: one shot may have a wrong stripe."""

CLEARLY = 8.0
"""Margin in chi-squared by which one plane's error must explain more than any other's, or than a turn of the camera
against all planes, for the plane to be named: a factor of 50 in likelihood."""

SAME_TILT_RAD, SAME_PLACE_M = 0.003, 0.001
"""A shot nearer than this to one of the last poses shows nothing new: on a target at rest the noise is the same."""

POSES_REMEMBERED = 50
"""Number of last poses that new ones are compared with."""

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

REDUNDANT_STRIPES = 3
"""Stripes from which a single shot shows an error of the rig."""

_PLANE = len(PLANE_PARAMETERS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovedPlane:
    """A light plane that has moved, as a stream of shots shows it."""

    laser: int
    change: Float64[Array, "parameter=3"]
    """Tilts in radians and distance in metres, relative to the rig before."""
    covariance: Float64[Array, "parameter=3 parameter=3"]

    def description(self, name: str, depth_m: float) -> str:
        """Laser, angle, and displacement in millimetres at the working distance."""
        tilt_rad = hypot(*self.change[:2].tolist())
        shift_m = hypot(depth_m * tilt_rad, float(self.change[2]))
        return f"the light plane of laser {name} has moved by {degrees(tilt_rad):.2f} degrees, {1e3 * shift_m:.2g} mm"


class DriftMonitor:
    """Accumulates the evidence of a stream of pose lines, and corrects the rig for a plane that has moved."""

    def __init__(self, rig: Rig, stability: RigStability) -> None:
        self.rig = rig
        """The rig for the next shot: a plane that has moved is where the stream shows it."""
        self._stability = stability
        self._parameters, self._prior = _parameters_and_prior(rig, stability)
        self._rows: list[Float64[Array, "row column"]] = []
        self._evidence = np.zeros((0, len(self._parameters) + 1))
        self._poses: list[tuple[Float64[Array, "3"], Float64[Array, "3"]]] = []
        self._shots, self._doubted = 0.0, 0.0
        self._reason, self._corrected = "", False

    def update(self, line: PoseLine) -> tuple[PoseLine, str | None]:
        """The line with the lasers' health and the flag of a drift, and a warning where one is detected.

        Poses that contradict given radii contribute nothing; nor do the paper's methods, which have no residuals.
        """
        if line.pose is not None and line.priors is None:
            return line, None
        line = self._flagged(line)  # before this shot is counted: it was measured with the rig as it was
        before = self._reason.partition(" by ")[0]
        if line.plane_evidence is not None:
            if PoseFlag.RADIUS_INCONSISTENT not in line.flags and self._is_new(line.plane_evidence):
                self._add(line.plane_evidence)
        elif line.flags & CONTRADICTORY:
            self._shots, self._doubted = FORGETTING * self._shots + 1.0, FORGETTING * self._doubted + 1.0
        chi2 = self._chi2_of_planes()
        names = self.rig.lasers.names
        health = {name: sqrt(max(each, 0.0) / _PLANE) for name, each in zip(names, chi2.tolist(), strict=True)}
        if not len(self._evidence):
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

    def _is_new(self, evidence: PlaneEvidence) -> bool:
        """Whether a shot shows the ring at another pose than the last ones."""
        for normal, place_m in self._poses:
            tilt_rad = float(angle_between(normal[None], evidence.normal[None])[0])
            if tilt_rad < SAME_TILT_RAD and np.linalg.norm(place_m - evidence.place_m) < SAME_PLACE_M:
                return False
        self._poses = [*self._poses, (evidence.normal, evidence.place_m)][-POSES_REMEMBERED:]
        return True

    def _add(self, evidence: PlaneEvidence) -> None:
        """Add the rows of a shot."""
        rows = np.zeros((len(evidence.rows), len(self._parameters) + 1))
        columns = [self._parameters.index(name) for name in evidence.parameters]
        rows[:, columns], rows[:, -1] = evidence.rows[:, :-1], evidence.rows[:, -1]
        self._rows = [*self._rows, rows][-SHOTS_KEPT:]
        self._evidence = np.asarray(np.linalg.qr(np.concatenate(self._rows), mode="r"))
        self._shots, self._doubted = FORGETTING * self._shots + 1.0, FORGETTING * self._doubted

    def _chi2_of_planes(self) -> Float64[Array, "laser"]:
        """By how much chi-squared falls if each plane has moved, Eq. (11.2); a drift must show in most shots."""
        stable, lasers = _chi2(self._evidence, self._prior), range(len(self.rig.lasers.names))
        chi2 = np.array([stable - _chi2(self._evidence, self._prior_if_moved([laser])) for laser in lasers])
        for laser in np.flatnonzero(chi2 > _limit(_PLANE, len(lasers))).tolist():
            chi2[laser] = min(chi2[laser], self._explained_in_most_shots(laser))
        return chi2

    def _explained_in_most_shots(self, laser: int) -> float:
        """By how much chi-squared falls by the plane's estimated change, without the shots in which it falls most.

        A shot with a wrong stripe may contradict the rig as strongly as a drift does in many shots.
        """
        change = self._mean_if_moved(laser)[0]
        falls = []
        for rows in self._rows:
            jacobian, target = rows[:, :-1], rows[:, -1]
            precision = np.linalg.inv(np.eye(len(target)) + jacobian @ self._prior @ jacobian.T)
            left = target - jacobian @ change
            falls.append(float(target @ precision @ target - left @ precision @ left))
        return float(sum(sorted(falls)[: len(falls) - SHOTS_LEFT_OUT]))

    def _prior_if_moved(self, lasers: list[int]) -> Float64[Array, "parameter parameter"]:
        prior = self._prior.copy()
        for laser in lasers:
            at = self._columns(laser)
            prior[at, at] += np.array([MOVED_TILT_RAD, MOVED_TILT_RAD, MOVED_DISTANCE_M]) ** 2
        return prior

    def _prior_if_camera_turned(self) -> Float64[Array, "parameter parameter"]:
        """The camera turned by r against all light planes together: their normals n become n + r x n."""
        lasers, bases = self.rig.lasers, light_plane_bases(self.rig)
        root = np.zeros((len(self._parameters), 3))
        for laser, (normal, basis) in enumerate(zip(lasers.normal, bases, strict=True)):
            root[self._columns(laser)[:2]] = MOVED_TILT_RAD * np.cross(normal, basis)  # e . (r x n) = r . (n x e)
        return self._prior + root @ root.T

    def _columns(self, laser: int) -> Int64[Array, "3"]:
        names = laser_parameters([self.rig.lasers.names[laser]])
        return np.array([self._parameters.index(name) for name in names])

    def _judge(self, chi2: Float64[Array, "laser"], line: PoseLine) -> None:
        """Name and correct a plane that has moved, or report that the rig has changed."""
        lasers, shots = len(chi2), self._shots
        if shots >= SHOTS_NEEDED and self._doubted > DOUBTED_FROM * shots:
            self._reason, self._corrected = CONTRADICTED, False
        elif chi2.max(initial=0.0) > _limit(_PLANE, lasers):
            worst = int(np.argmax(chi2))
            turned = _chi2(self._evidence, self._prior) - _chi2(self._evidence, self._prior_if_camera_turned())
            if bool((np.delete(chi2, worst) + CLEARLY < chi2[worst]).all()) and turned < chi2[worst] + CLEARLY:
                moved = self._moved(worst)
                depth_m = 0.5 if line.plane_evidence is None else float(line.plane_evidence.place_m[2])
                self._reason = moved.description(self.rig.lasers.names[worst], depth_m)
                self._corrected = turned + CLEARLY < chi2[worst] and shots - self._doubted >= SHOTS_TO_NAME
                if self._corrected:
                    self._correct(moved)
                elif turned + CLEARLY >= chi2[worst]:  # the middle of three planes hardly differs from a turn
                    self._reason = f"{self._reason}, or the camera has turned"
            else:
                self._reason, self._corrected = DISAGREES, False
        elif not self.rig.moved_planes:
            self._reason = ""  # contradictory shots are over

    def _moved(self, laser: int) -> MovedPlane:
        """The plane's change by the evidence, and its covariance."""
        mean, covariance = self._mean_if_moved(laser)
        at = self._columns(laser)
        block = covariance[np.ix_(at, at)]
        return MovedPlane(laser=laser, change=mean[at], covariance=0.5 * (block + block.T))

    def _mean_if_moved(self, laser: int) -> tuple[Float64[Array, "parameter"], Float64[Array, "parameter parameter"]]:
        """Mean and covariance of the rig's parameters by the evidence, if the plane of a laser has moved."""
        prior = self._prior_if_moved([laser])
        jacobian, target = self._evidence[:, :-1], self._evidence[:, -1]
        gain = np.linalg.solve(np.eye(len(target)) + jacobian @ prior @ jacobian.T, jacobian @ prior).T
        return gain @ target, prior - gain @ jacobian @ prior

    def _correct(self, moved: MovedPlane) -> None:
        """Measure the next shots with the plane as estimated, with its covariance instead of the calibration's."""
        lasers, laser = self.rig.lasers, moved.laser
        normal, distance_m = lasers.normal.copy(), lasers.distance_m.copy()
        normal[laser] = tilted(normal[laser], moved.change[:2])
        distance_m[laser] += moved.change[2]
        self.rig = replace(
            self.rig,
            lasers=replace(lasers, normal=normal, distance_m=distance_m),
            moved_planes={**self.rig.moved_planes, lasers.names[laser]: moved.covariance},
        )
        self._parameters, self._prior = _parameters_and_prior(self.rig, self._stability)
        self._rows, self._evidence = [], np.zeros((0, len(self._parameters) + 1))
        self._poses = []


def _parameters_and_prior(
    rig: Rig, stability: RigStability
) -> tuple[tuple[str, ...], Float64[Array, "parameter parameter"]]:
    """The rig's parameters, among them those of all light planes, and their covariance."""
    total = total_covariance(rig, stability)
    more = tuple(name for name in total_covariance(rig, TYPICAL_STABILITY).parameters if name not in total.parameters)
    known = len(total.parameters)
    covariance = np.zeros((known + len(more), known + len(more)))
    covariance[:known, :known] = total.data
    return (*total.parameters, *more), covariance


def _chi2(rows: Float64[Array, "row column"], prior: Float64[Array, "parameter parameter"]) -> float:
    """Chi-squared of y = A q + noise for q ~ N(0, prior), y^T (1 + A P A^T)^-1 y."""
    if not len(rows):
        return 0.0
    jacobian, target = rows[:, :-1], rows[:, -1]
    return float(target @ np.linalg.solve(np.eye(len(target)) + jacobian @ prior @ jacobian.T, target))


def _limit(degrees_of_freedom: int, tests: int) -> float:
    """Quantile of chi-squared for so many tests of each shot of a stream (Bonferroni)."""
    # a normal quantile z of a probability p becomes about sqrt(z^2 + 2 ln n) for p / n
    sigmas = sqrt(FALSE_ALARM_SIGMAS**2 + 2.0 * np.log(tests * STREAM_SHOTS))
    return chi2_quantile(degrees_of_freedom, sigmas)


def plane_evidence(estimate: Estimate, measured: Measurements, rig: Rig) -> PlaneEvidence | None:
    """What a shot shows about the rig's parameters; None if it leaves parameters of the ring open.

    The rows A q = y of the QR factor that are left when ring, rates, form and visible edges' errors are eliminated with
    their priors: the Schur complement of section 9.
    """
    if estimate.regularized or len(measured.stripes) < REDUNDANT_STRIPES:
        return None
    errors = rig_errors(rig, TYPICAL_STABILITY)
    if errors is None:
        return None
    residuals, rates = estimate.residuals, len(estimate.residuals.rate_sds)
    of_rig = estimate.mean_ray_wrt_nuisance.shape[1]
    own = np.delete(estimate.nuisance, range(rates, of_rig), axis=1)
    by_rig = rig_jacobian(residuals, measured, measured.observations(rig.lasers), errors, rig)
    rows = np.concatenate([residuals.jacobian, own, by_rig, -residuals.residual[:, None]], axis=1)
    eliminated = PARAMETERS + own.shape[1]
    prior = np.zeros((eliminated, rows.shape[1]))
    diagonal = range(eliminated)
    prior[diagonal, diagonal] = np.concatenate([np.full(PARAMETERS, sqrt(RIDGE)), np.ones(own.shape[1])])
    prior[PARAMETERS : PARAMETERS + rates, -1] = -residuals.rate_deviations
    triangle = np.linalg.qr(np.concatenate([prior, np.sqrt(estimate.weights)[:, None] * rows]), mode="r")
    return PlaneEvidence(
        parameters=errors.parameters,
        rows=np.asarray(triangle)[eliminated:, eliminated:],
        normal=estimate.arcs.normal,
        place_m=estimate.arcs.origin,
    )
