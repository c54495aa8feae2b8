from dataclasses import replace

import numpy as np
import pytest
from known_views import projected_px
from scipy.optimize import brentq

from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig
from ringpose.simulate.pipeline import illuminated_ring, view_truth
from ringpose.types.rig import LaserBow
from ringpose.types.scene import RingView
from ringpose.types.target import Gap, RingForm, RingShape, sloping


def truth_of(scene, view):
    return view_truth(scene, view, illuminated_ring(scene, view))


def point_where_circle_meets_plane(view, radius_m, normal, distance_m):
    """Point of the circle on the light plane near the camera's axis, by root finding."""
    first = np.cross([0.0, 1.0, 0.0], view.normal)
    first /= np.linalg.norm(first)
    second = np.cross(view.normal, first)
    towards = -view.center_m
    start = np.arctan2(towards @ second, towards @ first)

    def point(angle):
        return view.center_m + radius_m * (np.cos(angle) * first + np.sin(angle) * second)

    return point(brentq(lambda angle: normal @ point(angle) - distance_m, start - 0.6, start + 0.6, xtol=1e-15))


@pytest.mark.parametrize("edge", [0, 1])
@pytest.mark.parametrize("laser", [0, 1, 2])
def test_break_points_lie_on_circle_and_light_plane(scene, view, laser, edge):
    radius_m = (0.567, 0.597)[edge]
    planes = scene.rig.lasers
    point = point_where_circle_meets_plane(view, radius_m, planes.normal[laser], planes.distance_m[laser])

    truth = truth_of(scene, view)

    assert truth.expect == "pose"
    error_px = np.linalg.norm(truth.break_points_px[laser, edge] - projected_px(point[None], scene.rig.camera)[0])
    assert error_px < 1e-9


def test_a_break_point_outside_image_or_fan_is_null_and_the_shot_partial(scene, view):
    near = replace(view, center_m=view.center_m - [0.0, 0.0, 0.30])

    truth = truth_of(scene, near)

    assert truth.expect == "partial"
    assert np.isnan(truth.break_points_px).any()
    narrow = replace(scene, lasers=replace(scene.lasers, fan_rad=0.01))
    assert truth_of(narrow, view).expect != "pose"


@pytest.mark.parametrize("change", [{"center_m": np.array([2.0, 0.0, 0.5])}, {"target": "body"}, {"target": "none"}])
def test_a_view_without_ring_has_no_target(scene, view, change):
    truth = truth_of(scene, replace(view, **change))

    assert (truth.expect, truth.center_m) == ("no_target", None)


FLAT = [[0.56, 0.0], [0.56, 0.06], [0.60, 0.06], [0.60, 0.0]]
RIM = [[0.55, 0.0], [0.555, 0.16], [0.56, 0.06], [0.60, 0.06], [0.60, 0.0]]
"""A knife edge 100 mm higher than the face, just inside of it."""


@pytest.mark.parametrize(("profile_m", "seen"), [(FLAT, True), (RIM, False)])
def test_a_break_point_behind_a_rim_is_null(scene, view, profile_m, seen):
    """The camera looks from inside the ring, whose rim occludes the outer edge."""
    inside = replace(view, center_m=np.array([-0.45, -0.08, 0.47]))
    rimmed = replace(scene, ring=RingShape(profile_m=np.array(profile_m)))

    truth = truth_of(rimmed, inside)

    assert np.isfinite(truth.break_points_px[1, 0]).all() == seen


@pytest.mark.parametrize("folder", ["rig_a", "rig_b"])
def test_truth_agrees_with_external_renders(scene, shared_data, folder):
    rig = read_rig(shared_data / "rendered" / folder / "rig.yaml")
    theirs = [
        truth for truth in read_truths(shared_data / "rendered" / folder / "truth.jsonl") if truth.normal is not None
    ]

    ours = [truth_of(scene_of(scene, rig, truth), view_of(truth)) for truth in theirs]

    for_compare = [np.stack([t.break_points_px for t in truths]) for truths in (ours, theirs)]
    np.testing.assert_allclose(*for_compare, atol=1e-3)
    assert [t.expect for t in ours] == [t.expect for t in theirs]


def scene_of(scene, rig, truth):
    inner_m, outer_m = truth.radius_inner_m, truth.radius_outer_m
    profile_m = [[inner_m, 0], [inner_m, 0.06], [outer_m, 0.06], [outer_m, 0]]
    return replace(scene, rig=rig, ring=RingShape(profile_m=np.array(profile_m)))


def view_of(truth):
    return RingView(name=truth.shot, center_m=truth.center_m, normal=truth.normal)


