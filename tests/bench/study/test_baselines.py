"""Baselines find a ring exactly from exact features, and return no pose where they cannot."""

import numpy as np
import pytest
from ring_scenes import RIGS, make_scene, pixels_of

from ringpose.bench.study.baselines import BASELINES, circle_poses
from ringpose.types.detection import Detection, NoBreakPoints, RingEdgePoints
from ringpose.types.pose import KnownRadii, NoPose, RingPose
from ringpose.types.study import StudyMethod

OF_POINTS = (StudyMethod.BISECTORS, StudyMethod.POINTS)
OF_ELLIPSE = (StudyMethod.ELLIPSE, StudyMethod.ELLIPSE_REFINED)


def circle_points(center_m, normal, radius_m, angles):
    first = np.cross([0.3, 1.0, 0.2], normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    return center_m + radius_m * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)


@pytest.fixture
def far_ring():
    """Centre, normal and radii of a ring that is wholly in view."""
    normal = np.array([0.3, -0.2, -1.0])
    return (
        np.array([0.05, -0.1, 3.0]),
        normal / np.linalg.norm(normal),
        KnownRadii(radius_m=np.array([0.567, 0.597]), sd_m=np.full(2, 1e-3)),
    )


def edges_of(ring, rig, angles):
    """Detection of the visible points of both edges."""
    center_m, normal, radii = ring
    points_m = np.concatenate([circle_points(center_m, normal, radius_m, angles) for radius_m in radii.radius_m])
    count = len(points_m)
    edges = RingEdgePoints(
        position_px=pixels_of(points_m, rig.camera),
        normal=np.tile([1.0, 0.0], (count, 1)),
        sigma_px=np.full(count, 0.1),
        edge=np.repeat([0, 1], len(angles)),
    )
    return Detection(shot="a", stamp_s=0.0, break_points=NoBreakPoints.NO_STRIPE, ring_edges=edges)


@pytest.mark.parametrize("method", OF_POINTS)
@pytest.mark.parametrize("rig", ["A", "B"])
def test_methods_of_six_points_find_the_ring_of_exact_points(method, rig):
    scene = make_scene(rig, distance_m=0.5)
    detection = Detection(shot="a", stamp_s=0.0, break_points=scene.break_points())

    pose = BASELINES[method](detection, scene.rig, KnownRadii(radius_m=np.full(2, np.nan), sd_m=np.ones(2)))

    assert np.linalg.norm(pose.center_m - scene.ring.center_m) < 1e-6
    assert pose.normal @ scene.ring.normal > 1 - 1e-12
    assert [pose.radius_inner_m, pose.radius_outer_m] == pytest.approx(scene.ring.radius_m, abs=1e-6)
    off_band = pose.grasp_m - scene.ring.center_m
    assert np.linalg.norm(off_band) == pytest.approx(scene.ring.radius_m.mean(), abs=1e-6)


def test_one_of_the_two_circles_of_a_conic_is_the_one_that_was_projected(far_ring):
    center_m, normal, radii = far_ring
    points_m = circle_points(center_m, normal, radii.radius_m[1], np.linspace(0, 6, 5))
    x, y = (points_m[:, :2] / points_m[:, 2:]).T
    rows = np.stack([x * x, 2 * x * y, y * y, 2 * x, 2 * y, np.ones(5)], axis=1)
    a, b, c, d, e, f = np.linalg.svd(rows)[2][-1]  # the conic through five points

    poses = circle_poses(np.array([[a, b, d], [b, c, e], [d, e, f]]), radii.radius_m[1])

    errors = [np.linalg.norm(found_m - center_m) + np.linalg.norm(axis - normal) for found_m, axis in poses]
    assert len(poses) == 2
    assert min(errors) < 1e-9
    assert max(errors) > 0.1


@pytest.mark.parametrize(("method", "limit_m"), [(OF_ELLIPSE[0], 2e-3), (OF_ELLIPSE[1], 1e-7)])
def test_the_ellipse_of_a_whole_ring_gives_its_pose(far_ring, method, limit_m):
    rig = RIGS["B"]
    detection = edges_of(far_ring, rig, np.linspace(0, 2 * np.pi, 200, endpoint=False))

    pose = BASELINES[method](detection, rig, far_ring[2])

    assert np.linalg.norm(pose.center_m - far_ring[0]) < limit_m
    assert pose.normal @ far_ring[1] > 1 - 1e-4


def test_without_visible_edges_there_is_no_ellipse(far_ring):
    scene = make_scene("B")
    detection = Detection(shot="a", stamp_s=0.0, break_points=scene.break_points())

    for method in OF_ELLIPSE:
        assert "visible" in BASELINES[method](detection, scene.rig, far_ring[2])


@pytest.mark.parametrize("method", OF_POINTS)
def test_two_stripes_are_too_few(method, far_ring):
    scene = make_scene("B")
    scene.position_px[2] = np.nan
    detection = Detection(shot="a", stamp_s=0.0, break_points=scene.break_points())

    pose = BASELINES[method](detection, scene.rig, far_ring[2])

    assert pose is NoPose.TOO_FEW_BREAK_POINTS
    assert not isinstance(pose, RingPose)
