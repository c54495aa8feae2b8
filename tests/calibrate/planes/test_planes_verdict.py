"""The verdict on light planes, their angles, and what their covariance means for depths."""

from dataclasses import replace

import numpy as np
import pytest
from known_views import NORMALS, TRUE_CAMERA, stripe_views, true_poses

from ringpose.calibrate.camera.parameters import parameter_names
from ringpose.calibrate.planes.covariance import depth_sd_m
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import plane_angles, planes_verdict
from ringpose.geometry.rays import project, rays
from ringpose.geometry.rotations import tilt_basis, tilted
from ringpose.types.calibration import Grade
from ringpose.types.rig import ParameterCovariance, Rig

MODEL = PlanesModel(names=("left", "middle", "right"))


def facing(depths_m):
    return [(np.eye(3), np.array([-0.15, -0.12, depth])) for depth in depths_m]


@pytest.fixture(scope="module")
def good():
    views = stripe_views(facing([0.4, 0.45, 0.5, 0.55, 0.6, 0.65]), np.random.default_rng(3), 0.02, 0.05)
    return calibrate_planes(views, TRUE_CAMERA, MODEL)


def poor_names(calibration, **options):
    return {finding.name for finding in planes_verdict(calibration, **options).findings if finding.grade != Grade.GOOD}


@pytest.mark.parametrize("way", [(0, 1, 2), (2, 1, 0)], ids=["as named", "left and right exchanged in all shots"])
def test_six_views_over_a_range_of_distances_are_graded_good(way, good):
    assert planes_verdict(renamed(good, way)).grade is Grade.GOOD


def test_two_views_can_be_improved_by_more(rng):
    few = calibrate_planes(stripe_views(facing([0.4, 0.6]), rng, 0.02, 0.05), TRUE_CAMERA, MODEL)

    verdict = planes_verdict(few)

    assert verdict.grade is Grade.IMPROVABLE
    assert {"views", "held_out_rms_m"} <= poor_names(few)
    assert "add views that show the stripe of left: six to ten are good" in verdict.advice


def test_views_at_one_distance_ask_for_nearer_and_farther_ones(rng):
    alike = [(turn, place * 0.5 / (place + turn @ [0.15, 0.12, 0])[2]) for turn, place in true_poses(rng, 6)]
    calibration = calibrate_planes(stripe_views(alike, rng, 0.02, 0.05), TRUE_CAMERA, MODEL)

    assert "distance_ratio" in poor_names(calibration)
    assert any(
        advice.startswith("add views of the board nearer than 0.") for advice in planes_verdict(calibration).advice
    )


def test_points_scattered_by_a_millimetre_are_graded_redo(rng):
    views = stripe_views(facing([0.4, 0.45, 0.5, 0.55, 0.6, 0.65]), rng, 0.02, 6.0)

    assert planes_verdict(calibrate_planes(views, TRUE_CAMERA, MODEL)).grade is Grade.REDO


def test_a_view_whose_board_moved_by_a_fifth_of_a_millimetre_is_named(rng):
    """Too little to be left out: all its stripes lie 0.4 px aside, and the views disagree."""
    views = stripe_views(true_poses(rng, 8), rng, 0.02, 0.1)
    views[2] = replace(views[2], stripes_px=tuple(px + np.array([0.0, 0.4]) for px in views[2].stripes_px))

    calibration = calibrate_planes(views, TRUE_CAMERA, MODEL)

    (excess,) = (finding for finding in planes_verdict(calibration).findings if finding.name == "variance_excess")
    assert excess.grade is not Grade.GOOD
    assert "the views disagree, v2 most of all" in excess.advice


def test_lasers_at_unexpected_angles_are_reported(good):
    verdict = planes_verdict(good, np.radians([10.3, 14.0]).tolist())

    poor = [(finding.name, finding.place) for finding in verdict.findings if finding.grade is not Grade.GOOD]
    assert poor == [("angle_error_rad", "middle to right")]


def test_an_angle_is_that_between_the_normals_with_the_deviation_of_drawn_planes(good, rng):
    (angle, other) = plane_angles(good)
    wanted = [np.arccos(NORMALS[i] @ NORMALS[i + 1]) for i in range(2)]
    assert [angle["angle_rad"], other["angle_rad"]] == pytest.approx(wanted, abs=1e-4)
    covariance = good.covariance
    places = [covariance.parameters.index(f"{name}.tilt_{i}") for name in ("left", "middle") for i in (1, 2)]
    drawn = rng.multivariate_normal(np.zeros(4), covariance.data[np.ix_(places, places)], 2000)

    normals = good.planes.normal
    angles = [np.arccos(tilted(normals[0], each[:2]) @ tilted(normals[1], each[2:])) for each in drawn]

    assert np.std(angles) == pytest.approx(angle["sd_rad"], rel=0.1)


