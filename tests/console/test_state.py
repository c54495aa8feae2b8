"""The scene that follows from the controls, and the engine that shows it."""

import json
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from needed import needed_module
from served_scene import small_scene

from ringpose.cli.simulate.console import trajectory_in
from ringpose.console.engine import Engine
from ringpose.console.state import Trajectory, first_state, trajectory_of_views
from ringpose.errors import DataError
from ringpose.files.scenes.copies import write_scene_copy
from ringpose.files.scenes.scene import read_scene
from ringpose.files.yaml import read_yaml, write_yaml
from ringpose.geometry.rays import project
from ringpose.simulate.placement import ring_views, target_placement
from ringpose.simulate.renderer import render_view
from ringpose.simulate.serve.preview import preview
from ringpose.types.scene import Beacon, Earth, Light
from ringpose.types.target import Box


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return small_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture
def state(scene):
    return first_state(scene, ring_views(scene)[0])


def test_the_first_state_shows_the_view_of_the_scene(scene, state):
    view = ring_views(scene)[0]

    np.testing.assert_allclose(state.view(scene).normal, view.normal, atol=1e-12)
    np.testing.assert_array_equal(state.view(scene).center_m, view.center_m)


MOVING = {"tumble_rad_s": 0.1, "drift_m_s": np.array([0.01, 0.0, -0.02])}


def test_the_target_moves_with_time(scene, state):
    moving, start = (replace(state, **MOVING, time_s=time_s).view(scene) for time_s in (2.0, 0.0))

    np.testing.assert_allclose(moving.center_m - state.center_m, [0.02, 0.0, -0.04], atol=1e-12)
    before, after = (each.normal[1:] / np.linalg.norm(each.normal[1:]) for each in (start, moving))
    assert np.arccos(before @ after) == pytest.approx(0.2)
    assert moving.normal[0] == pytest.approx(start.normal[0])


def test_a_trajectory_is_followed_and_interpolated(scene, state):
    lines = [
        {"shot": "a", "stamp_s": 10.0, "center_m": [0.5, 0.0, 0.6], "normal": [0.0, 0.0, -1.0]},
        {"shot": "b", "expect": "no_target", "center_m": None, "normal": None},
        {"shot": "c", "stamp_s": 12.0, "center_m": [0.6, 0.0, 0.8], "normal": [0.0, 0.6, -0.8]},
    ]
    trajectory = trajectory_in("\n".join(map(json.dumps, lines)).encode(), "t.jsonl")

    views = [replace(state, trajectory=trajectory, time_s=time_s).view(scene) for time_s in (0.0, 1.0, 5.0)]

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
def test_an_invalid_trajectory_is_rejected(text):
    with pytest.raises(DataError, match=r"t\.jsonl"):
        trajectory_in(text.encode(), "t.jsonl")


def rig_of(scene, state, **changes):
    return replace(state, rig_change=replace(state.rig_change, **changes)).scene_of(scene).rig


def test_a_light_plane_turns_about_its_projector_and_moves_with_it(scene, state):
    moved_m = (0.0, 0.02, 0.0)
    lasers = rig_of(scene, state, laser_tilt_rad=(0.1, 0.0, -0.1), laser_shift_m=moved_m).lasers

    off_m, before_m = (
        (each.normal * each.projector_m).sum(axis=1) - each.distance_m for each in (lasers, scene.rig.lasers)
    )
    np.testing.assert_allclose(off_m, before_m, atol=1e-12)
    angles = np.arccos((lasers.normal * scene.rig.lasers.normal).sum(axis=1).clip(-1, 1))
    np.testing.assert_allclose(angles, [0.1, 0.0, 0.1], atol=1e-7)
    np.testing.assert_allclose(lasers.projector_m - scene.rig.lasers.projector_m, np.outer(moved_m, [0, 1, 0]))


