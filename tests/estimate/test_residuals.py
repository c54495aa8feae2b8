"""Jacobians of all residuals, against central differences."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import face_points_of, make_scene, visible_edges_of

from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.linearization import ring_residuals
from ringpose.estimate.measurements import measurements_of
from ringpose.geometry.ring import ring_arcs
from ringpose.types.pose import KnownRadii

STEP = 1e-6
RADII = KnownRadii(radius_m=np.array([0.567, 0.597]), sd_m=np.array([0.001, 0.002]))


@pytest.fixture(params=["points alone", "stripes", "stripes and edges"])
def measured(request):
    scene = make_scene("B", distance_m=0.5, tilt_rad=(0.2, -0.15), turn_rad=0.3)
    points = scene.break_points(0.3) if request.param == "points alone" else face_points_of(scene, 0.3, 0.03)
    edges = visible_edges_of(scene, 40, 0.2) if request.param == "stripes and edges" else None
    return scene, measurements_of(points, scene.rig, edges)


def some_arcs(scene, rng):
    """A ring some way off the true one."""
    ring = scene.ring
    arcs = ring_arcs(ring.center_m, ring.normal, ring.radius_m, scene.points_m.mean(axis=(0, 1)))
    return arcs.retract(np.array([0.02, 0.02, 0.01, 0.005, 0.05, 0.2, 0.002]) * rng.uniform(-1.0, 1.0, 7))


def unscaled(residuals, points):
    """The rows in units that do not change with the state: the noise of a break point's distance does."""
    residual, ends = residuals.residual.copy(), residuals.observations.view.ends
    residual[ends : ends + points] /= residuals.observations.points.scale(residuals.at)
    return residual[: ends + points]


@pytest.mark.parametrize("parameter", range(7))
def test_rows_of_stripes_and_points_have_the_derivatives_of_central_differences(measured, rng, parameter):
    scene, shot = measured
    arcs, count = some_arcs(scene, rng), len(shot.points.x)
    observations, step = shot.observations, STEP * np.eye(7)[parameter]
    residuals = ring_residuals(arcs, observations, Prior())

    forward, backward = (
        unscaled(ring_residuals(arcs.retract(sign * step), observations, Prior()), count) for sign in (1, -1)
    )

    derivative = residuals.jacobian[: len(forward), parameter].copy()
    derivative[observations.view.ends :] /= observations.points.scale(residuals.at)
    scale = max(1e-3, np.abs(derivative).max())
    np.testing.assert_allclose(derivative / scale, (forward - backward) / (2 * STEP) / scale, rtol=0, atol=1e-5)


@pytest.mark.parametrize("parameter", range(7))
def test_known_radii_have_the_derivatives_of_central_differences(measured, rng, parameter):
    scene, shot = measured
    arcs, prior = some_arcs(scene, rng), Prior(RADII)
    residuals = ring_residuals(arcs, shot.observations, prior)

    forward, backward = (
        ring_residuals(arcs.retract(sign * STEP * np.eye(7)[parameter]), shot.observations, prior).residual[-2:]
        for sign in (1, -1)
    )

    np.testing.assert_allclose(residuals.jacobian[-2:, parameter], (forward - backward) / (2 * STEP), rtol=0, atol=1e-4)


def test_derivatives_of_visible_edges_do_not_contain_errors_of_the_points(rng):
    """A correlation of both would bias what many shots have in common, such as errors of the rig."""
    scene = make_scene("B")
    points, exact, errors = face_points_of(scene, 0.3, 0.03), visible_edges_of(scene, 40, 0.3), rng.normal(size=40)
    noisy = replace(exact, position_px=exact.position_px + 0.3 * errors[:, None] * exact.normal)
    ring = scene.ring
    arcs = ring_arcs(ring.center_m, ring.normal, ring.radius_m, scene.points_m.mean(axis=(0, 1)))

    without, with_errors = (
        ring_residuals(arcs, measurements_of(points, scene.rig, edges).observations, Prior())
        for edges in (exact, noisy)
    )

    rows = np.flatnonzero(without.observations.many)
    np.testing.assert_allclose(np.abs(with_errors.residual[rows]), np.abs(errors), atol=0.003)
    scale = np.abs(without.jacobian[rows]).max(axis=0)
    assert (np.abs(with_errors.jacobian[rows] - without.jacobian[rows]) < 2e-5 * scale).all()