@pytest.mark.parametrize("edge", [0, 1])
def test_break_points_of_a_deformed_ring_lie_on_its_edge_and_the_light_plane(scene, view, rng, edge):
    """The edge is a circle with radial and axial Fourier terms of the orders 2 to 4, solved by root finding."""
    form = RingForm(radial_m=3e-4 * rng.standard_normal((2, 3, 2)), axial_m=3e-4 * rng.standard_normal((3, 2)))
    deformed = replace(scene, ring=replace(scene.ring, form=form))
    illuminated, planes = illuminated_ring(deformed, view), scene.rig.lasers
    placement, radius_m = illuminated.placement, (0.567, 0.597)[edge]

    def point(angle):
        waves = np.array([[np.cos(k * angle), np.sin(k * angle)] for k in (2, 3, 4)])
        r, z = radius_m + (waves * form.radial_m[edge]).sum(), 0.06 + (waves * form.axial_m).sum()
        return placement.points_camera(np.array([r * np.cos(angle), r * np.sin(angle), z]))

    truth, ideal = truth_of(deformed, view), truth_of(scene, view)

    for laser in range(3):
        normal, distance_m = planes.normal[laser], planes.distance_m[laser]
        angle = brentq(lambda a, n=normal, d=distance_m: n @ point(a) - d, -0.6, 0.6, xtol=1e-15)
        expected_px = projected_px(point(angle)[None], scene.rig.camera)[0]
        np.testing.assert_allclose(truth.break_points_px[laser, edge], expected_px, atol=1e-9)
    assert np.abs(truth.break_points_px - ideal.break_points_px).max() > 0.05


@pytest.mark.parametrize("edge", [0, 1])
def test_break_points_of_a_sloping_face_lie_on_circles_at_the_heights_of_its_edges(scene, view, edge):
    cone, planes = replace(scene, ring=sloping(scene.ring, 0.0262)), scene.rig.lasers
    above_m = np.tan(0.0262) * (-0.015, 0.015)[edge]
    circle = replace(view, center_m=view.center_m + above_m * view.normal)

    truth = truth_of(cone, view)

    np.testing.assert_allclose(truth.center_m, view.center_m, atol=1e-12)
    for laser in range(3):
        place = (0.567, 0.597)[edge], planes.normal[laser], planes.distance_m[laser]
        expected_px = projected_px(point_where_circle_meets_plane(circle, *place)[None], scene.rig.camera)[0]
        np.testing.assert_allclose(truth.break_points_px[laser, edge], expected_px, atol=1e-9)


@pytest.mark.parametrize("stated_by", ["scene", "rig", "both"])
@pytest.mark.parametrize("edge", [0, 1])
def test_break_points_of_bent_sheets_are_on_rays_that_rise_with_the_square_of_their_angle(scene, view, edge, stated_by):
    """Of the rays of a fan, the one that meets the circle is found by its angle, without the plane's equation."""
    bow, radius_m, planes = 0.2, (0.567, 0.597)[edge], scene.rig.lasers
    of_scene = {"scene": bow, "rig": 0.0, "both": 0.5 * bow}[stated_by]
    bows = {name: LaserBow(per_rad=bow - of_scene, sd_per_rad=0.0) for name in planes.names}
    bent = replace(scene, lasers=replace(scene.lasers, bow_per_rad=of_scene), rig=replace(scene.rig, bows=bows))

    points_px = truth_of(bent, view).break_points_px

    for laser in range(3):
        normal, projector_m = planes.normal[laser], planes.projector_m[laser]
        axis = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
        axis /= np.linalg.norm(axis)
        aside = np.cross(normal, axis)

        def on_face(angle, axis=axis, aside=aside, normal=normal, projector_m=projector_m):
            elevation = bow * angle**2
            ray = np.cos(elevation) * (np.cos(angle) * axis + np.sin(angle) * aside) + np.sin(elevation) * normal
            return projector_m + ray * ((view.center_m - projector_m) @ view.normal) / (ray @ view.normal)

        angle = brentq(lambda a, at=on_face: np.linalg.norm(at(a) - view.center_m) - radius_m, -0.3, 0.3, xtol=1e-14)
        expected_px = projected_px(on_face(angle)[None], scene.rig.camera)[0]
        np.testing.assert_allclose(points_px[laser, edge], expected_px, atol=1e-4)
    assert np.nanmax(np.abs(points_px - truth_of(scene, view).break_points_px)) > 0.3


def test_a_break_point_in_a_gap_is_null(scene, view):
    """The gap is where the second laser meets the ring; the stripes of the others are farther away than its width."""
    target = illuminated_ring(scene, view).placement
    plane = scene.rig.lasers.normal[1], scene.rig.lasers.distance_m[1]
    at = target.points_target(point_where_circle_meets_plane(view, 0.582, *plane)[:, None])[:, 0]
    gap = Gap(angle_rad=float(np.arctan2(at[1], at[0])), width_m=0.02, depth_m=0.01)

    truth = truth_of(replace(scene, ring=replace(scene.ring, gaps=(gap,))), view)

    np.testing.assert_array_equal(np.isnan(truth.break_points_px[..., 0]).all(axis=1), [False, True, False])
    assert truth.expect == "partial"
