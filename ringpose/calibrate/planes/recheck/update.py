"""Light planes that have moved since the calibration, by board shots or by the records of a stream (method(7), 11).

Board shots and records give evidence in the same form: rows A q = y in the errors q of the rig, with the other unknowns
of a shot eliminated. The updated parameters are their posterior mean, given calibration, stability and evidence, where
the planes that have moved have a wide prior.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from math import degrees, hypot, sqrt
from typing import Any

import numpy as np

from ringpose.calibrate.camera.parameters import camera_with, parameter_names, parameters_of
from ringpose.calibrate.planes.joint_adjustment import corner_rows, stripe_rows, stripes_of
from ringpose.calibrate.planes.recheck import board_check
from ringpose.calibrate.planes.stripes.errors import line_modes
from ringpose.errors import DataError
from ringpose.estimate.nuisance import FOCAL_RATIO
from ringpose.geometry.rotations import tilted
from ringpose.pose.rig_monitor import CONTRADICTORY, MovedPlane, RigEvidence, evidence_for_file
from ringpose.types.arrays import Array, Float64
from ringpose.types.calibration import StripeView
from ringpose.types.pose import PlaneEvidence, PoseLine
from ringpose.types.rig import PLANE_PARAMETERS, ParameterCovariance, Rig, laser_parameters

MIN_STREAM_SHOTS, MIN_BOARD_SHOTS = 4, 2
"""Number of shots at different poses that a plane can be estimated from."""

USUAL_DISTANCE_M = 0.5
"""Distance at which motions of planes are given in millimetres where the shots show none."""


class RigRecheck(ABC):
    """A rig, and what shots after its calibration show about it: subclasses add the shots of a board or of rings."""

    def __init__(self, rig: Rig, evidence: RigEvidence) -> None:
        self.rig = rig
        self.evidence = evidence
        self._depths_m: list[float] = []

    @property
    @abstractmethod
    def contradicted(self) -> bool:
        """Whether the shots do not agree with the rig, whichever plane has moved."""

    @abstractmethod
    def summary(self, *, good_too: bool) -> list[str]:
        """Lines of text about the shots; without `good_too` only what does not agree with the rig."""

    @abstractmethod
    def moved_lasers(self) -> list[int] | None:
        """The lasers whose light planes have moved, none if the rig holds; None if the evidence does not name one.

        DataError if there are too few shots to see that.
        """

    def _add(self, evidence: PlaneEvidence) -> None:
        """Add the evidence of a shot; one at the pose of a recent shot does not count."""
        if self.evidence.add(evidence):
            self._depths_m.append(float(evidence.place_m[2]))

    def _require_shots(self, needed: int, remedy: str) -> None:
        """Raise DataError if there are too few shots to see whether a plane has moved."""
        if self.evidence.shots < needed:
            finding = f"{self.evidence.shots} usable shots at different poses, {needed} are needed"
            raise DataError("calibrate-planes", finding, f"give shots {remedy}")

    def evidence_lines(self, moved: list[int] | None) -> list[str]:
        """A line of text for each laser: the normalised error of its plane.

        The planes in `moved` have a wide prior; it is None if a plane has moved and it is not known which.
        """
        alone, beside = self.evidence.chi2_of_planes(), self.evidence.chi2_of_planes(moved or ())
        limit, lines = sqrt(self.evidence.limit / len(PLANE_PARAMETERS)), []
        for laser, name in enumerate(self.rig.lasers.names):
            suspect = moved is None or laser in moved
            error = sqrt(max(float(alone[laser] if suspect else beside[laser]), 0.0) / len(PLANE_PARAMETERS))
            verdict = "holds"
            if error > limit:
                verdict = f"does not hold: {self._description(self.evidence.moved_plane(laser, moved or ()))}"
            lines.append(f"{name}: normalized error {error:.1f} (limit {limit:.1f}): {verdict}")
        return lines

    def _description(self, moved: MovedPlane) -> str:
        return moved.description(float(np.median(self._depths_m or [USUAL_DISTANCE_M])))

    def change_lines(self, moved: Sequence[int]) -> list[str]:
        """A line of text for each plane that has moved: by how much, and the standard deviation of that change."""
        lines = []
        for plane in (self.evidence.moved_plane(laser, moved) for laser in moved):
            sd = np.sqrt(np.diag(plane.covariance)).tolist()
            known = f"known to {degrees(hypot(*sd[:2])):.3f} degrees, {1e3 * sd[2]:.2g} mm"
            lines.append(f"{self.rig.lasers.names[plane.laser]} {self._description(plane)}; {known}")
        return lines

    def changes(self, moved: Sequence[int]) -> list[dict[str, Any]]:
        """Entries of the key `quality.updated` of rig.yaml for the planes that have moved."""
        names, shots = self.rig.lasers.names, self.evidence.shots
        planes = [self.evidence.moved_plane(laser, moved) for laser in moved]
        return [
            {"laser": names[plane.laser], "change": plane.change, "covariance": plane.covariance, "shots": shots}
            for plane in planes
        ]

    def updated_rig(self, moved: Sequence[int]) -> Rig:
        """The rig with the posterior mean and covariance of its parameters; planes in `moved` have a wide prior."""
        rig, parameters = self.rig, self.evidence.parameters
        mean, covariance = self.evidence.posterior(moved)
        error = dict(zip(parameters, mean.tolist(), strict=True))
        camera_names, lasers = parameter_names(rig.camera.distortion_model), rig.lasers
        focal_px = rig.camera.camera_matrix[[0, 1], [0, 1]]
        step = np.array([error.get(name, 0.0) for name in camera_names])
        step[:2] += error[FOCAL_RATIO] * focal_px
        planes = np.array([[error[name] for name in laser_parameters([laser])] for laser in lasers.names])
        normal = np.array([tilted(n, tilts) for n, tilts in zip(lasers.normal, planes[:, :2], strict=True)])
        names = (*camera_names, *laser_parameters(lasers.names))
        jacobian = np.array([[float(name == other) for other in parameters] for name in names])
        jacobian[:2, parameters.index(FOCAL_RATIO)] = focal_px
        return replace(
            rig,
            camera=camera_with(parameters_of(rig.camera) + step, rig.camera),
            lasers=replace(lasers, normal=normal, distance_m=lasers.distance_m + planes[:, 2]),
            covariance=ParameterCovariance(parameters=names, data=jacobian @ covariance @ jacobian.T),
        )


class BoardRecheck(RigRecheck):
    """A rig compared with views of a board, which show the planes each by itself."""

    def __init__(self, rig: Rig, median_board_rms_px: float | None) -> None:
        """`median_board_rms_px` is the corner rms of the rig's calibration, if it is known."""
        super().__init__(rig, RigEvidence(rig, rig.stability, left_out=0))
        self._median_board_rms_px = median_board_rms_px
        self._checks: list[board_check.RigCheck] = []

    def add(self, view: StripeView) -> None:
        """Check the rig by a view; the view is evidence about the planes unless its corners miss the board."""
        check = board_check.rig_check(view, self.rig, self._median_board_rms_px)
        self._checks.append(check)
        if check.board_rms_px <= check.board_limit_px:
            self._add(board_evidence(view, self.rig))

    @property
    def contradicted(self) -> bool:
        """Whether a view does not agree with camera or light planes."""
        return not all(check.holds for check in self._checks)

    def summary(self, *, good_too: bool) -> list[str]:
        """Lines of text about each view."""
        return [
            line for check in self._checks if good_too or not check.holds for line in board_check.rig_check_lines(check)
        ]

    def moved_lasers(self) -> list[int]:
        """The lasers whose light planes have moved."""
        self._require_shots(MIN_BOARD_SHOTS, "of the board at other distances")
        chi2, moved = self.evidence.chi2_of_planes(), list[int]()
        while len(moved) < len(chi2) and chi2.max() > self.evidence.limit:
            moved.append(int(np.argmax(chi2)))
            chi2 = self.evidence.chi2_of_planes(moved)
            chi2[moved] = 0.0
        return moved


