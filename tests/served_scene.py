"""A small scene that is quick to render, for cameras that are served."""

from pathlib import Path

from ringpose.files.scenes import read_scene
from ringpose.types.scene import Scene

RIG = """\
ringpose: rig/1
camera:
  image_width: 200
  image_height: 150
  camera_name: small
  camera_matrix: {rows: 3, cols: 3, data: [222.0, 0.0, 99.5, 0.0, 222.0, 74.5, 0.0, 0.0, 1.0]}
  distortion_model: plumb_bob
  distortion_coefficients: {rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}
lasers:
- {name: left, normal: [0.0, 0.984807753, -0.173648178], distance_m: -0.0394, projector_m: [0.0, -0.04, 0.0]}
- {name: middle, normal: [0.0, 1.0, 0.0], distance_m: -0.07, projector_m: [0.0, -0.07, 0.0]}
- {name: right, normal: [0.0, 0.984807753, 0.173648178], distance_m: -0.0394, projector_m: [0.0, -0.04, 0.0]}
"""

SCENE = """\
ringpose: scene/1
rig: rig.yaml
ring: {radius_inner_m: 0.567, radius_outer_m: 0.597, height_m: 0.06}
body: {size_m: [1.6, 1.6, 1.0]}
exposure_s: 0.005
sensor: {pixel_m: 18.0e-6}
lights: {dim: {ambient_w_m2: 0.3}}
trajectory:
- generate: {count: 3, distances_m: [0.5], tilt_rad: 0.05}
boards:
  camera:
    board: {kind: charuco, squares_x: 5, squares_y: 4, square_m: 0.05, marker_m: 0.03, dictionary: DICT_4X4_50}
    generate: {count: 2}
"""


def small_scene(folder: Path) -> Scene:
    """The scene, its files in the folder."""
    (folder / "rig.yaml").write_text(RIG)
    (folder / "scene.yaml").write_text(SCENE)
    return read_scene(folder / "scene.yaml")