def test_larger_pixels_see_a_wider_field_with_more_light_and_a_rig_can_be_replaced(scene, state):
    wide = replace(state, rig_change=replace(state.rig_change, pitch_scale=2.0)).scene_of(scene)

    assert wide.rig.camera.camera_matrix[0, 0] == pytest.approx(scene.rig.camera.camera_matrix[0, 0] / 2)
    assert wide.sensor.pixel_m == pytest.approx(2 * scene.sensor.pixel_m)
    camera = replace(scene.rig.camera, camera_name="other")
    assert rig_of(scene, state, rig=replace(scene.rig, camera=camera)).camera.camera_name == "other"


@pytest.mark.parametrize(
    ("masks", "mask", "sequence"),
    [((0, 1, 2, 4), 5, (0, 1, 4)), ((7,), 5, (5,)), ((0, 1, 2, 4), 255, (0, 1, 2, 4)), ((1, 2), 4, (0,))],
)
def test_frames_have_the_lasers_that_are_switched_on(scene, state, masks, mask, sequence):
    assert replace(state, masks=masks, mask=mask).scene_of(scene).sequence == sequence


def test_a_preview_shows_what_a_shot_shows(scene, state):
    engine = Engine(scene, lambda *_: None)
    state = replace(state, width=200)
    preview_picture, measured = engine.preview(state), engine.measured(state)

    assert preview_picture.image.shape == measured.image.shape == (150, 200, 3)
    plain = slice(40, None)  # below the caption
    expected = measured.shot.images.max(axis=0)[plain].ravel().astype(float)
    assert np.corrcoef(preview_picture.image[plain, :, 0].ravel(), expected)[0, 1] > 0.8


def test_points_project_to_the_same_place_of_a_preview(scene, rng):
    points = rng.uniform([-0.2, -0.15, 0.5], [0.2, 0.15, 1.0], (20, 3))
    smaller = preview(scene, 50)

    full, small = (project(points, each.rig.camera) for each in (scene, smaller))

    np.testing.assert_allclose((small + 0.5) * 4, full + 0.5, atol=1e-9)
    assert preview(scene, 300) is scene  # it is small already


@pytest.mark.parametrize(
    ("target", "orbit_radius_m"),
    [({}, 7.0e6), ({"model": "sinosat2"}, 7.0e6), ({"model": "sinosat2", "state": "stowed"}, 4.2164e7)],
)
def test_the_earth_is_drawn_as_large_as_it_is_and_outside_all_parts(tmp_path, rng, target, orbit_radius_m):
    needed_module("viser", "ringpose[console]")
    from ringpose.console.drawing import drawn_earth_m

    small_scene(tmp_path)
    values = dict(read_yaml(tmp_path / "scene.yaml").values)
    if target:
        values = {key: value for key, value in values.items() if key not in ("ring", "body")} | {"target": target}
    with (tmp_path / "scene.yaml").open("wb") as stream:
        write_yaml(stream, values)
    scene = read_scene(tmp_path / "scene.yaml")
    earth = Earth(direction=np.array([0.0, 0.0, 1.0]), orbit_radius_m=orbit_radius_m)

    distance_m, radius_m = drawn_earth_m(scene, earth)

    assert radius_m / distance_m == pytest.approx(6.378e6 / orbit_radius_m)
    boxes = [part for part in scene.parts if isinstance(part.shape, Box)]
    assert bool(boxes) == bool(target)
    center_m = np.array([0.0, 0.0, scene.ring.height_m])
    for part in boxes:
        inside_m = rng.uniform(part.shape.low_m, part.shape.high_m, (1000, 3)) @ part.rotation.T + part.translation_m
        assert np.linalg.norm(inside_m - center_m, axis=1).max() < distance_m - radius_m


class Shown:
    """What an engine shows, and events for it."""

    def __init__(self):
        self.pictures, self.changed = [], threading.Condition()

    def __call__(self, picture, jpeg):
        assert jpeg[:2] == b"\xff\xd8"
        with self.changed:
            self.pictures.append(picture)
            self.changed.notify_all()

    def wait_for(self, condition):
        with self.changed:
            assert self.changed.wait_for(lambda: any(condition(picture) for picture in self.pictures), 60)


