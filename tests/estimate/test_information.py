"""The measurement of a record: with the record's priors it gives the pose, and it can be combined over shots."""

from dataclasses import replace

import numpy as np
import pytest

from ringpose.estimate.covariance import joint_covariance, quantities
from ringpose.estimate.hypotheses import explain
from ringpose.estimate.information import POSE, RATES
from ringpose.estimate.measurements import measurements_of
from ringpose.estimate.residuals import Prior
from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.pose import MEASURED_PARAMETERS
from ringpose.types.ring import KnownRadii

KNOWN = KnownRadii(radius_m=np.array([0.5671, 0.5968]), sd_m=np.array([1e-4, 2e-4]))
RIG_PARAMETERS = ("fx", "fy", "cx", "cy", "left.tilt_1", "left.tilt_2", "middle.distance", "right.tilt_2")
RIG_SD = np.array([0.3, 0.3, 0.2, 0.2, 1e-4, 2e-4, 5e-5, 2e-4])
STAMPS_S = np.array([0.0, 0.033, 0.066])


def with_covariance(rig):
    """The rig with a covariance whose parameters are correlated."""
    correlation = 0.3 + 0.7 * np.eye(len(RIG_SD))
    data = RIG_SD[:, None] * correlation * RIG_SD
    return replace(rig, covariance=ParameterCovariance(parameters=RIG_PARAMETERS, data=data))


def with_stripes(points, lasers):
    """Only these lasers' break points and lines."""
    others = [laser for laser in range(3) if laser not in lasers]
    parts = {}
    for name in ("position_px", "covariance_px2", "face_start_px", "face_end_px", "face_sigma_px"):
        parts[name] = getattr(points, name).copy()
        parts[name][others] = np.nan
    return replace(points, stamp_s=STAMPS_S, **parts)


def prior_rows(result, rig):
    """The priors that the record states, as whitened rows [J, z - h] of ring and rig."""
    measurement, priors = result.measurement, result.priors
    columns = len(MEASURED_PARAMETERS) + len(measurement.nuisance_parameters) + 1
    rows = []
    if priors.radius is not None:
        at, of = measurement.linearized_at, priors.radius
        for column, value_m, assumed_m, sd_m in (
            (5, at.radius_inner_m, of.inner_m, of.inner_sd_m),
            (6, at.radius_outer_m, of.outer_m, of.outer_sd_m),
        ):
            row = np.zeros(columns)
            row[column], row[-1] = 1.0 / sd_m, (assumed_m - value_m) / sd_m
            rows.append(row)
    if priors.regularization is not None:
        for prior in priors.regularization:
            row = np.zeros(columns)
            row[: len(MEASURED_PARAMETERS)], row[-1] = prior[:-1], prior[-1]
            rows.append(row)
    if priors.rig_covariance:
        assert measurement.nuisance_parameters == rig.covariance.parameters
        block = np.zeros((len(RIG_SD), columns))
        block[:, len(MEASURED_PARAMETERS) : -1] = np.linalg.inv(np.linalg.cholesky(rig.covariance.data))
        rows.extend(block)
    return np.array(rows).reshape(-1, columns)


@pytest.mark.parametrize("stripes", [(1,), (0, 2), (0, 1, 2)], ids=len)
@pytest.mark.parametrize("known", [None, KNOWN], ids=["radii unknown", "radii known"])
@pytest.mark.parametrize("rig_known", [True, False], ids=["rig exact", "rig with its covariance"])
@pytest.mark.parametrize("edges", [False, True], ids=["no edges", "visible edges"])
def test_the_measurement_and_the_stated_priors_give_the_pose_of_the_record(
    scene_of, face_points, visible_edges, rng, stripes, known, rig_known, edges
):
    scene = scene_of("B", distance_m=0.4)
    rig = scene.rig if rig_known else with_covariance(scene.rig)
    points = with_stripes(face_points(scene, 0.3, 0.02, rng), stripes)
    seen = visible_edges(scene, 40, 0.3, rng) if edges else None

    result = most_likely_pose(points, rig, seen, known)
    best = explain(measurements_of(points, rig, seen), rig, Prior(known), labelled=True, edges_named=True)

    rows = np.concatenate([result.measurement.square_root, prior_rows(result, rig)])
    still = np.delete(rows, range(*RATES.indices(len(MEASURED_PARAMETERS))), axis=1)
    jacobian, target = still[:, :-1], still[:, -1]
    scale = np.linalg.norm(jacobian, axis=0)
    step = np.linalg.lstsq(jacobian / scale, target, rcond=None)[0] / scale
    inverse = np.linalg.pinv(jacobian / scale) / scale[:, None]
    covariance = (inverse @ inverse.T)[POSE, POSE]
    expected = joint_covariance(best.estimate, quantities(best.estimate))[POSE, POSE]
    sd = np.sqrt(np.diag(expected))
    assert (np.abs(step[POSE]) < np.maximum(1e-9, 1e-8 * sd)).all()
    reported = (
        np.zeros(7, dtype=bool) if result.pose.covariance is None else np.isfinite(np.diag(result.pose.covariance))
    )
    difference = (covariance - expected) / np.outer(sd, sd)
    assert np.abs(difference[np.ix_(reported, reported)]).max(initial=0.0) < 1e-6
    assert reported.all() or stripes != (0, 1, 2)
