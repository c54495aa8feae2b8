"""The Cramér-Rao bound from the information form is that of finite differences of the predicted features."""

from dataclasses import replace

import numpy as np
import pytest
from pose.test_bound import LINE_PX, POINT_PX, RADIUS_SD_M, STEPS, center_by_parameters, information, moved
from ring_scenes import (
    PROJECTED,
    Ring,
    break_points_of,
    face_points_of,
    make_camera,
    make_scene,
    pixels_of,
    with_lines,
)

from ringpose.bench.design.bounds import cramer_rao
from ringpose.estimate.nuisance import with_stability
from ringpose.measure.stream import pose_result
from ringpose.types.assumptions import RigStability
from ringpose.types.pose import KnownRadii
from ringpose.types.rig import Rig


def bound_of(scene, rig=None, known=None):
    """The bound of the scene's features, whose pose is exact as they have no errors."""
    rig = rig or scene.rig
    return cramer_rao(pose_result(face_points_of(scene, POINT_PX, LINE_PX), rig, known=known))


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

    assert cramer_rao(result) is None
    assert cramer_rao(known).center_sd_m < 0.01


def of_both_arcs(ring, rig, at_px):
    """Ordinates of the pieces' lines at given abscissae (two a piece), and the abscissae of their ends.

    The rows are pieces: of each laser the left one, then the right one.
    """
    px = pixels_of(ring.crossings_m(rig.lasers), rig.camera)  # laser, edge, left or right
    ends = px.swapaxes(1, 2).reshape(-1, 2, 2)
    slope = (ends[:, 1, 1] - ends[:, 0, 1]) / (ends[:, 1, 0] - ends[:, 0, 0])
    ordinates = ends[:, :1, 1] + slope[:, None] * (at_px - ends[:, :1, 0])
    return np.concatenate([ordinates.ravel(), ends[..., 0].ravel()])


def test_the_bound_of_a_ring_wholly_in_view_counts_both_arcs():
    rig = Rig(camera=make_camera((1600, 1200), (1778.0, 1778.0), (800.0, 600.0)), lasers=PROJECTED)
    normal = np.array([0.1, 0.05, -0.99])
    radius_m = np.array([0.13, 0.15])
    ring = Ring(center_m=np.array([0.02, -0.05, 0.5]), normal=normal / np.linalg.norm(normal), radius_m=radius_m)
    px = pixels_of(ring.crossings_m(rig.lasers), rig.camera)
    left, right = (
        with_lines(break_points_of(px[:, :, side], POINT_PX), px[:, :, side], 2.0 * LINE_PX) for side in (0, 1)
    )

    one = cramer_rao(pose_result(left, rig))
    both = cramer_rao(pose_result(replace(left, opposite=right), rig))

    at_px = px.swapaxes(1, 2).reshape(-1, 2, 2)[..., 0]
    pairs = [[of_both_arcs(moved(ring, sign * step), rig, at_px) for sign in (1.0, -1.0)] for step in np.diag(STEPS)]
    jacobian = np.stack([plus - minus for plus, minus in pairs], axis=-1) / (2.0 * STEPS)
    line = LINE_PX**2 * np.array([[4.0, -2.0], [-2.0, 4.0]])
    weight = np.zeros((24, 24))
    weight[:12, :12] = np.kron(np.eye(6), np.linalg.inv(line))
    weight[12:, 12:] = np.eye(12) / POINT_PX**2
    expected = np.linalg.inv(jacobian.T @ weight @ jacobian)
    to_center = center_by_parameters(ring)
    assert both.center_sd_m == pytest.approx(np.sqrt(np.trace(to_center @ expected @ to_center.T)), rel=0.02)
    assert both.normal_sd_rad == pytest.approx(np.sqrt(np.trace(expected[:2, :2])), rel=0.02)
    assert both.radius_outer_sd_m == pytest.approx(np.sqrt(expected[6, 6]), rel=0.02)
    assert 3.0 * both.normal_sd_rad < one.normal_sd_rad