def test_the_newest_state_is_shown_and_earlier_ones_are_skipped(scene, state):
    shown = Shown()
    with Engine(scene, shown) as engine:
        for number in range(50):
            engine.show(replace(state, number=number, width=200))
        for is_preview in (True, False):
            shown.wait_for(lambda p, is_preview=is_preview: p.state.number == 49 and (p.line is None) == is_preview)

    assert engine.failure is None
    assert len(shown.pictures) < 50


def test_previews_do_not_wait_for_a_measurement(scene, state, monkeypatch):
    shown, measuring, may_end = Shown(), threading.Event(), threading.Event()
    measured = Engine.measured

    def slow(engine, state):
        measuring.set()
        assert may_end.wait(60)
        return measured(engine, state)

    monkeypatch.setattr(Engine, "measured", slow)
    with Engine(scene, shown) as engine:
        for number in range(5):
            engine.show(replace(state, number=number, width=200))
            assert measuring.wait(60)
            shown.wait_for(lambda picture, number=number: picture.state.number == number)
        assert all(picture.line is None for picture in shown.pictures)
        may_end.set()
        shown.wait_for(lambda picture: picture.line is not None and picture.state.number == 4)


def test_a_preview_renders_one_frame_with_one_ray_a_pixel_and_measures_nothing(scene, state, monkeypatch):
    rendered = []

    def render(*arguments, samples, **others):
        rendered.append(samples)
        return render_view(*arguments, samples=samples, **others)

    monkeypatch.setattr("ringpose.console.engine.render_view", render)
    for name in ("simulated_shot", "Stream"):
        monkeypatch.delattr(f"ringpose.console.engine.{name}")

    picture = Engine(scene, lambda *_: None).preview(replace(state, width=200))

    assert rendered == [1]
    assert picture.image.shape[1] == 200
    assert picture.line is None


def test_while_states_change_measurements_pause_for_twice_their_duration(scene, state, monkeypatch):
    clock, measured, polled = [100.0], threading.Semaphore(0), threading.Semaphore(0)
    monkeypatch.setattr("ringpose.console.engine.time", SimpleNamespace(monotonic=lambda: clock[0]))
    picture = Engine(scene, lambda *_: None).preview(replace(state, width=40))

    def measure(engine, state):
        clock[0] += 1.0
        measured.release()
        return replace(picture, state=state)

    monkeypatch.setattr(Engine, "measured", measure)
    monkeypatch.setattr(Engine, "preview", lambda _, state: replace(picture, state=state))
    with Engine(scene, lambda *_: None, is_watched=lambda: polled.release() or True) as engine:
        engine.show(state)
        clock[0] += 0.31  # without a change
        assert measured.acquire(timeout=60)
        for number in range(1, 10):  # within the pause of 2 s
            clock[0] += 0.2
            engine.show(replace(state, number=number))
            while polled.acquire(blocking=False):
                pass
            for _ in range(2):
                assert polled.acquire(timeout=60)
        assert not measured.acquire(blocking=False)
        clock[0] += 1.0  # and no further change
        assert measured.acquire(timeout=60)
    assert engine.failure is None


def test_nothing_is_rendered_without_a_viewer(scene, state):
    asked, pictures = threading.Semaphore(0), []

    def is_watched():
        asked.release()
        return False

    with Engine(scene, lambda picture, _: pictures.append(picture), is_watched=is_watched) as engine:
        engine.show(state)
        for _ in range(4):
            assert asked.acquire(timeout=60)

    assert pictures == []