class StreamRecheck(RigRecheck):
    """A rig compared with the pose records of a stream: rings show the planes only relative to each other."""

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig, RigEvidence(rig, rig.stability))
        self._shots, self._contradictory = 0, 0

    def add(self, line: PoseLine) -> None:
        """Count a shot of the stream, and add what it shows about the planes of the rig in the file."""
        self._shots += 1
        self._contradictory += bool(line.flags & CONTRADICTORY)
        evidence = evidence_for_file(line)
        if evidence is not None:
            self._add(evidence)

    @property
    def contradicted(self) -> bool:
        """Whether the stripes of most shots do not fit one ring as they were assigned."""
        return self._contradictory > self._shots / 2

    def summary(self, *, good_too: bool) -> list[str]:
        """The number of shots, and how many contradict the rig if most do."""
        shots, usable = self._shots, self.evidence.shots
        number = f"{shots} shots, {usable} of them show the light planes at different poses of the ring"
        finding = f"{self._contradictory} of {shots} shots contradict this rig"
        contradiction = f"{finding}: check the wiring, or calibrate it again"
        return [number] * good_too + [contradiction] * self.contradicted

    def moved_lasers(self) -> list[int] | None:
        """The laser whose light plane has moved: at most one can be identified."""
        self._require_shots(MIN_STREAM_SHOTS, "with three stripes, whose records are not --brief")
        chi2 = self.evidence.chi2_of_planes()
        if not chi2.max(initial=0.0) > self.evidence.limit:
            return []
        laser, turned = self.evidence.moved_laser(chi2)
        return None if laser is None or turned else [laser]


