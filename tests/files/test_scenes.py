"""Reading of scene.yaml, and the messages for invalid scenes."""

import numpy as np
import pytest

from ringpose.errors import DataError, NoInputError
from ringpose.simulate.placement import ring_views
from ringpose.types.pose import RingPose
from ringpose.types.scene import Beacon
from ringpose.types.target import MATERIALS


def test_radii_and_height_make_an_annulus_with_walls(scene_of):
    ring = scene_of().ring

    np.testing.assert_allclose(ring.profile_m, [[0.567, 0], [0.567, 0.06], [0.597, 0.06], [0.597, 0]])
    assert (ring.radius_inner_m, ring.radius_outer_m, ring.height_m) == (0.567, 0.597, 0.06)


def test_the_highest_flat_piece_of_a_profile_is_the_face(scene_of):
    profile_m = [[0.5, 0.0], [0.5, 0.02], [0.55, 0.02], [0.56, 0.05], [0.60, 0.05], [0.61, 0.0]]

    ring = scene_of(("ring", {"profile_m": profile_m})).ring

    assert (ring.radius_inner_m, ring.radius_outer_m, ring.height_m) == (0.56, 0.60, 0.05)


def test_materials_are_given_by_name_or_by_parameters(scene_of):
    ring = scene_of(("ring.face", "matt"), ("ring.wall", {"diffuse": 0.1, "specular": 0.2, "roughness": 0.3})).ring

    assert ring.face == MATERIALS["matt"]
    assert (ring.wall.diffuse, ring.wall.specular, ring.wall.roughness) == (0.1, 0.2, 0.3)


def test_a_scene_has_the_given_and_the_generated_views_and_defaults_for_omitted_keys(scene_of):
    scene = scene_of(("x_note", "mine"))

    assert [view.name for view in scene.views] == ["a"]
    assert scene.approaches[0].lights == ("dim", "sun")
    assert scene.sequence == (0, 3)
    assert (scene.body.foil.rms_m, scene.body.foil.crinkle_m) == (0.001, 0.03)
    assert scene_of(("body.foil", None)).body.foil is None
    assert scene_of(("sequence", "off,1,2,1+2,all")).sequence == (0, 1, 2, 3, 3)


def test_a_light_may_have_a_beacon(scene_of):
    scene = scene_of(("lights.sun.beacon", {"ambient_w_m2": 8, "on_s": 0.5, "off_s": 0.25}))

    assert scene.lights["sun"].beacon == Beacon(ambient_w_m2=8.0, on_s=0.5, off_s=0.25, phase_s=0.0)
    assert scene.lights["dim"].beacon is None


