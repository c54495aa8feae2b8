"""The controls of the console: the values that each takes, and the state that follows from them.

Values are checked here, whatever has set them: a browser lets a number beyond the end of a slider be typed, and any
program on this machine can write to the socket of the page.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringpose.console.playback import IN_STEP, SPEEDS
from ringpose.console.state import ConsoleState, first_state
from ringpose.errors import DataError, RingposeError
from ringpose.types.arrays import Array, Float64
from ringpose.types.scene import Earth, RingView, Scene
from ringpose.types.session import parsed_sequence, steps_of, written_sequence
from ringpose.types.target import MOTION_PRESETS

END_S = 60.0
"""End of the motion that the controls set; it then starts again."""

WIDTHS_PX = (320, 480, 640, 800, 1200)
"""Widths of the images that are offered, up to that of the camera."""

MAX_FRAMES = 32
"""Frames of a shot; each is rendered in full."""

STILL = "still"
"""Name of the motion that is none."""

EARTH = Earth(direction=np.array([0.9, -0.2, 0.15]))
"""The Earth of scenes without one: beside the target, and in the first view of the page."""

Value = float | bool | str


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """A number within a range."""

    label: str
    low: float
    high: float
    step: float
    initial: float
    hint: str = ""
    """What it sets, for the tooltip."""

    def taken(self, given: object) -> float:
        """The number that was given; DataError outside the range."""
        remedy = f"it must be {self.low:g} to {self.high:g}"
        if isinstance(given, bool) or not isinstance(given, int | float):
            raise DataError(self.label, "this is not a number", remedy)
        if not self.low <= given <= self.high:  # NaN is not
            raise DataError(self.label, f"{_written(given)} is out of range", remedy)
        return float(given)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """One of several texts."""

    label: str
    options: tuple[str, ...]
    initial: str
    hint: str = ""

    def taken(self, given: object) -> str:
        """The option that was given; DataError if there is none such."""
        if not isinstance(given, str) or given not in self.options:
            raise DataError(self.label, "this is none of the options", f"it must be one of {', '.join(self.options)}")
        return given


@dataclass(frozen=True, slots=True, kw_only=True)
class Switch:
    """Something that is on or off."""

    label: str
    initial: bool
    hint: str = ""

    def taken(self, given: object) -> bool:
        """The position that was given; DataError if it is neither."""
        if not isinstance(given, bool):
            raise DataError(self.label, "this is neither on nor off")
        return given


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserSequence:
    """The lasers of each frame, written as for `ringpose capture`."""

    label: str
    lasers: int
    initial: str
    hint: str = ""

    def taken(self, given: object) -> str:
        """The sequence that was given; DataError or UsageError if it is not one, or too long."""
        if not isinstance(given, str):
            raise DataError(self.label, "this is not text")
        if len(steps := parsed_sequence(given)) > MAX_FRAMES:
            raise DataError(self.label, f"this has more than {MAX_FRAMES} frames")
        for step in steps:
            step.mask(self.lasers)
        return given


Control = Number | Choice | Switch | LaserSequence

HINTS = {
    "view": "Pose and light of a view of the scene, at time 0.",
    "motion": "Spin and tumble of a known motion; still: none.",
    "speed": "Seconds of the motion in a second; each shot measured: the motion waits for each measurement.",
    "center": "Centre of the ring in the camera's frame (x right, y down, z forward), in metres.",
    "pitch": "Turn of the ring about the camera's x axis, in degrees; 0 faces the camera.",
    "yaw": "Turn of the ring about the camera's y axis, in degrees; 0 faces the camera.",
    "roll": "Turn of the target about the ring's axis, in degrees.",
    "spin": "Rate about the ring's axis, in degrees a second; a round ring does not show it.",
    "tumble": "Rate about an axis through the centre along the camera's x axis, in degrees a second.",
    "drift": "Velocity of the centre in the camera's frame, in millimetres a second.",
    "time": "Time of the motion, in seconds.",
    "focal": "Focal length, in percent of that of the rig file.",
    "width": "Width of the measured images, in pixels.",
    "pixel": "Size of a pixel, in percent of that of the scene.",
    "exposure_by": "Exposure by the rule of the scene instead of the one below.",
    "exposure_ms": "Exposure of each frame, in milliseconds.",
    "sequence": "Lasers that are on in each frame, as for ringpose capture: off,1,2,3,off or off,all.",
    "laser": "Whether this laser is on at all.",
    "tilt": "Turn of a light plane about the camera's x axis through its projector, in degrees.",
    "shift": "Displacement of a projector with its light plane along the camera's y axis, in millimetres.",
    "ambient": "Irradiance of even light within the band of the filter, in watts a square metre.",
    "sun_w": "Irradiance of the sun within the band of the filter, in watts a square metre.",
    "sun_azimuth": "Direction to the sun: angle from the optical axis towards x, in degrees.",
    "sun_elevation": "Direction to the sun: angle above the plane of x and z, in degrees.",
    "earth": "Light of the Earth, beside the target.",
}
"""What controls set, by the beginning of their names; the longest that fits."""


def hint_of(name: str) -> str:
    """The tooltip of a control."""
    return HINTS[max((begin for begin in HINTS if name.startswith(begin)), key=len)]


def taken_over(
    controls: Mapping[str, Control], given: Mapping[str, object], before: Mapping[str, Value]
) -> tuple[dict[str, Value], dict[str, str]]:
    """The values that were given, with those before in place of values that a control does not take; and why not."""
    values, refusals = dict(before), {}
    for name, value in given.items():
        try:
            values[name] = controls[name].taken(value)
        except RingposeError as problem:
            reason = f"{problem.finding}; {problem.remedy}" if problem.remedy else problem.finding
            refusals[name] = f"not taken: {reason}; {_written(before[name])} stays"
    return values, refusals


def console_controls(scene: Scene, views: Sequence[RingView], width: int) -> dict[str, Control]:
    """All controls by name, for images of this width; the ranges include all views of the scene."""
    lasers = scene.rig.lasers.names
    largest_px = max(width, scene.rig.camera.image_width)
    widths = sorted({each for each in (*WIDTHS_PX, width) if each <= largest_px})
    steps = written_sequence(steps_of(first_state(scene, views[0]).masks, len(lasers)))
    controls: dict[str, Control] = {
        "view": Choice(label="view of the scene", options=tuple(v.name for v in views), initial=views[0].name),
        "motion": Choice(label="motion", options=(STILL, *MOTION_PRESETS), initial=STILL),
        "speed": Choice(label="speed", options=(*SPEEDS, IN_STEP), initial="1"),
        **_numbers(lasers, [view_values(scene, view) for view in views]),
        "width_px": Choice(label="image width (px)", options=tuple(map(str, widths)), initial=f"{width}"),
        "exposure_by_scene": Switch(label="exposure by the scene", initial=True),
        **{f"laser_{name}": Switch(label=f"laser {name}", initial=True) for name in lasers},
        "sequence": LaserSequence(label="sequence", lasers=len(lasers), initial=steps),
        "earth": Switch(label="Earth", initial=scene.lights[views[0].light].earth is not None),
    }
    return {name: replace(control, hint=hint_of(name)) for name, control in controls.items()}


def _numbers(lasers: Sequence[str], views: Sequence[Mapping[str, Value]]) -> dict[str, Number]:
    """The controls that are numbers; they begin with the values of the first view, and their ranges include all."""
    numbers = {  # label, low, high, step and initial value
        **{f"center_{axis}_m": (f"centre {axis} (m)", -1.5, 1.5, 0.001, 0.0) for axis in "xy"},
        "center_z_m": ("centre z (m)", 0.2, 3.0, 0.001, 1.0),
        **{f"{name}_deg": (f"{name} (deg)", -60.0, 60.0, 0.1, 0.0) for name in ("pitch", "yaw", "roll")},
        **{f"{name}_deg_s": (f"{name} (deg/s)", -10.0, 10.0, 0.01, 0.0) for name in ("spin", "tumble")},
        **{f"drift_{axis}_mm_s": (f"drift {axis} (mm/s)", -50.0, 50.0, 1.0, 0.0) for axis in "xyz"},
        "time_s": ("time (s)", 0.0, END_S, 0.01, 0.0),
        "focal_percent": ("focal length (%)", 50.0, 200.0, 1.0, 100.0),
        "pixel_pitch_percent": ("pixel pitch (%)", 50.0, 200.0, 1.0, 100.0),
        "exposure_ms": ("exposure (ms)", 0.05, 50.0, 0.05, 5.0),
        **{f"tilt_{name}_deg": (f"tilt of {name} (deg)", -10.0, 10.0, 0.1, 0.0) for name in lasers},
        **{f"shift_{name}_mm": (f"{name} along y (mm)", -100.0, 100.0, 1.0, 0.0) for name in lasers},
        "ambient_w_m2": ("ambient light (W/m2)", 0.0, 50.0, 0.1, 0.0),
        "sun_w_m2": ("sun (W/m2)", 0.0, 1400.0, 0.5, 0.0),
        "sun_azimuth_deg": ("sun azimuth (deg)", -180.0, 180.0, 0.5, 0.0),
        "sun_elevation_deg": ("sun elevation (deg)", -90.0, 90.0, 0.5, 0.0),
    }
    controls = {}
    for name, (label, low, high, step, initial) in numbers.items():
        shown = [float(view[name]) for view in views if name in view]
        controls[name] = Number(
            label=label,
            low=min([low, *shown]),
            high=max([high, *shown]),
            step=step,
            initial=shown[0] if shown else initial,
        )
    return controls


def view_values(scene: Scene, view: RingView) -> dict[str, Value]:
    """The values of controls that show a view of the scene at time 0, to the decimals of the fields."""
    state = first_state(scene, view)
    azimuth_deg, elevation_deg = _angles_deg(state.light.sun_direction)
    angles_rad = {"pitch": state.pitch_rad, "yaw": state.yaw_rad, "roll": state.roll_rad}
    return {
        **{f"center_{axis}_m": round(float(value), 3) for axis, value in zip("xyz", state.center_m, strict=True)},
        **{f"{name}_deg": round(float(np.degrees(angle_rad)), 1) for name, angle_rad in angles_rad.items()},
        "ambient_w_m2": state.light.ambient_w_m2,
        "sun_w_m2": state.light.sun_w_m2,
        "sun_azimuth_deg": round(azimuth_deg, 1),
        "sun_elevation_deg": round(elevation_deg, 1),
        "earth": state.light.earth is not None,
    }


def motion_values(name: str) -> dict[str, Value]:
    """The values of spin and tumble, and for a still target also of the drift, of a motion by its name."""
    if name == STILL:
        drift: dict[str, Value] = {f"drift_{axis}_mm_s": 0.0 for axis in "xyz"}
        return {"spin_deg_s": 0.0, "tumble_deg_s": 0.0, **drift}
    x, y, z = np.degrees(MOTION_PRESETS[name].angular_velocity_rad_s)
    return {"spin_deg_s": round(float(z), 2), "tumble_deg_s": round(float(np.hypot(x, y)), 2)}


def changed_state(state: ConsoleState, values: Mapping[str, Any], lasers: Sequence[str]) -> ConsoleState:
    """The state with the values of all controls but the time, for lasers of these names."""
    azimuth, elevation = np.radians(values["sun_azimuth_deg"]), np.radians(values["sun_elevation_deg"])
    level = np.cos(elevation)
    light = replace(
        state.light,
        ambient_w_m2=values["ambient_w_m2"],
        sun_w_m2=values["sun_w_m2"],
        sun_direction=np.array([np.sin(azimuth) * level, -np.sin(elevation), np.cos(azimuth) * level]),
        earth=(state.light.earth or EARTH) if values["earth"] else None,
    )
    rig_change = replace(
        state.rig_change,
        focal_scale=values["focal_percent"] / 100,
        pitch_scale=values["pixel_pitch_percent"] / 100,
        laser_tilt_rad=tuple(float(np.radians(values[f"tilt_{name}_deg"])) for name in lasers),
        laser_shift_m=tuple(1e-3 * values[f"shift_{name}_mm"] for name in lasers),
    )
    return replace(
        state,
        center_m=np.array([values[f"center_{axis}_m"] for axis in "xyz"]),
        pitch_rad=float(np.radians(values["pitch_deg"])),
        yaw_rad=float(np.radians(values["yaw_deg"])),
        roll_rad=float(np.radians(values["roll_deg"])),
        spin_rad_s=float(np.radians(values["spin_deg_s"])),
        tumble_rad_s=float(np.radians(values["tumble_deg_s"])),
        drift_m_s=1e-3 * np.array([values[f"drift_{axis}_mm_s"] for axis in "xyz"]),
        rig_change=rig_change,
        width=int(values["width_px"]),
        exposure_s=None if values["exposure_by_scene"] else 1e-3 * values["exposure_ms"],
        mask=sum(1 << laser for laser, name in enumerate(lasers) if values[f"laser_{name}"]),
        masks=tuple(step.mask(len(lasers)) for step in parsed_sequence(values["sequence"])),
        light=light,
    )


def _angles_deg(direction: Float64[Array, "xyz=3"]) -> tuple[float, float]:
    """Azimuth from the optical axis towards x, and elevation, of a direction in the camera frame."""
    x, y, z = direction / np.linalg.norm(direction)
    return float(np.degrees(np.arctan2(x, z))), float(np.degrees(np.arcsin(np.clip(-y, -1.0, 1.0))))


def _written(value: Value | int) -> str:
    try:
        return f"{value:g}" if isinstance(value, int | float) else value
    except OverflowError:  # a whole number beyond the largest floating-point number
        return "this"
