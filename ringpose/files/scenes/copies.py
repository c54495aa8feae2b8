"""A scene file with another rig, light and trajectory, as the console saves its state."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.rigs import write_rig
from ringpose.files.yaml import read_yaml, write_yaml
from ringpose.types.rig import Rig
from ringpose.types.scene import Light, RingView
from ringpose.types.session import steps_of, written_sequence


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

    All other keys are those of the original file, also its motion, unless that is a file with all poses. Without
    `exposure_s` the exposure follows the original's rule.
    """
    if view.normal[2] >= 0:
        raise DataError(view.name, "the ring faces away from the camera, which a scene file cannot describe")
    values: dict[str, Any] = dict(read_yaml(original).values)
    values |= {
        "rig": "rig.yaml",
        "sequence": written_sequence(steps_of(sequence, len(rig.lasers.names))),
        "lights": {
            light.name: {
                "ambient_w_m2": light.ambient_w_m2,
                "sun_w_m2": light.sun_w_m2,
                "sun_direction": light.sun_direction,
            }
            | ({} if light.beacon is None else {"beacon": asdict(light.beacon)})
        },
        "trajectory": [
            {
                "name": view.name,
                "center_m": view.center_m,
                "normal": view.normal,
                "roll_rad": math.remainder(view.roll_rad, math.tau),
                "light": light.name,
            }
        ],
    }
    if "file" in values.get("motion", {}):
        del values["motion"]
    values.pop("earth", None)
    if (earth := light.earth) is not None:
        values["earth"] = {
            "direction": earth.direction,
            "orbit_radius_m": earth.orbit_radius_m,
            "albedo": earth.albedo,
        }
    if pixel_m is not None:
        values["sensor"] = {**values.get("sensor", {}), "pixel_m": pixel_m}
    if exposure_s is not None:
        values.pop("stripe_dn", None)
        values["exposure_s"] = exposure_s
    atomic.make_folder(folder)
    write_rig(folder / "rig.yaml", rig, inputs=[original])
    path = folder / "scene.yaml"
    with atomic.replacing(path, force=False) as stream:
        write_yaml(stream, values)
    return path
