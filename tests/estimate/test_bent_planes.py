"""Rings measured with light planes that are bent, from features that are known by construction."""

from dataclasses import replace

import numpy as np
import pytest
from bent_sheets import BOW_PER_RAD, bent_features, bent_rig
from ring_scenes import PROJECTED, nees, ring_at
from scipy.stats import chi2

from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.linearization import ring_residuals
from ringpose.estimate.measurements import measurements_of
from ringpose.estimate.nuisance import covariance_root, rig_errors, rig_jacobian, total_covariance
from ringpose.estimate.ring_estimate import estimate_ring
from ringpose.geometry.ring import ring_arcs
from ringpose.geometry.sheets import bends, bends_in_planes
from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.types.assumptions import Assumptions, RigStability
from ringpose.types.rig import BOW_PARAMETERS, ParameterCovariance, bow_parameters

BENT = [name for name, bow in zip(PROJECTED.names, BOW_PER_RAD, strict=True) if bow]
SDS = np.array([3e-4, 3e-3, 0.02])
STILL = Assumptions(motion=None, ring_tolerance_m=0.0, stability=RigStability())


def with_bows(rig, change):
    """The rig with other `BOW_PARAMETERS`, by laser."""
    lasers = rig.lasers
    per_rad = np.array([rig.bows[name].per_rad if name in rig.bows else 0.0 for name in lasers.names])
    own = bends_in_planes(lasers.normal, bends(lasers.normal, per_rad, lasers.projector_m).parameters + change)
    bows = {name: replace(bow, per_rad=float(own.per_rad[lasers.names.index(name)])) for name, bow in rig.bows.items()}
    return replace(rig, bows=bows, lasers=replace(lasers, projector_m=own.projector_m))


def with_uncertain_bows(rig):
    names = bow_parameters(BENT)
    return replace(rig, covariance=ParameterCovariance(parameters=names, data=np.diag(np.tile(SDS, len(BENT)) ** 2)))


@pytest.mark.parametrize("distance_m", [0.35, 0.5])
def test_exact_features_of_bent_planes_give_the_ring(distance_m):
    rig = bent_rig()
    ring = ring_at(rig, distance_m=distance_m)
    features = bent_features(ring, rig, 0.3, 0.03)

    found, flat = (
        estimate_ring(measurements_of(features, each), Prior(assumptions=STILL)).arcs
        for each in (rig, replace(rig, bows={}))
    )

    assert np.linalg.norm(found.center - ring.center_m) < 2e-6
    assert np.linalg.norm(found.normal - ring.normal) < 2e-6
    assert np.linalg.norm(flat.normal - ring.normal) > 1e-3


@pytest.mark.parametrize("parameter", range(len(BOW_PARAMETERS)))
def test_residuals_have_the_derivatives_of_central_differences_by_the_bends(parameter):
    rig = with_uncertain_bows(bent_rig())
    ring = ring_at(rig)
    points, step = bent_features(ring, rig, 0.3, 0.03), np.zeros((3, 3))
    near_m = ring.break_points_m(rig.lasers).mean(axis=(0, 1))
    arcs = ring_arcs(ring.center_m, ring.normal, ring.radius_m, near_m)
    step[2, parameter] = 1e-3 * SDS[parameter]

    there, back = (
        ring_residuals(arcs, measurements_of(points, with_bows(rig, sign * step)).observations, Prior()).residual
        for sign in (1, -1)
    )

    errors = rig_errors(rig)
    residuals = ring_residuals(arcs, measurements_of(points, rig).observations, Prior())
    jacobian, _ = rig_jacobian(residuals, errors)
    analytic = jacobian[:, errors.parameters.index(f"right.{BOW_PARAMETERS[parameter]}")]
    assert np.abs(analytic * SDS[parameter]).max() > 0.01
    np.testing.assert_allclose(analytic * SDS[parameter], (there - back) / 2e-3, rtol=0, atol=2e-3)


def test_errors_of_the_bends_are_in_the_covariance_of_the_pose(rng):
    """NEES over drawn bends, with the covariance that says how well they are known, and without."""
    rig, draws = with_uncertain_bows(bent_rig()), 60
    root = covariance_root(rig.covariance.data)
    with_errors, without = [], []
    for _ in range(draws):
        change = np.zeros((3, 3))
        change[[PROJECTED.names.index(name) for name in BENT]] = (root @ rng.normal(size=root.shape[1])).reshape(-1, 3)
        ring = ring_at(rig, distance_m=0.4, tilt_rad=rng.uniform(-0.15, 0.15, 2))
        points = bent_features(ring, with_bows(rig, change), 0.1, 0.01, rng)
        exact = replace(rig, covariance=None, bows={n: replace(b, sd_per_rad=0.0) for n, b in rig.bows.items()})
        for each, table in ((rig, with_errors), (exact, without)):
            table.append(list(nees(most_likely_pose(points, each, assumptions=STILL).pose, ring).values()))

    low, high = chi2.ppf([5e-4, 1 - 5e-4], 2 * draws) / (2 * draws)
    normal, grasp, _ = np.mean(with_errors, axis=0)
    assert low < normal < high
    assert low < grasp < high
    assert np.nanmean(without, axis=0)[0] > 1.5 * high


def test_a_bow_without_a_covariance_is_as_uncertain_as_the_rig_file_says():
    total = total_covariance(bent_rig(covariance=None), RigStability())

    assert total.parameters == tuple(f"{name}.bow" for name in BENT)
    np.testing.assert_array_equal(total.data, 1e-8 * np.eye(len(BENT)))
