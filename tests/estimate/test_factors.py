"""A further kind of measurement is one class: the solver takes it without a change."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from ring_scenes import face_points_of, make_scene, visible_edges_of

from ringpose.estimate.covariance import joint_covariance, quantities
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.linearization import Factor
from ringpose.estimate.measurements import measurements_of
from ringpose.estimate.ring_estimate import estimate_ring
from ringpose.geometry.ring import LIFT, TILT_ALONG, TILT_INWARD

OFFSET = 2
"""Row of the plane's offset in the joint covariance."""

SD_M = 2e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneDistance(Factor):
    """A distance of the camera from the ring's plane, as from a range finder: -(normal . origin)."""

    distance_m: float

    def linearized(self, at):
        """The residual, and its derivatives by tilts and offset of the plane."""
        inward, along, normal = at.arcs.axes
        rows = np.zeros((1, 1 + at.stripes.y_wrt_step.shape[1]))
        rows[0, 0] = self.distance_m + normal @ at.arcs.origin
        for parameter, derivative in (TILT_INWARD, inward @ at.arcs.origin), (TILT_ALONG, along @ at.arcs.origin):
            rows[0, 1 + parameter] = derivative
        rows[0, 1 + LIFT] = 1.0
        return rows / SD_M


def plane_distance(distance_m):
    return PlaneDistance(stamp_s=np.full(1, np.nan), opposite=np.zeros(1, dtype=bool), distance_m=distance_m)


@pytest.fixture(params=["in the dark", "with visible edges"])
def measured(request, rng):
    scene = make_scene("B", distance_m=0.5, tilt_rad=(0.2, -0.15))
    edges = visible_edges_of(scene, 40, 0.3) if request.param == "with visible edges" else None
    return measurements_of(face_points_of(scene, 0.3, 0.03, rng), scene.rig, edges)


def test_a_measured_distance_of_the_plane_updates_the_ring_as_its_closed_form(measured):
    """One number z of variance s^2 changes x by K (z - h x), K = P h / (h P h + s^2), and P by -K h P (Kalman 1960)."""
    without = estimate_ring(measured, Prior())
    found = quantities(without)
    covariance = joint_covariance(without, found)
    offset_m, variance = float(found.normal @ found.center_m), covariance[OFFSET, OFFSET] + SD_M**2
    innovation_m = 0.05 * np.sqrt(variance)

    both = replace(measured, others=(plane_distance(-(offset_m + innovation_m)),))
    estimate = estimate_ring(both, Prior())

    gain = covariance[:, OFFSET] / variance
    updated = quantities(estimate)
    expected = covariance - np.outer(gain, covariance[OFFSET])
    sd = np.sqrt(np.diag(expected)[:7])
    np.testing.assert_allclose(
        joint_covariance(estimate, updated)[:7, :7] / sd / sd[:, None], expected[:7, :7] / sd / sd[:, None], atol=0.01
    )
    moved_m = float(updated.normal @ updated.center_m) - offset_m
    assert moved_m == pytest.approx(gain[OFFSET] * innovation_m, abs=1e-3 * sd[OFFSET])
    change_m = updated.radius_m - found.radius_m
    np.testing.assert_allclose(change_m, gain[5:7] * innovation_m, atol=2e-3 * sd[5:7].min())
    assert estimate.numbers == without.numbers + 1


def test_without_the_further_kind_the_estimate_is_as_before(measured):
    without = estimate_ring(measured, Prior())
    both = replace(measured, others=(plane_distance(0.45),))

    again = estimate_ring(replace(both, others=()), Prior())

    np.testing.assert_allclose(again.arcs.origin, without.arcs.origin, rtol=1e-12)
    np.testing.assert_allclose(again.inverse, without.inverse, rtol=1e-9)


def test_a_stripe_without_break_points_has_no_rows_of_points(measured):
    at, points = estimate_ring(measured, Prior()).residuals.at, measured.observations.points
    by_row = ("stamp_s", "opposite", "edge", "sigma_x", "y", "covariance", "isolated")
    none = replace(points, **{name: getattr(points, name)[:0] for name in by_row})

    residual, _ = none.residuals(at)
    assert (len(residual), len(none.rate(at)), len(none.wrt_ray(at))) == (0, 0, 0)
    assert [len(each) for each in none.ordinate_weights(at)] == [0, 0]


def test_a_shot_whose_break_points_are_all_left_out_has_no_ring_whatever_the_start(measured):
    judged = estimate_ring(measured, Prior())
    none = measured.with_points(np.zeros(len(measured.points.x), dtype=bool))

    assert estimate_ring(none, Prior()) is None
    assert estimate_ring(none, Prior(), judged) is None
