"""A small scene that is fast to render, for served cameras."""

from pathlib import Path

from small_rig import SERVED_RIG

from ringpose.files.scenes.scene import read_scene
from ringpose.types.scene import Scene

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
    """The scene, read from files that are written to the folder."""
    (folder / "rig.yaml").write_text(SERVED_RIG)
    (folder / "scene.yaml").write_text(SCENE)
    return read_scene(folder / "scene.yaml")
