"""Gauss-Newton ends at the minimum of the squared residuals, and never in an exception."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import face_points_of, make_scene

from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.linearization import retract_ring, ring_residuals
from ringpose.estimate.measurements import measurements_of
from ringpose.estimate.ring_estimate import DECISION_SIGMAS, estimate_ring, precise_ring
from ringpose.estimate.solver import initial_guess
from ringpose.geometry.ring import CURVATURE, HALF_BAND, LIFT, TILT_ALONG
from ringpose.measure.stream import estimate_pose, pose_result
from ringpose.types.pose import KnownRadii, NoPose, PoseFlag, RingPose
from ringpose.types.rig import ParameterCovariance

INNER_ONLY = KnownRadii(radius_m=np.array([0.567, np.nan]), sd_m=np.full(2, 1e-4))
BOTH = KnownRadii(radius_m=np.array([0.567, 0.597]), sd_m=np.full(2, 1e-4))
PARAMETERS = ("fx", "fy", "cx", "cy", "left.tilt_1", "middle.distance", "right.tilt_2")
SD = np.array([0.3, 0.3, 0.2, 0.2, 2e-4, 5e-5, 2e-4])


def with_covariance(rig):
    return replace(rig, covariance=ParameterCovariance(parameters=PARAMETERS, data=np.diag(SD**2)))


@pytest.fixture
def noisy(rng):
    """Measurements of a noisy shot with wrong ends."""
    scene = make_scene("B", distance_m=0.5)
    points = face_points_of(scene, 0.3, 0.01, rng)
    points.position_px[:, 0, 0] += 1.0, -1.5, 2.5
    return scene.rig, measurements_of(points, scene.rig)


@pytest.mark.parametrize("calibrated", [False, True], ids=["rig exact", "rig with its covariance"])
@pytest.mark.parametrize("radii", [None, INNER_ONLY, BOTH], ids=["radii unknown", "one radius", "both radii"])
def test_the_search_ends_where_the_sum_of_squares_is_least(noisy, calibrated, radii):
    rig, measured = noisy
    measured = replace(measured, rig=with_covariance(rig)) if calibrated else measured
    observations, prior = measured.observations, Prior(radii)

    estimate = estimate_ring(measured, prior)

    def cost(step):
        residuals = ring_residuals(estimate.arcs.retract(step), observations, prior)
        residual = residuals.residual.copy()
        factor, points = observations.points, slice(observations.view.ends, observations.view.ends + 6)
        # in metres along its circle, the noise of a break point is that at the solution
        residual[points] *= factor.scale(estimate.residuals.at) / factor.scale(residuals.at)
        errors = estimate.nuisance_step
        return np.sum((residual + estimate.nuisance @ errors) ** 2) + errors @ errors

    assert (estimate.weights == 1.0).all()
    variance, axes = np.linalg.eigh(estimate.inverse)
    least = cost(np.zeros(7))
    for sd, axis in zip(np.sqrt(variance), axes.T, strict=True):
        up, down = (cost(sign * 0.3 * sd * axis) - least for sign in (1, -1))
        assert up + down > 0
        assert abs(up - down) < 0.3 * (up + down)


def test_an_estimate_is_the_same_from_any_start(noisy):
    _, measured = noisy
    rough = estimate_ring(measured, Prior(), tolerance_sigmas=DECISION_SIGMAS)

    estimate = estimate_ring(measured, Prior())
    others = estimate_ring(measured, Prior(), rough), precise_ring(rough)

    sd = np.sqrt(estimate.inverse.diagonal())
    for other in others:
        assert other.chi2 == pytest.approx(estimate.chi2, rel=1e-9)
        assert abs(other.arcs.curvature - estimate.arcs.curvature) < 1e-7 * sd[CURVATURE]
        assert abs(estimate.arcs.normal @ (other.arcs.origin - estimate.arcs.origin)) < 1e-7 * sd[LIFT]


@pytest.mark.parametrize(("iterations", "status"), [(2, "degraded"), (20, "ok")])
def test_a_pose_whose_iteration_ends_at_its_limit_is_not_ok(monkeypatch, iterations, status):
    scene = make_scene("B", distance_m=0.5, turn_rad=0.7, size="R597")
    points = face_points_of(scene, 0.01, 0.01)
    monkeypatch.setattr("ringpose.estimate.solver.MAX_ITERATIONS", iterations)

    result = pose_result(points, scene.rig)

    weak = PoseFlag.CENTER_WEAK | PoseFlag.NORMAL_WEAK | PoseFlag.GRASP_WEAK | PoseFlag.RADIUS_WEAK
    assert (weak in result.flags) == (status == "degraded")
    assert ("converge" in result.remark) == (status == "degraded")


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("ends_seen", [True, False])
def test_the_search_begins_on_the_rings_plane_and_with_out_on_the_right_side(side, ends_seen):
    scene = make_scene("B", distance_m=0.5, side=side)
    measured = measurements_of(face_points_of(scene, 0.3, 0.01), scene.rig)
    if not ends_seen:
        measured = replace(measured, points=measured.points._replace(x=measured.points.middle_x.copy()))

    start = initial_guess(measured, Prior())

    np.testing.assert_allclose(start.normal, scene.ring.normal, atol=1e-3)
    assert start.origin @ start.normal == pytest.approx(scene.ring.normal @ scene.ring.center_m, rel=1e-3)
    if ends_seen:
        assert -start.axes[0] @ (scene.points_m.mean(axis=(0, 1)) - scene.ring.center_m) > 0.4


def test_a_plane_behind_the_camera_is_no_start(noisy):
    _, measured = noisy
    lasers = measured.rig.lasers
    behind = replace(measured, rig=replace(measured.rig, lasers=replace(lasers, distance_m=-lasers.distance_m)))

    assert initial_guess(behind, Prior()) is None


def test_points_at_the_end_of_the_world_are_left_out_or_no_ring():
    scene = make_scene("B", distance_m=0.5)
    points = face_points_of(scene, 0.3, 0.01)
    points.position_px[0, 0] = 1e7, -1e7

    assert isinstance(estimate_pose(points, scene.rig), RingPose | NoPose)


def test_points_without_lines_that_are_known_impossibly_well_end_the_search_without_a_crash(rng):
    scene = make_scene("B", distance_m=0.5)
    position = scene.position_px + 20.0 * rng.normal(size=scene.position_px.shape)
    points = replace(
        scene.break_points(1e-15), position_px=position, covariance_px2=np.tile(1e-30 * np.eye(2), (3, 2, 1, 1))
    )

    assert isinstance(estimate_pose(points, scene.rig), RingPose | NoPose)


@pytest.mark.parametrize(
    ("parameter", "change"),
    [(LIFT, 1.0), (LIFT, -1e3), (CURVATURE, 1e3), (HALF_BAND, np.inf), (TILT_ALONG, np.nan)],
    ids=["behind the camera", "far away", "tiny", "infinite", "unknown"],
)
def test_a_step_to_an_impossible_ring_ends_the_iteration(noisy, parameter, change):
    _, measured = noisy
    start = estimate_ring(measured, Prior()).residuals

    with np.errstate(invalid="ignore"), pytest.raises(np.linalg.LinAlgError, match="diverges"):
        retract_ring(start, np.where(np.arange(7) == parameter, change, 0.0), np.empty(0))