def test_the_running_measurement_tracks_a_moving_target():
    scene = read_scene(Path(__file__).parents[2] / "examples" / "scene.yaml")
    start = replace(first_state(scene, ring_views(scene)[0]), width=480, drift_m_s=np.array([0.01, 0.0, -0.02]))
    engine = Engine(scene, lambda *_: None)
    pictures = [engine.measured(replace(start, number=number, time_s=0.1 * number)) for number in range(3)]

    truths = [picture.shot_truth for picture in pictures]
    assert [len(truth.frames) for truth in truths] == [5] * 3
    np.testing.assert_allclose(truths[2].center_m - truths[0].center_m, 0.2 * start.drift_m_s, atol=1e-6)
    assert [picture.track.validity for picture in pictures] == ["valid"] * 3
    assert pictures[2].track.velocity is not None
    assert pictures[2].track_error_m < 0.05

    changed = engine.measured(replace(start, number=9, since=9, mask=1, time_s=0.3))  # one stripe: no track
    assert changed.track.validity == "lost"


MOTION = """
motion: {angular_velocity_rad_s: [0, 0, 0.01], inertia_kg_m2: [1, 1, 1], center_of_mass_m: [0, 0, 0], shots: 3}
"""


def test_a_saved_state_is_a_scene_with_that_view_and_rig_and_the_other_keys_of_the_original(scene, state, tmp_path):
    small_scene(tmp_path)
    changed = replace(
        state,
        rig_change=replace(state.rig_change, focal_scale=1.2, pitch_scale=1.5, laser_tilt_rad=(0.05, 0.0, 0.0)),
        masks=(0, 1, 2, 4),
        exposure_s=0.003,
        mask=3,
        light=Light(
            name="console",
            ambient_w_m2=2.0,
            earth=Earth(direction=np.array([1.0, 0.0, 0.0])),
            beacon=Beacon(ambient_w_m2=3.0, on_s=0.4, off_s=0.5),
        ),
    )
    shown = changed.scene_of(scene)
    original = tmp_path / "scene.yaml"
    original.write_text(original.read_text() + MOTION)

    path = write_scene_copy(
        tmp_path / "saved", tmp_path / "scene.yaml", shown.rig, changed.view(scene), changed.light, shown.sequence,
        0.003, shown.sensor.pixel_m,
    )  # fmt: skip

    saved = read_scene(path)
    view = ring_views(saved)[0]
    assert saved.motion is None  # the state is still, unlike the original
    assert saved.lights["console"].beacon == changed.light.beacon
    np.testing.assert_allclose(view.center_m, changed.view(scene).center_m, atol=1e-12)
    np.testing.assert_allclose(view.normal, changed.view(scene).normal, atol=1e-12)
    np.testing.assert_allclose(saved.rig.lasers.normal, shown.rig.lasers.normal, atol=1e-12)
    np.testing.assert_allclose(saved.rig.camera.camera_matrix, shown.rig.camera.camera_matrix)
    assert (saved.exposure_s, saved.stripe_dn, saved.sequence) == (0.003, None, (0, 1, 2))
    assert saved.lights["console"].ambient_w_m2 == 2.0
    np.testing.assert_allclose(saved.lights["console"].earth.direction, [1.0, 0.0, 0.0])
    assert saved.sensor.pixel_m == pytest.approx(1.5 * scene.sensor.pixel_m)


def saved_copy(scene, state, folder):
    """What `read_scene` finds in a saved state, whose original moves in another way."""
    folder.mkdir(exist_ok=True)
    small_scene(folder)
    original = folder / "scene.yaml"
    original.write_text(original.read_text() + MOTION)
    shown = state.scene_of(scene)
    view = state.view(scene)
    return read_scene(write_scene_copy(folder / "saved", original, shown.rig, view, state.light, shown.sequence, None))