def board_evidence(view: StripeView, rig: Rig) -> PlaneEvidence:
    """What a view of a board shows about camera and light planes, with the board's pose and unevenness eliminated."""
    data, state, _ = board_check.board_measurements(view, rig)
    blocks = [corner_rows(data, state, 0)]
    for laser, stripe in stripes_of(data, state, 0):
        rows = stripe_rows(data, 0, laser, stripe)
        # An uneven board shifts and turns the stripe's line: two more unknowns, of this standard deviation each.
        uneven_px = board_check.FLATNESS_M / board_check.SIGMAS / float(stripe.metres_per_pixel.mean())
        modes = uneven_px * line_modes(data.views[0].stripes_px[laser]).T / data.center_px[0][laser]
        blocks.append(_reduced(np.vstack([np.eye(2, 2 + rows.shape[1]), np.hstack([modes, rows])]), 2))
    reduced = _reduced(np.concatenate(blocks), 6)  # without the board's pose
    (pose,), names = state.poses, parameter_names(rig.camera.distortion_model)
    # The change of both focal lengths together is an error of its own.
    focal_px = rig.camera.camera_matrix[[0, 1], [0, 1]]
    wrt_ratio = reduced[:, [-1 - len(names), -len(names)]] @ focal_px
    return PlaneEvidence(
        parameters=(*laser_parameters(rig.lasers.names), *names, FOCAL_RATIO),
        rows=np.column_stack([reduced[:, :-1], wrt_ratio, reduced[:, -1]]),
        normal=pose.rotation[:, 2],
        place_m=pose.translation_m,
    )


def _reduced(rows: Float64[Array, "row column"], unknowns: int) -> Float64[Array, "reduced_row reduced_column"]:
    """The rows with the first `unknowns` columns eliminated by least squares: equations for the other columns."""
    return np.asarray(np.linalg.qr(rows, mode="r"))[unknowns:, unknowns:]
