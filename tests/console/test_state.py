"""The scene that follows from the controls, and the engine that shows it."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest
from served_scene import small_scene

from ringpose.cli.simulate.console import trajectory_in
from ringpose.console.engine import Engine
from ringpose.console.state import first_state
from ringpose.errors import DataError
from ringpose.files.scene_copies import write_scene_copy
from ringpose.files.scenes import read_scene
from ringpose.geometry.rays import project
from ringpose.simulate.placement import ring_views
from ringpose.simulate.serve.preview import preview
from ringpose.types.scene import Light


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return small_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture
def state(scene):
    return first_state(scene, ring_views(scene)[0])


def test_the_first_state_shows_the_view_of_the_scene(scene, state):
    view = ring_views(scene)[0]

    np.testing.assert_allclose(state.view.normal, view.normal, atol=1e-12)
    np.testing.assert_array_equal(state.view.center_m, view.center_m)


def test_the_target_moves_with_time(state):
    moving = replace(state, tumble_rad_s=0.1, drift_m_s=np.array([0.01, 0.0, -0.02]), time_s=2.0).view

    np.testing.assert_allclose(moving.center_m - state.center_m, [0.02, 0.0, -0.04], atol=1e-12)
    before, after = (each.normal[1:] / np.linalg.norm(each.normal[1:]) for each in (state.view, moving))
    assert np.arccos(before @ after) == pytest.approx(0.2)
    assert moving.normal[0] == pytest.approx(state.view.normal[0])


def test_a_trajectory_is_followed_and_interpolated(state):
    lines = [
        {"shot": "a", "stamp_s": 10.0, "center_m": [0.5, 0.0, 0.6], "normal": [0.0, 0.0, -1.0]},
        {"shot": "b", "expect": "no_target", "center_m": None, "normal": None},
        {"shot": "c", "stamp_s": 12.0, "center_m": [0.6, 0.0, 0.8], "normal": [0.0, 0.6, -0.8]},
    ]
    trajectory = trajectory_in("\n".join(map(json.dumps, lines)).encode(), "t.jsonl")

    views = [replace(state, trajectory=trajectory, time_s=time_s).view for time_s in (0.0, 1.0, 5.0)]

    np.testing.assert_allclose([view.center_m for view in views], [[0.5, 0, 0.6], [0.55, 0, 0.7], [0.6, 0, 0.8]])
    np.testing.assert_allclose(views[1].normal, np.array([0.0, 0.3, -0.9]) / np.hypot(0.3, 0.9))
    np.testing.assert_allclose(views[2].normal, [0.0, 0.6, -0.8])


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        '{"shot": "a"}',
        '{"center_m": [0, 0], "normal": [0, 0, -1]}',
        '{"stamp_s": 1, "center_m": [0, 0, 1], "normal": [0, 0, -1]}\n' * 2,
    ],
)
def test_what_is_no_trajectory_is_rejected(text):
    with pytest.raises(DataError, match=r"t\.jsonl"):
        trajectory_in(text.encode(), "t.jsonl")


def test_a_light_plane_turns_about_its_projector(scene, state):
    lasers = replace(state, laser_tilt_rad=(0.1, 0.0, -0.1)).scene_of(scene).rig.lasers

    np.testing.assert_allclose((lasers.normal * lasers.projector_m).sum(axis=1), lasers.distance_m)
    angles = np.arccos((lasers.normal * scene.rig.lasers.normal).sum(axis=1).clip(-1, 1))
    np.testing.assert_allclose(angles, [0.1, 0.0, 0.1], atol=1e-7)


@pytest.mark.parametrize(
    ("is_switched", "mask", "masks"), [(True, 5, (0, 1, 4)), (False, 5, (5,)), (True, 255, (0, 1, 2, 4))]
)
def test_frames_have_the_lasers_that_are_switched_on(scene, state, is_switched, mask, masks):
    assert replace(state, is_switched=is_switched, mask=mask).scene_of(scene).sequence == masks


def test_a_preview_shows_the_same_view_with_the_same_grey_values(scene, state):
    engine = Engine(scene, 200, lambda _: None)
    large, small = (engine.picture(state, width, measured=False) for width in (200, 100))

    assert small.image.shape == (75, 100, 3)
    assert abs(float(small.image.mean()) - float(large.image.mean())) < 2.5  # of the noisier of four frames
    halved = large.image.reshape(75, 2, 100, 2, 3).mean(axis=(1, 3))
    stripes = halved.max(axis=2) > 60
    assert small.image[stripes].mean() > 40


def test_points_project_to_the_same_place_of_a_preview(scene, rng):
    points = rng.uniform([-0.2, -0.15, 0.5], [0.2, 0.15, 1.0], (20, 3))
    smaller = preview(scene, 50)

    full, small = (project(points, each.rig.camera) for each in (scene, smaller))

    np.testing.assert_allclose((small + 0.5) * 4, full + 0.5, atol=1e-9)


def test_an_image_that_is_small_already_is_its_own_preview(scene):
    assert preview(scene, 300) is scene


def shown_by(scene, states, is_watched=lambda: True):
    pictures, measured = [], threading.Event()

    def publish(picture):
        pictures.append(picture)
        if picture.line is not None and picture.state.number == states[-1].number:
            measured.set()

    with Engine(scene, 200, publish) as engine:
        engine.is_watched = is_watched
        for state in states:
            engine.show(state)
        is_measured = measured.wait(20 if is_watched() else 0.5)
    assert engine.failure is None
    return pictures, is_measured


def test_the_newest_state_is_shown_and_earlier_ones_are_skipped(scene, state):
    states = [replace(state, number=number) for number in range(50)]

    pictures, is_measured = shown_by(scene, states)

    assert is_measured
    assert pictures[-1].state.number == 49
    assert len(pictures) < 10
    assert [picture.line is None for picture in pictures[-2:]] == [True, False]


def test_nothing_is_rendered_while_nobody_watches(scene, state):
    pictures, _ = shown_by(scene, [state], is_watched=lambda: False)

    assert pictures == []


def test_a_saved_state_is_a_scene_with_that_view_and_rig(scene, state, tmp_path):
    small_scene(tmp_path)
    changed = replace(
        state,
        focal_scale=1.2,
        laser_tilt_rad=(0.05, 0.0, 0.0),
        exposure_s=0.003,
        mask=3,
        light=Light(name="console", ambient_w_m2=2.0),
    )
    shown = changed.scene_of(scene)

    path = write_scene_copy(
        tmp_path / "saved", tmp_path / "scene.yaml", shown.rig, changed.view, changed.light, shown.sequence, 0.003
    )

    saved = read_scene(path)
    (view,) = ring_views(saved)
    np.testing.assert_allclose(view.center_m, changed.view.center_m, atol=1e-12)
    np.testing.assert_allclose(view.normal, changed.view.normal, atol=1e-12)
    np.testing.assert_allclose(saved.rig.lasers.normal, shown.rig.lasers.normal, atol=1e-12)
    np.testing.assert_allclose(saved.rig.camera.camera_matrix, shown.rig.camera.camera_matrix)
    assert (saved.exposure_s, saved.stripe_dn, saved.sequence) == (0.003, None, (0, 1, 2))
    assert saved.lights["console"].ambient_w_m2 == 2.0


@pytest.mark.slow
def test_any_position_of_the_controls_gives_a_picture(scene, state, rng):
    engine = Engine(scene, 120, lambda _: None)
    for number in range(60):
        extreme = replace(
            state,
            number=number,
            center_m=rng.uniform([-1.5, -1.5, 0.2], [1.5, 1.5, 3.0]),
            pitch_rad=rng.uniform(-1.05, 1.05),
            yaw_rad=rng.uniform(-1.05, 1.05),
            tumble_rad_s=rng.uniform(-0.2, 0.2),
            time_s=rng.uniform(0.0, 60.0),
            focal_scale=rng.uniform(0.5, 2.0),
            exposure_s=rng.choice([None, 5e-5, 0.05]),
            laser_tilt_rad=tuple(rng.uniform(-0.17, 0.17, 3)),
            mask=int(rng.integers(0, 8)),
            is_switched=bool(rng.integers(0, 2)),
            light=Light(name="console", ambient_w_m2=rng.uniform(0, 50), sun_w_m2=rng.uniform(0, 100)),
        )
        picture = engine.picture(extreme, 120, measured=True)
        assert picture.image.shape == (90, 120, 3)
        assert picture.line.pose is not None or picture.line.reason