@pytest.mark.parametrize(
    "motion",
    [
        {"spin_rad_s": 0.05},
        {"tumble_rad_s": -0.08},
        {"drift_m_s": np.array([0.01, 0.0, -0.02])},
        {"spin_rad_s": -0.03, "drift_m_s": np.array([0.0, 0.04, 0.0])},
    ],
    ids=["spin", "tumble", "drift", "spin and drift"],
)
def test_a_saved_state_moves_as_the_controls_say_from_its_time_on(scene, state, tmp_path, motion):
    moving = replace(state, pitch_rad=0.1, yaw_rad=0.05, roll_rad=0.3, time_s=1.5, **motion)

    views = ring_views(saved := saved_copy(scene, moving, tmp_path))

    assert len(views) == 3
    for number, view in enumerate(views):
        expected = replace(moving, time_s=1.5 + number * saved.period_s).view(scene)
        found, wanted = (target_placement(scene, each) for each in (view, expected))
        np.testing.assert_allclose(found.translation_m, wanted.translation_m, atol=1e-6)
        np.testing.assert_allclose(found.rotation, wanted.rotation, atol=1e-6)


def test_a_saved_trajectory_continues_with_its_velocity_and_one_too_fast_is_not_saved(scene, state, tmp_path):
    poses = {
        "center_m": state.center_m + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]),
        "normal": np.tile(state.view(scene).normal, (2, 1)),
    }
    slow, fast = (
        replace(state, time_s=0.2, trajectory=Trajectory(time_s=np.array([0.0, end_s]), **poses))
        for end_s in (1.0, 0.001)
    )

    saved = saved_copy(scene, slow, tmp_path)

    np.testing.assert_allclose(saved.motion.velocity_m_s, [0.0, 0.0, 0.1], atol=1e-9)
    assert saved_copy(scene, replace(slow, time_s=2.0), tmp_path / "ended").motion is None
    with pytest.raises(DataError, match="m/s"):
        saved_copy(scene, replace(fast, time_s=0.0), tmp_path / "fast")


@pytest.mark.slow
def test_any_position_of_the_controls_gives_a_picture(scene, state, rng):
    engine = Engine(scene, lambda *_: None)
    for number in range(60):
        extreme = replace(
            state,
            number=number,
            center_m=rng.uniform([-1.5, -1.5, 0.2], [1.5, 1.5, 3.0]),
            pitch_rad=rng.uniform(-1.05, 1.05),
            yaw_rad=rng.uniform(-1.05, 1.05),
            tumble_rad_s=rng.uniform(-0.2, 0.2),
            time_s=rng.uniform(0.0, 60.0),
            width=120,
            rig_change=replace(
                state.rig_change,
                focal_scale=rng.uniform(0.5, 2.0),
                pitch_scale=rng.uniform(0.5, 2.0),
                laser_tilt_rad=tuple(rng.uniform(-0.17, 0.17, 3)),
                laser_shift_m=tuple(rng.uniform(-0.1, 0.1, 3)),
            ),
            exposure_s=rng.choice([None, 5e-5, 0.05]),
            mask=int(rng.integers(0, 8)),
            masks=((7,), (0, 1, 2, 4))[int(rng.integers(0, 2))],
            light=Light(name="console", ambient_w_m2=rng.uniform(0, 50), sun_w_m2=rng.uniform(0, 100)),
        )
        assert engine.preview(extreme).image.shape == (90, 120, 3)
        picture = engine.measured(extreme)
        assert picture.image.shape == (90, 120, 3)
        assert picture.line.pose is not None or picture.line.reason


def test_the_views_of_a_scene_are_a_trajectory(scene):
    views = ring_views(scene)
    forward = np.array([0.0, 0.0, 0.1])
    views = [replace(views[0], center_m=views[0].center_m + number * forward) for number in range(3)]

    trajectory = trajectory_of_views(views, 2.0)

    assert trajectory.time_s.tolist() == [0.0, 2.0, 4.0]
    center_m, normal = trajectory.at(3.0)
    np.testing.assert_allclose(center_m, views[0].center_m + 1.5 * forward, atol=1e-12)
    np.testing.assert_allclose(normal, views[0].normal, atol=1e-12)