def test_depth_deviations_are_those_of_drawn_rigs(good, rng):
    """Cameras and planes drawn from the covariance, each triangulating the same pixel."""
    names = ("fx", "fy", "cx", "cy", "left.tilt_1", "left.tilt_2", "left.distance")
    sigma = np.array([0.5, 0.5, 0.4, 0.4, 1e-4, 1e-4, 2e-5])
    covariance = ParameterCovariance(parameters=names, data=np.diag(sigma**2))
    normal, distance_m = good.planes.normal[0], float(good.planes.distance_m[0])

    rig = Rig(camera=TRUE_CAMERA, lasers=good.planes, covariance=covariance)
    found = depth_sd_m(rig, 0, 0.5)[4]

    middle = rays(np.array([[(TRUE_CAMERA.image_width - 1) / 2, 0.0]]), TRUE_CAMERA)[0]
    x = 0.5 * middle[0]
    point = np.array([x, (distance_m - normal[0] * x - normal[2] * 0.5) / normal[1], 0.5])
    pixel = project(point[None], TRUE_CAMERA)
    depths = []
    for step in rng.standard_normal((3000, 7)) * sigma:
        matrix = TRUE_CAMERA.camera_matrix + np.array([[step[0], 0, step[2]], [0, step[1], step[3]], [0, 0, 0]])
        seen = rays(pixel, replace(TRUE_CAMERA, camera_matrix=matrix))[0]
        depths.append(np.linalg.norm(seen) * (distance_m + step[6]) / (tilted(normal, step[4:6]) @ seen))
    assert np.std(depths) == pytest.approx(found, rel=0.08)
    assert np.isnan(depth_sd_m(rig, 0, 0.05)).all()  # outside the image


def test_depth_deviations_do_not_depend_on_a_rotation_of_the_camera_frame(good):
    """The frame turns by 0.01 rad about the image's y axis: the principal point moves, and the light plane tilts."""
    distance_m = 0.5 * good.planes.normal[:, 2]  # the stripes at 0.5 m cross the middle of the image
    columns = [*parameter_names("plumb_bob"), "left.tilt_1", "left.tilt_2"]
    step = np.zeros(len(columns))
    step[columns.index("cx")] = -1e-2 * TRUE_CAMERA.camera_matrix[0, 0]
    step[-2:] = tilt_basis(good.planes.normal[0]) @ np.cross([0.0, 1e-2, 0.0], good.planes.normal[0])
    covariance = ParameterCovariance(parameters=tuple(columns), data=np.outer(step, step))
    rig = Rig(camera=TRUE_CAMERA, lasers=replace(good.planes, distance_m=distance_m), covariance=covariance)

    sd = depth_sd_m(rig, 0, 0.5)

    assert np.max(sd) < 4e-4  # z at the image's border changes by 0.01 * 0.22 m


def test_depths_that_the_camera_makes_uncertain_ask_for_a_better_camera(rng):
    names = parameter_names("plumb_bob")
    covariance = ParameterCovariance(parameters=names, data=np.diag([20.0] * 4 + [0.0] * 5) ** 2)
    views = stripe_views(facing([0.4, 0.45, 0.5, 0.55, 0.6, 0.65]), rng, 0.02, 0.05)

    verdict = planes_verdict(calibrate_planes(views, replace(TRUE_CAMERA, covariance=covariance), MODEL))

    depths = [each.advice for each in verdict.poor if each.name == "depth_sd_m"]
    assert depths == ["the camera is too uncertain for these depths: follow the advice of its calibration"] * 3


def renamed(calibration, way):
    """The calibration as it is where the lasers are exchanged in all shots."""
    planes = calibration.planes
    order = list(way)
    return replace(
        calibration,
        planes=replace(planes, normal=planes.normal[order], distance_m=planes.distance_m[order]),
        lasers=tuple(
            replace(calibration.lasers[laser], name=name) for laser, name in zip(order, planes.names, strict=True)
        ),
    )


@pytest.mark.parametrize("way", [(1, 0, 2), (0, 2, 1), (1, 2, 0), (2, 0, 1)])
def test_a_middle_plane_that_is_not_between_the_others_is_reported(way, good):
    verdict = planes_verdict(renamed(good, way))

    assert "middle_outside_rad" in {finding.name for finding in verdict.findings if finding.grade != Grade.GOOD}
    assert any(advice.startswith("middle is not between left and right") for advice in verdict.advice)


def test_the_advice_for_a_single_laser_does_not_mention_other_lasers(rng):
    views = [
        replace(view, stripes_px=view.stripes_px[:1]) for view in stripe_views(facing([0.4, 0.5, 0.52]), rng, 0.02, 3.0)
    ]

    verdict = planes_verdict(calibrate_planes(views, TRUE_CAMERA, PlanesModel(names=("red",))))

    assert any("red" in sentence for sentence in verdict.advice)
    assert not any(word in sentence for sentence in verdict.advice for word in ("lasers", "each laser", "exchanged"))


def test_a_disagreement_is_with_other_lasers_only_if_there_are_any(good):
    for lasers, mentioned in ((good.lasers, True), (good.lasers[:1], False)):
        (poor, *_) = (replace(laser, disagreement=9.0) for laser in lasers)
        planes = replace(good, lasers=(poor, *lasers[1:]))

        advice = planes_verdict(planes).advice

        assert any("disagree with the boards" in sentence for sentence in advice)
        assert any("the other lasers" in sentence for sentence in advice) is mentioned
