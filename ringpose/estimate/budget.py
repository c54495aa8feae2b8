"""The error budget of a pose: the variance of each quantity by its source (ringpose-method(7), section 15).

The error of the estimate is -N^-1 (A^T W noise + errors of priors), so that its covariance N^-1 = N^-1 (sum I_s) N^-1
is a sum over the sources s, each with the information I_s that it adds to N: rows of measurements and of priors, and
the unit information on each common error.
"""

import numpy as np

from ringpose.estimate import covariance as joint
from ringpose.estimate.covariance import Quantities
from ringpose.estimate.linearization import PARAMETERS
from ringpose.estimate.nuisance import EXACT, FORM_PARAMETERS, covariance_root, rig_errors, total_covariance
from ringpose.estimate.ring_estimate import Estimate
from ringpose.estimate.separation import directions_of
from ringpose.estimate.solver import PRECISE_SIGMAS, RIDGE
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import ParameterCovariance

DELAY = "mount.delay"
"""The mount's parameter that is the clock's."""


def error_budget(
    estimate: Estimate,
    values: Quantities,
    inflated: Float64[Array, "15 15"],
    reported: Float64[Array, "15 15"],
) -> dict[str, Float64[Array, "quantity=7 quantity=7"]]:
    """The covariance of the quantities of `ringpose.types.protection` but the last, by source.

    `inflated` is the covariance of a shot that contradicts itself, `reported` also has the second order of the centre.
    The sources add up to the latter.
    """
    directions = directions_of(values, PARAMETERS + estimate.nuisance.shape[1])[:7]
    solved = np.linalg.solve(estimate.joint_information, directions.T)  # N^-1 c
    sources = {name: solved.T @ part @ solved for name, part in _information(estimate).items()}
    linear = np.sum(list(sources.values()), axis=0)
    to_quantities = np.zeros((7, 15))
    to_quantities[:2, joint.GRASP] = np.array([values.normal, values.outward])
    to_quantities[2:4, joint.TILTS], to_quantities[4:7, joint.CENTER] = np.eye(2), np.eye(3)
    total, before = (to_quantities @ each @ to_quantities.T for each in (reported, inflated))
    contradiction = before - linear
    if (np.abs(contradiction.diagonal()) < PRECISE_SIGMAS * linear.diagonal()).all():  # that of the last step but one
        sources["image_noise"] = sources["image_noise"] + contradiction
    else:
        sources["contradiction"] = contradiction
    return {**sources, "second_order": total - before}


def _information(estimate: Estimate) -> dict[str, Float64[Array, "parameter parameter"]]:
    """The information of each source on ring and common errors; they add up to the joint information."""
    residuals, prior = estimate.residuals, estimate.prior
    jacobian = np.concatenate([residuals.jacobian, estimate.nuisance], axis=1)
    count = jacobian.shape[1]

    def of_rows(rows: slice) -> Float64[Array, "parameter parameter"]:
        return np.asarray((jacobian[rows].T * estimate.weights[rows]) @ jacobian[rows])

    def of_errors(first: int, block: Float64[Array, "error error"]) -> Float64[Array, "parameter parameter"]:
        information = np.zeros((count, count))
        information[first : first + len(block), first : first + len(block)] = block
        return information

    radii = 0 if prior.radii is None else int(np.isfinite(prior.radii.radius_m).sum())
    data, end = residuals.data_rows, len(residuals.residual)
    sources = {
        "image_noise": of_rows(slice(0, data)),
        "radius_prior": of_rows(slice(data, data + radii)),
        "weak_prior": of_rows(slice(data + radii, end)) + of_errors(0, RIDGE * np.eye(PARAMETERS)),
    }
    first = PARAMETERS
    for name, blocks in _blocks(estimate):
        size = len(next(iter(blocks.values())))
        for part, block in blocks.items():
            sources[part] = sources.get(part, 0.0) + of_errors(first, block)
        first += size
        assert first <= count, name
    return sources


def _blocks(estimate: Estimate) -> "list[tuple[str, dict[str, Float64[Array, 'error error']]]]":
    """The unit information on the common errors in the order of their columns, by source."""
    residuals, fixed, assumed = estimate.residuals, estimate.fixed, estimate.prior.assumptions
    observations = residuals.observations
    blocks = [("motion", {"motion": np.eye(len(residuals.rate_sds))})]
    errors = rig_errors(observations.rig, assumed.stability)
    if errors is not None:
        calibrated = total_covariance(observations.rig, EXACT)
        blocks.append(("rig", _split(errors.root, errors.parameters, calibrated, "rig_calibration", "stability")))
    if fixed.form is not None:
        blocks.append(("form", {"form": np.eye(len(FORM_PARAMETERS))}))
    if fixed.slope is not None:
        blocks.append(("slope", {"form": np.eye(1)}))
    camera = observations.camera
    if residuals.wrt_camera.shape[1] and camera is not None:
        uncertain = camera.mount.uncertain
        kept = np.diag(camera.mount.covariance) > 0
        own = camera.mount.covariance[np.ix_(kept, kept)]
        of_clock = np.diag([own[place, place] if name == DELAY else 0.0 for place, name in enumerate(uncertain)])
        clock = ParameterCovariance(parameters=uncertain, data=of_clock)
        blocks.append(("mount", _split(covariance_root(own), uncertain, clock, "clock", "mount")))
    blocks.append(("edges", {"image_noise": np.eye(fixed.edge_errors)}))
    return blocks


def _split(
    root: Float64[Array, "parameter error"],
    parameters: tuple[str, ...],
    part: ParameterCovariance,
    name: str,
    rest: str,
) -> dict[str, Float64[Array, "error error"]]:
    """The unit covariance of the errors of a root R: R^+ C R^+^T of a part C of its covariance, and the rest.

    The prior mean of the errors is off by R^+ times that of the parameters.
    """
    covariance = np.zeros((len(parameters), len(parameters)))
    places = [(place, part.parameters.index(each)) for place, each in enumerate(parameters) if each in part.parameters]
    if places:
        own, given = (list(each) for each in zip(*places, strict=True))
        covariance[np.ix_(own, own)] = part.data[np.ix_(given, given)]
    scale = np.sqrt((root**2).sum(axis=1))
    inverse = np.linalg.pinv(root / scale[:, None])
    block = inverse @ (covariance / scale / scale[:, None]) @ inverse.T
    return {name: block, rest: np.eye(len(block)) - block}
