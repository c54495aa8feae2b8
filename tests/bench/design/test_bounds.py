"""The Cramér-Rao bound from the information form is that of finite differences of the predicted features."""

import numpy as np
import pytest
from pose.test_bound import LINE_PX, POINT_PX, RADIUS_SD_M, center_by_parameters, information
from ring_scenes import face_points_of, make_scene

from ringpose.bench.design.bounds import cramer_rao
from ringpose.estimate.nuisance import with_stability
from ringpose.measure.stream import pose_result
from ringpose.types.assumptions import RigStability
from ringpose.types.pose import KnownRadii


def bound_of(scene, rig=None, known=None):
    """The bound of the scene's features, whose pose is exact as they have no errors."""
    rig = rig or scene.rig
    return cramer_rao(pose_result(face_points_of(scene, POINT_PX, LINE_PX), rig, known=known), rig)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("distance_m", [0.3, 0.5])
def test_the_bound_is_the_inverse_of_fishers_matrix_by_finite_differences(distance_m, known):
    scene = make_scene("B", distance_m=distance_m)
    radii = KnownRadii(radius_m=scene.ring.radius_m, sd_m=np.full(2, RADIUS_SD_M)) if known else None

    bound = bound_of(scene, known=radii)

    expected = np.linalg.inv(information(scene, known))
    to_center = center_by_parameters(scene.ring)
    center_sd_m = np.sqrt(np.trace(to_center @ expected @ to_center.T))
    assert bound.center_sd_m == pytest.approx(center_sd_m, rel=0.02)
    assert bound.normal_sd_rad == pytest.approx(np.sqrt(np.trace(expected[:2, :2])), rel=0.02)
    assert bound.radius_outer_sd_m == pytest.approx(np.sqrt(expected[6, 6]), rel=0.02)


def test_a_rig_that_may_have_changed_never_lowers_the_bound():
    scene = make_scene("B", distance_m=0.5)
    exact = bound_of(scene)
    changed = with_stability(scene.rig, RigStability(plane_tilt_rad=1e-4, plane_distance_m=2e-5, focal_ratio=1e-4))

    bound = bound_of(scene, changed)

    assert np.linalg.eigvalsh(bound.parameters - exact.parameters).min() > -1e-12
    # rig B at 0.5 m: 0.14 degrees by noise alone, 0.29 with the default stability (ringpose-method(7), section 11)
    assert np.degrees(bound.normal_sd_rad) == pytest.approx(0.29, rel=0.15)


def test_two_stripes_determine_the_ring_only_with_its_radii():
    scene = make_scene("B", distance_m=0.5)
    points = face_points_of(scene, POINT_PX, LINE_PX)
    for part in (points.position_px, points.face_start_undistorted_px, points.face_end_undistorted_px):
        part[2] = np.nan
    result = pose_result(points, scene.rig)

    radii = KnownRadii(radius_m=scene.ring.radius_m, sd_m=np.full(2, RADIUS_SD_M))
    known = pose_result(points, scene.rig, known=radii)

    assert cramer_rao(result, scene.rig) is None
    assert cramer_rao(known, scene.rig).center_sd_m < 0.01
