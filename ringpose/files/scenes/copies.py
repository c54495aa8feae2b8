"""A scene file with another rig, light and trajectory, as the console saves its state."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.rigs import write_rig
from ringpose.files.scenes.motions import MotionEntry
from ringpose.files.scenes.scene import RECORD, LightEntry, read_scene_file
from ringpose.files.scenes.views import ViewEntry
from ringpose.files.schema import FREE_PREFIX
from ringpose.files.yaml import write_yaml
from ringpose.geometry.rotations import rotation_vector
from ringpose.types.plausible import RATE_RAD_S, SPEED_M_S
from ringpose.types.rig import Rig
from ringpose.types.scene import Light, RingView
from ringpose.types.session import steps_of, written_sequence

STEP_S = 1e-3
"""Time between the two poses whose difference gives the velocities."""

STILL = 1e-9
"""Velocities below it, in m/s and rad/s, are rounding errors."""


def write_scene_copy(
    folder: Path,
    original: Path,
    rig: Rig,
    view: RingView,
    light: Light,
    sequence: tuple[int, ...],
    exposure_s: float | None,
    pixel_m: float | None = None,
) -> Path:
    """Write scene.yaml, which has this single view, and rig.yaml into a new folder; returns its path.

    The motion is that of the view at its beginning, continued at constant velocity and angular velocity; a still view
    has none. All other keys are those of the original file, also `exposure_s` or `stripe_dn` if no exposure is given.
    """
    if view.normal[2] >= 0:
        raise DataError(view.name, "the ring faces away from the camera, which a scene file cannot describe")
    fields, entry = read_scene_file(original)
    motion = _motion(view)
    if motion is not None and entry.motion is not None:
        motion = replace(motion, shots=entry.motion.shots)
    copy = replace(
        entry,
        rig="rig.yaml",
        sequence=written_sequence(steps_of(sequence, len(rig.lasers.names))),
        lights={light.name: _light(light)},
        trajectory=(_view(view, light),),
        motion=motion,
        earth=light.earth,
        sensor=entry.sensor if pixel_m is None else replace(entry.sensor, pixel_m=pixel_m),
    )
    if exposure_s is not None:
        copy = replace(copy, stripe_dn=None, exposure_s=exposure_s)
    own = {key: value for key, value in fields.values.items() if key.startswith(FREE_PREFIX)}
    atomic.make_folder(folder)
    write_rig(folder / "rig.yaml", rig, inputs=[original])
    path = folder / "scene.yaml"
    with atomic.replacing(path, force=False) as stream:
        write_yaml(stream, RECORD.write(copy) | own)
    return path


def _light(light: Light) -> LightEntry:
    return LightEntry(
        ambient_w_m2=light.ambient_w_m2,
        sun_w_m2=light.sun_w_m2,
        sun_direction=light.sun_direction,
        beacon=light.beacon,
    )


def _view(view: RingView, light: Light) -> ViewEntry:
    return ViewEntry(
        name=view.name,
        center_m=view.center_m,
        normal=view.normal,
        roll_rad=math.remainder(view.roll_rad, math.tau),
        light=light.name,
    )


def _motion(view: RingView) -> MotionEntry | None:
    """The motion at the beginning of a view; None for a target that stands still.

    With equal moments of inertia about the ring's centre, the angular velocity remains constant.
    """
    if view.path is None:
        return None
    begin, end = (view.path.camera_from_target(view.begin_s + time_s) for time_s in (0.0, STEP_S))
    turned = begin[0].T @ end[0]
    center_target_m = begin[0].T @ (view.center_m - begin[1])
    velocity_m_s = (end[0] @ center_target_m + end[1] - view.center_m) / STEP_S
    angular_velocity_rad_s = rotation_vector(turned) / STEP_S
    for velocity, plausible, unit in (
        (velocity_m_s, SPEED_M_S, "m/s"),
        (angular_velocity_rad_s, RATE_RAD_S, "rad/s"),
    ):
        speed = float(np.linalg.norm(velocity))
        if not plausible.holds(speed):
            raise DataError(view.name, f"moves at {speed:.3g} {unit}, and a scene file can have {plausible.highest:g}")
    if max(np.abs(velocity_m_s).max(), np.abs(angular_velocity_rad_s).max()) < STILL:
        return None
    return MotionEntry(
        velocity_m_s=velocity_m_s,
        angular_velocity_rad_s=angular_velocity_rad_s,
        inertia_kg_m2=np.ones(3),
        center_of_mass_m=center_target_m,
    )
