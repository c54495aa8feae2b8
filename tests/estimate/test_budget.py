"""The error budget: the variance of each quantity by its source."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import face_points_of, make_scene, visible_edges_of

from ringpose.measure.stream import pose_line
from ringpose.types.assumptions import NOISE_ONLY, USUAL, AssumptionOptions
from ringpose.types.detection import Detection
from ringpose.types.pose import KnownRadii, PoseLine

STAMPS_S = 100.0 + np.arange(3) / 10
KNOWN = KnownRadii(radius_m=np.array([0.567, 0.597]), sd_m=np.array([5e-4, 5e-4]))


@pytest.fixture
def scene():
    return make_scene("B", distance_m=0.5, tilt_rad=(0.15, -0.1))


def line_of(points, scene, edges=None, **how) -> PoseLine:
    source = Detection(shot="a", stamp_s=100.0, break_points=points, ring_edges=edges, still="options" in how)
    return pose_line(source, scene.rig, **how, with_budget=True)


def reported(line: PoseLine) -> dict[str, float]:
    """The variances in the covariance of a line."""
    pose = line.pose
    outward = pose.grasp_m - pose.center_m
    outward = outward - (outward @ pose.normal) * pose.normal
    across = np.array([pose.normal, outward / np.linalg.norm(outward)])
    along, radial = (across @ pose.covariance_grasp_m2 @ across.T).diagonal()
    center = dict(zip("xyz", pose.covariance_center_m2.diagonal(), strict=True))
    return {
        "grasp_normal_m2": along,
        "grasp_radial_m2": radial,
        "normal_rad2": np.trace(pose.covariance[:2, :2]),
        **{f"center_{axis}_m2": variance for axis, variance in center.items()},
    }


def dark(scene, rng):
    return line_of(face_points_of(scene, 0.1, 0.02, rng), scene, options=AssumptionOptions(still=True))


def lit(scene, rng):
    edges = visible_edges_of(scene, 120, 0.1, rng)
    return line_of(face_points_of(scene, 0.1, 0.02, rng), scene, edges, options=AssumptionOptions(still=True))


def moving(scene, rng):
    points = replace(face_points_of(scene, 0.05, 0.01, rng), stamp_s=STAMPS_S)
    return line_of(points, scene, known=KNOWN)


@pytest.mark.parametrize(
    ("made", "sources"),
    [
        (dark, {"image_noise", "stability", "form"}),
        (lit, {"image_noise", "stability", "form"}),
        (moving, {"image_noise", "stability", "form", "motion", "radius_prior"}),
    ],
)
def test_the_sources_add_up_to_the_covariance(scene, rng, made, sources):
    line = made(scene, rng)

    for name, variance in reported(line).items():
        assert sum(line.budget[name].values()) == pytest.approx(variance, rel=1e-9)
        assert sources <= set(line.budget[name])
        assert "contradiction" not in line.budget[name]
        assert min(line.budget[name].values()) > -1e-9 * variance


def test_a_still_perfect_ring_and_rig_leave_the_noise_of_the_image(scene, rng):
    line = line_of(face_points_of(scene, 0.1, 0.02, rng), scene, options=NOISE_ONLY)

    for variances in line.budget.values():
        own = variances["image_noise"]
        assert sum(variances.values()) - own < 0.2 * own  # second order, and the ridge


def test_the_stability_counts_with_its_square(scene, rng):
    points = face_points_of(scene, 0.02, 0.005, rng)
    small, large = (
        line_of(points, scene, options=AssumptionOptions(still=True, ring_tolerance_m=0.0, rig_stability=factor))
        for factor in (3.0, 10.0)
    )

    assert large.budget["normal_rad2"]["stability"] > large.budget["normal_rad2"]["image_noise"]
    ratio = large.budget["normal_rad2"]["stability"] / small.budget["normal_rad2"]["stability"]
    assert ratio == pytest.approx((10.0 / 3.0) ** 2, rel=0.2)


def test_a_line_has_no_budget_unless_it_is_asked_for(scene, rng):
    source = Detection(shot="a", stamp_s=100.0, break_points=face_points_of(scene, 0.1, 0.02, rng), ring_edges=None)

    assert not pose_line(source, scene.rig, options=USUAL).budget


@pytest.mark.slow
def test_image_noise_is_the_scatter_of_estimates_from_other_images(scene, rng):
    """The estimator assumes errors of rig and form, which stay the same: only the noise is drawn."""
    options = AssumptionOptions(still=True)
    lines = [line_of(face_points_of(scene, 0.05, 0.01, rng), scene, options=options) for _ in range(200)]

    centers = np.array([line.pose.center_m for line in lines])
    for axis, scatter in zip("xyz", centers.std(axis=0, ddof=1), strict=True):
        expected = np.median([line.budget[f"center_{axis}_m2"]["image_noise"] for line in lines]) ** 0.5
        assert scatter == pytest.approx(expected, rel=0.2)
