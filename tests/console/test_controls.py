"""What the controls take and refuse, and the state that follows: whatever is given, it renders."""

from dataclasses import replace

import numpy as np
import pytest
from served_scene import small_scene

from ringpose.console.controls import (
    Number,
    changed_state,
    console_controls,
    motion_values,
    taken_over,
    view_values,
)
from ringpose.console.engine import Engine
from ringpose.console.state import first_state
from ringpose.simulate.placement import ring_views
from ringpose.types.target import MOTION_PRESETS

WIDTH = 160


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return small_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def views(scene):
    return ring_views(scene)


@pytest.fixture(scope="module")
def controls(scene, views):
    return console_controls(scene, views, WIDTH)


@pytest.fixture
def values(controls):
    return {name: control.initial for name, control in controls.items()}


def state_of(scene, views, values):
    return changed_state(first_state(scene, views[0]), values, scene.rig.lasers.names)


@pytest.mark.parametrize(
    ("name", "given", "word"),
    [
        ("pixel_pitch_percent", 0, "50 to 200"),
        ("focal_percent", 0.0, "50 to 200"),
        ("focal_percent", -5.0, "-5 is out of range"),
        ("exposure_ms", -1.0, "0.05 to 50"),
        ("exposure_ms", 1000, "0.05 to 50"),
        ("tilt_left_deg", 99.0, "-10 to 10"),
        ("ambient_w_m2", 199.0, "0 to 50"),
        ("time_s", 1e308, "0 to 60"),
        ("time_s", float("nan"), "nan is out of range"),
        ("time_s", float("inf"), "inf is out of range"),
        ("time_s", 10**400, "out of range"),
        ("time_s", "5", "not a number"),
        ("time_s", None, "not a number"),
        ("time_s", True, "not a number"),
        ("width_px", "0", "must be one of 160"),
        ("width_px", 0, "must be one of 160"),
        ("speed", "fast", "must be one of"),
        ("view", "<b>", "none of the options"),
        ("earth", "yes", "neither on nor off"),
        ("laser_left", 1, "neither on nor off"),
        ("sequence", "", "a step is off, all, or laser numbers"),
        ("sequence", "<img src=x>", "a step is off, all, or laser numbers"),
        ("sequence", "off,4", "of a rig with 3 lasers"),
        ("sequence", ",".join(["all"] * 33), "more than 32 frames"),
        ("sequence", 7, "not text"),
    ],
)
def test_a_value_that_a_control_does_not_take_is_refused_with_its_range_and_the_value_before_stays(
    controls, values, name, given, word
):
    taken, refusals = taken_over(controls, {name: given, "yaw_deg": 1.5}, values)

    assert word in refusals.pop(name)
    assert refusals == {}
    assert taken == values | {"yaw_deg": 1.5}


def drawn(rng, control):
    """A value for a control: in its range, at its ends, beyond, or of another kind."""
    anything = [0, -5, 1e308, -1e308, 5e-324, float("nan"), float("inf"), 10**400, True, None, "", "<b>", [1.0], {}]
    if rng.random() < 0.4:
        return anything[rng.integers(len(anything))]
    if isinstance(control, Number):
        span = control.high - control.low
        ends = (control.low, control.high, np.nextafter(control.high, np.inf), control.low - 0.1 * span)
        return float(rng.choice(ends)) if rng.random() < 0.3 else float(rng.uniform(control.low, control.high))
    options = getattr(control, "options", (True, False) if isinstance(control.initial, bool) else SEQUENCES)
    return options[rng.integers(len(options))]


SEQUENCES = ("off,all", "all", "off", "off,1,2,3", "1+3,off", "off,all@500us", "1,1,1")


@pytest.mark.parametrize("count", [80, pytest.param(1000, marks=pytest.mark.slow)])
def test_after_each_drawn_value_the_state_renders(scene, views, controls, values, rng, count):
    engine, refused = Engine(scene, lambda *_: None), 0
    names = list(controls)
    for number in range(count):
        name = names[rng.integers(len(names))]
        values, refusals = taken_over(controls, {name: drawn(rng, controls[name])}, values)
        refused += len(refusals)
        assert set(refusals) <= {name}
        state = state_of(scene, views, values)
        small = replace(state, number=number, time_s=float(values["time_s"]), width=40)
        assert engine.preview(small).image.shape == (30, 40, 3)
        if number % 25 == 0:
            line = engine.measured(small).line
            assert line.pose is not None or line.reason

    assert 0.2 * count < refused < 0.6 * count


def test_the_ranges_include_every_view_of_the_scene(scene, views):
    far = replace(views[0], center_m=np.array([2.0, -1.7, 5.0]), roll_rad=3.0, light="bright")
    bright = replace(scene.lights[views[0].light], name="bright", ambient_w_m2=80.0, sun_w_m2=2000.0)
    scene = replace(scene, lights={**scene.lights, "bright": bright})

    controls = console_controls(scene, (views[0], far), WIDTH)

    before = {name: control.initial for name, control in controls.items()}
    assert taken_over(controls, view_values(scene, far), before)[1] == {}
    assert (controls["center_z_m"].high, controls["ambient_w_m2"].high) == (5.0, 80.0)


@pytest.mark.parametrize("name", ["still", *MOTION_PRESETS])
def test_motions_by_name_are_within_the_ranges(controls, values, name):
    taken, refusals = taken_over(controls, motion_values(name), values)

    assert refusals == {}
    assert (taken["spin_deg_s"] == taken["tumble_deg_s"] == 0.0) == (name == "still")


def test_the_controls_of_a_view_show_that_view(scene, views, values):
    view = views[0]

    state = state_of(scene, views, values | view_values(scene, view))

    np.testing.assert_allclose(state.center_m, view.center_m, atol=5.1e-4)
    np.testing.assert_allclose(state.view(scene).normal, view.normal, atol=1.5e-3)
    assert state.light.ambient_w_m2 == scene.lights[view.light].ambient_w_m2
    first = first_state(scene, view).light.sun_direction
    np.testing.assert_allclose(state.light.sun_direction, first / np.linalg.norm(first), atol=2e-3)


def test_controls_are_in_the_units_of_their_labels(scene, views, values):
    values |= {"drift_z_mm_s": -20.0, "tumble_deg_s": 2.0, "exposure_by_scene": False, "exposure_ms": 4.0}
    values |= {"tilt_right_deg": 1.0, "shift_left_mm": 30.0, "laser_middle": False, "sequence": "off,all"}

    state = state_of(scene, views, values)

    np.testing.assert_allclose(state.drift_m_s, [0.0, 0.0, -0.02])
    assert (state.tumble_rad_s, state.exposure_s) == (pytest.approx(np.radians(2.0)), pytest.approx(0.004))
    np.testing.assert_allclose(state.rig_change.laser_tilt_rad, [0.0, 0.0, np.radians(1.0)])
    np.testing.assert_allclose(state.rig_change.laser_shift_m, [0.03, 0.0, 0.0])
    assert (state.mask, state.masks, state.width) == (0b101, (0, 7), WIDTH)


def test_a_measurement_holds_until_the_target_moves_or_another_control_is_changed(scene, views, values):
    still = replace(state_of(scene, views, values), since=3)
    moving = replace(still, drift_m_s=np.array([0.0, 0.0, 0.01]))

    assert still.shows_target_of(replace(still, time_s=5.0))
    assert moving.shows_target_of(moving)
    assert not moving.shows_target_of(replace(moving, time_s=5.0))
    assert not still.shows_target_of(replace(still, since=4))
