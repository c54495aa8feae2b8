"""Light planes that have moved since the calibration, by board shots or by the records of a stream (method(7), 11).

Board shots and records give evidence in the same form: rows A q = y in the errors q of the rig, with the other unknowns
of a shot eliminated. The updated parameters are their posterior mean, given calibration, stability and evidence, where
the planes that have moved have a wide prior.
"""

from dataclasses import replace
from math import degrees, hypot, sqrt

import numpy as np

from ringpose.calibrate.camera.parameters import camera_with, parameter_names, parameters_of
from ringpose.calibrate.planes.joint_adjustment import corner_rows, stripe_rows, stripes_of
from ringpose.calibrate.planes.recheck.board_check import FLATNESS_M, SIGMAS, board_measurements
from ringpose.calibrate.planes.stripes.errors import line_modes
from ringpose.errors import DataError
from ringpose.estimate.nuisance import FOCAL_RATIO
from ringpose.geometry.rotations import tilted
from ringpose.pose.drift import MovedPlane, RigEvidence
from ringpose.types.arrays import Array, Float64
from ringpose.types.calibration import StripeView
from ringpose.types.pose import PlaneEvidence
from ringpose.types.rig import PLANE_PARAMETERS, ParameterCovariance, Rig, laser_parameters

MIN_STREAM_SHOTS, MIN_BOARD_SHOTS = 4, 2
"""Number of shots at different poses that a plane can be estimated from."""


def board_evidence(view: StripeView, rig: Rig) -> PlaneEvidence:
    """What a view of a board shows about camera and light planes, with the board's pose and unevenness eliminated."""
    data, state, _ = board_measurements(view, rig)
    blocks = [corner_rows(data, state, 0)]
    for laser, stripe in stripes_of(data, state, 0):
        rows = stripe_rows(data, 0, laser, stripe)
        # An uneven board shifts and turns the stripe's line: two more unknowns, of this standard deviation each.
        uneven_px = FLATNESS_M / SIGMAS / float(stripe.metres_per_pixel.mean())
        modes = uneven_px * line_modes(data.views[0].stripes_px[laser]).T / data.center_px[0][laser]
        blocks.append(_reduced(np.vstack([np.eye(2, 2 + rows.shape[1]), np.hstack([modes, rows])]), 2))
    reduced = _reduced(np.concatenate(blocks), 6)  # without the board's pose
    (pose,), names = state.poses, parameter_names(rig.camera.distortion_model)
    # The change of both focal lengths together is an error of its own; residuals r of the rows mean A q = -r.
    focal_px = rig.camera.camera_matrix[[0, 1], [0, 1]]
    wrt_ratio = reduced[:, [-1 - len(names), -len(names)]] @ focal_px
    return PlaneEvidence(
        parameters=(*laser_parameters(rig.lasers.names), *names, FOCAL_RATIO),
        rows=np.column_stack([reduced[:, :-1], wrt_ratio, -reduced[:, -1]]),
        normal=pose.rotation[:, 2],
        place_m=pose.translation_m,
    )


def _reduced(rows: Float64[Array, "row column"], unknowns: int) -> Float64[Array, "reduced_row reduced_column"]:
    """The rows with the first `unknowns` columns eliminated by least squares: equations for the other columns."""
    return np.asarray(np.linalg.qr(rows, mode="r"))[unknowns:, unknowns:]


def checked_shots(evidence: RigEvidence, *, boards: bool) -> None:
    """Raise DataError if there are too few shots to see whether a plane has moved."""
    needed = MIN_BOARD_SHOTS if boards else MIN_STREAM_SHOTS
    if evidence.shots < needed:
        found = f"{evidence.shots} usable shots at different poses, {needed} are needed"
        remedy = "of the board at other distances" if boards else "with three stripes, whose records are not --brief"
        raise DataError("calibrate-planes", found, f"give shots {remedy}")


def moved_lasers(evidence: RigEvidence, *, boards: bool) -> list[int] | None:
    """The lasers whose light planes have moved, none if the rig holds; None if the evidence of rings does not name one.

    Boards show each plane by itself. Rings show the planes only relative to each other, so that at most one moved plane
    can be identified.
    """
    chi2 = evidence.chi2_of_planes()
    if not boards:
        if not chi2.max(initial=0.0) > evidence.limit:
            return []
        laser, turned = evidence.moved_laser(chi2)
        return None if laser is None or turned else [laser]
    moved: list[int] = []
    while len(moved) < len(chi2) and chi2.max() > evidence.limit:
        moved.append(int(np.argmax(chi2)))
        chi2 = evidence.chi2_of_planes(moved)
        chi2[moved] = 0.0
    return moved


def updated_rig(rig: Rig, evidence: RigEvidence, moved: list[int]) -> Rig:
    """The rig with the posterior mean and covariance of its parameters; only planes in `moved` have a wide prior."""
    mean, covariance = evidence.posterior(moved)
    error = dict(zip(evidence.parameters, mean.tolist(), strict=True))
    camera_names, lasers = parameter_names(rig.camera.distortion_model), rig.lasers
    step = np.array([error.get(name, 0.0) for name in camera_names])
    step[:2] += error[FOCAL_RATIO] * rig.camera.camera_matrix[[0, 1], [0, 1]]
    planes = np.array([[error[name] for name in laser_parameters([laser])] for laser in lasers.names])
    normal = np.array([tilted(n, tilts) for n, tilts in zip(lasers.normal, planes[:, :2], strict=True)])
    names = (*camera_names, *laser_parameters(lasers.names))
    jacobian = np.array([[float(name == other) for other in evidence.parameters] for name in names])
    jacobian[:2, evidence.parameters.index(FOCAL_RATIO)] = rig.camera.camera_matrix[[0, 1], [0, 1]]
    return replace(
        rig,
        camera=camera_with(parameters_of(rig.camera) + step, rig.camera),
        lasers=replace(lasers, normal=normal, distance_m=lasers.distance_m + planes[:, 2]),
        covariance=ParameterCovariance(parameters=names, data=jacobian @ covariance @ jacobian.T),
    )


def evidence_lines(evidence: RigEvidence, moved: list[int] | None, depth_m: float) -> list[str]:
    """A line of text for each laser: the normalised error of its plane, where the planes in `moved` have a wide prior.

    `moved` is None if a plane has moved and it is not known which.
    """
    alone, beside = evidence.chi2_of_planes(), evidence.chi2_of_planes(moved or ())
    limit, lines = sqrt(evidence.limit / len(PLANE_PARAMETERS)), []
    for laser, name in enumerate(evidence.rig.lasers.names):
        suspect = moved is None or laser in moved
        error = sqrt(max(float(alone[laser] if suspect else beside[laser]), 0.0) / len(PLANE_PARAMETERS))
        found = "does not hold: " + evidence.moved_plane(laser, moved or ()).description(depth_m)
        lines.append(f"{name}: normalized error {error:.1f} (limit {limit:.1f}): {found if error > limit else 'holds'}")
    return lines


def change_line(name: str, moved: MovedPlane, depth_m: float) -> str:
    """A line of text: by how much a plane has moved, and the standard deviation of that change."""
    sd = np.sqrt(np.diag(moved.covariance)).tolist()
    return f"{name} {moved.description(depth_m)}; known to {degrees(hypot(*sd[:2])):.3f} degrees, {1e3 * sd[2]:.2g} mm"
