"""A rig of a small camera and three lasers, and scenes with it, fast to render."""

from pathlib import Path

_RIG = """\
ringpose: rig/1
camera:
  image_width: {width}
  image_height: {height}
  camera_name: small
  camera_matrix: {{rows: 3, cols: 3, data: [{focal}, 0.0, {x}, 0.0, {focal}, {y}, 0.0, 0.0, 1.0]}}
  distortion_model: plumb_bob
  distortion_coefficients: {{rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}}
lasers:
- {{name: left, normal: [0.0, 0.984807753, -0.173648178], distance_m: -0.0394, projector_m: [0.0, -0.04, 0.0]}}
- {{name: middle, normal: [0.0, 1.0, 0.0], distance_m: -0.07, projector_m: [0.0, -0.07, 0.0]}}
- {{name: right, normal: [0.0, 0.984807753, 0.173648178], distance_m: -0.0394, projector_m: [0.0, -0.04, 0.0]}}
"""

SMALL_RIG = _RIG.format(width=160, height=120, focal=178.0, x=80.0, y=60.0)

SERVED_RIG = _RIG.format(width=200, height=150, focal=222.0, x=99.5, y=74.5)
"""Wider, for cameras that are served over the network."""

_SCENE = """\
ringpose: scene/1
rig: rig.yaml
ring: {radius_inner_m: 0.567, radius_outer_m: 0.597, height_m: 0.06}
body: {size_m: [1.6, 1.6, 1.0]}
trajectory:
- generate: {distances_m: [0.5], tilt_rad: 0.05, count: COUNT}
"""


def write_scene(folder: Path, *more: str, count: int = 3, rig: str = SMALL_RIG) -> Path:
    """Write rig.yaml and scene.yaml with a number of random views, and with further lines; returns the scene's path."""
    (folder / "rig.yaml").write_text(rig)
    (folder / "scene.yaml").write_text(_SCENE.replace("COUNT", str(count)) + "".join(f"{line}\n" for line in more))
    return folder / "scene.yaml"