def test_pitch_and_yaw_are_the_papers(scene_of):
    posed = {"name": "a", "center_m": [0, 0, 1], "pitch_rad": 0.2, "yaw_rad": -0.1}
    view = scene_of(("trajectory.0", posed)).views[0]

    pose = RingPose(
        center_m=view.center_m, normal=view.normal, radius_inner_m=1.0, radius_outer_m=1.1, grasp_m=np.zeros(3),
        method="paper", condition_number=1.0, residual_rms_px=0.0,
    )  # fmt: skip
    assert (pose.pitch_rad, pose.yaw_rad) == pytest.approx((0.2, -0.1))


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        ("ringpose", "scene/9", "ringpose: is 'scene/9', must be one of scene/1"),
        ("lihgts", {}, "unknown key 'lihgts'; did you mean 'lights'?"),
        ("ring.radius_inner_m", 567, "if it is in millimetres"),
        ("ring.radius_inner_m", 0.6, "must be smaller than radius_outer_m"),
        ("ring.height_m", -0.1, "is -0.1, must be 0.0005 to 2"),
        ("ring.height_m", None, "has no key 'height_m'"),
        ("ring.face", "mettal", "did you mean 'metal'?"),
        ("ring", {"profile_m": [[0.5, 0.0], [0.6, 0.1]]}, "has no flat piece"),
        ("ring", {"profile_m": [[0.5, 0.0], [0.5, 0.0], [0.6, 0.0]]}, "a point twice"),
        ("body.size_m", [2.2, 2.2], "body.size_m: has 2 numbers, must have 3"),
        ("body.size_m", [2200, 2200, 1000], "if it is in millimetres"),
        ("body.foil.rms_m", 0, "must be positive"),
        ("lasers", {"ghost": {"rows_px": -15}}, "lasers.ghost: has no key 'ratio'"),
        ("lasers", {"ghost": {"rows_px": -15, "ratio": 10}}, "is 10, must be 0 to 1"),
        ("obstacles", [{"kind": "heds", "height_m": 0.01}], "obstacles[0].kind: is 'heds', must be one of"),
        ("obstacles", [{"kind": "cable"}], "obstacles[0]: has no key 'angle_rad'"),
        ("obstacles", [{"kind": "cable", "angle_rad": 0, "width_m": 6000}], "if it is in millimetres"),
        ("lights.sun.sun_direction", [0, 0, 0], "has length 0"),
        ("lights.sun.sun_w_m2", -1, "must be 0 to 5000"),
        ("lights.sun.beacon", {"ambient_w_m2": 8, "on_s": 0.5, "off_s": 0}, "must be at least"),
        ("lights.sun.beacon", {"ambient_w_m2": 8, "on_s": 0.5}, "off_s"),
        ("sensor", {"bits": 10}, "is 10, must be 8 or 12"),
        ("sensor", {"saturation_capacity": 1000}, "did you mean 'saturation_capacity_e'?"),
        ("lens", {"f_number": 0}, "lens.f_number: is 0, must be 0.5 to 100"),
        ("lasers", {"sigma_m": 0.4, "fan": 1}, "unknown key 'fan'"),
        ("sequence", "off,3", "names laser 3 of a rig with 2 lasers"),
        ("sequence", "off,,all", 'step 2 is ""'),
        ("trajectory.0.normal", [0, 0, 1], "points away from the camera"),
        ("trajectory.0.normal", [0, 0, -0.9], "has length 0.9, must be 1"),
        ("trajectory.0.center_m", [0, 0, 500], "if it is in millimetres"),
        ("trajectory.0.light", "bright", "is 'bright', must be one of dim, sun"),
        ("trajectory.0.pitch_rad", 0.1, "cannot be combined with pitch_rad or yaw_rad"),
        ("trajectory.0.name", "a/b", "must be a plain file name"),
        ("trajectory.0.groups", {"a": [1]}, "trajectory[0].groups.a: is a list, must be a text, a number, true or"),
        ("trajectory.0.groups", {"a": float("nan")}, "trajectory[0].groups.a: is nan, must be finite"),
        ("trajectory.1.generate.lights", ["moon"], "has 'moon', must be one of dim, sun"),
        ("trajectory.1.generate.distances_m", [300], "if it is in millimetres"),
        ("trajectory.1.count", 3, "unknown key 'count'"),
        ("boards.camera.generate.distances_m", [0.4], "must be the nearest and the farthest distance"),
        ("boards.camera.board", {"kind": "asymmetric_circles", "squares_x": 4, "squares_y": 11, "spacing_m": 0.02},
         "which is not simulated"),
        ("exposure_s", float("nan"), "must be finite"),
        ("trajectory.1", {"name": "a", "center_m": [-0.5, 0, 1], "normal": [0, 0, -1]}, "'a' occurs twice"),
    ],
)  # fmt: skip
def test_an_invalid_scene_gives_one_line(scene_of, keys, value, message):
    with pytest.raises(DataError) as problem:
        scene_of((keys, value))

    assert message in str(problem.value)
    assert "\n" not in str(problem.value)


def test_a_rig_that_is_missing_or_has_no_projectors_is_rejected(scene_of):
    with pytest.raises(NoInputError):
        scene_of(("rig", "elsewhere.yaml"))
    with pytest.raises(DataError, match="laser 'right' has no projector_m"):
        scene_of(with_projectors=False)


SUN = {"irradiance_w_m2": 30, "direction": [0, 0, -1]}
TARGET = (("ring", None), ("body", None), ("target", {"model": "sinosat2"}))


def test_a_target_replaces_ring_and_body(scene_of):
    scene, bare = scene_of(*TARGET), scene_of(*TARGET[:2], ("target", {"model": "bare"}))

    assert scene.body is None
    assert len(scene.parts) >= 12
    assert scene.ring.radius_outer_m == pytest.approx(0.5965)
    assert {view.target for view in (*bare.views, *bare.approaches)} == {"body"}


def test_sun_and_earth_are_in_all_lights_that_have_no_sun_of_their_own(scene_of):
    scene = scene_of(
        ("sun", SUN),
        ("earth", {"direction": [1, 0, 0]}),
        ("lights.dark", {"sun_w_m2": 0}),
    )

    assert scene.lights["dim"].sun_w_m2 == 30
    assert scene.lights["sun"].sun_w_m2 == 15
    assert scene.lights["dark"].sun_w_m2 == 0
    assert all(light.earth is not None for light in scene.lights.values())


@pytest.mark.parametrize(
    ("changes", "place", "word"),
    [
        ((("target", {"model": "sinosat2"}), ("body", None)), "ring", "remove one"),
        ((("sun", {"irradiance_w_m2": 30}),), "sun", "direction"),
        ((("sun", SUN | {"direction": [0, 0, 0]}),), "sun.direction", "length 0"),
        ((("sun", SUN | {"diameter_rad": 0.53}),), "sun.diameter_rad", "radians"),
        ((("earth", {"direction": [0, 0, 1], "orbit_radius_m": 42164}),), "earth.orbit_radius_m", "at least"),
        ((("trajectory.0.center_m", [0, 0, -0.5]),), "trajectory[0].center_m", "behind the camera"),
        ((("ring.gaps", [{"angle_rad": 90, "width_m": 0.1, "depth_m": 0.01}]),), "ring.gaps[0].angle_rad", "degrees"),
        ((("motion", {"preset": "stress"}), *TARGET[:2], ("target", {"parts": []})), "motion", "no mass"),
    ],
)
def test_invalid_targets_and_lights_are_rejected_with_their_place(scene_of, changes, place, word):
    with pytest.raises(DataError) as error:
        scene_of(*changes)

    assert place in error.value.location + error.value.finding
    assert word in str(error.value)


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (
            "trajectory",
            [{"generate": {"count": 10_000, "distances_m": [0.1 + 0.0005 * k for k in range(1001)]}}],
            "trajectory: gives 1.001e+07 shots, must give at most 1e+07",
        ),
        ("exposure_s", 0, "exposure_s: is 0, must be 1e-06 to 60"),
        ("motion", {"velocity_m_s": [0, 0, 0.01], "shots": 10**9}, "motion.shots: is 1e+09, must be at least 1"),
        ("trajectory", [{"generate": {"count": 0}}], "count: is 0, must be at least 1 and at most 10000"),
        ("trajectory", [{"generate": {"count": 10**9}}], "count: is 1e+09, must be at least 1 and at most 10000"),
    ],
)
def test_numbers_of_shots_and_exposures_that_cannot_be_are_rejected(scene_of, keys, value, message):
    with pytest.raises(DataError) as problem:
        scene_of((keys, value))

    assert message in str(problem.value)


def test_the_first_of_a_million_shots_does_not_wait_for_the_last(scene_of):
    scene = scene_of(("motion", {"preset": "geo-bound", "shots": 1_000_000}))

    views = ring_views(scene)

    assert len(views) == 1_000_000 * views.runs
    assert views[3].begin_s == pytest.approx(3 * scene.period_s)
