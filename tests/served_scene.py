"""A small scene that is fast to render, for served cameras."""

from pathlib import Path

from small_rig import SERVED_RIG, write_scene

from ringpose.files.scenes.scene import read_scene
from ringpose.types.scene import Scene

BOARDS = """\
boards:
  camera:
    board: {kind: charuco, squares_x: 5, squares_y: 4, square_m: 0.05, marker_m: 0.03, dictionary: DICT_4X4_50}
    generate: {count: 2}"""


def small_scene(folder: Path) -> Scene:
    """The scene, read from files that are written to the folder."""
    lines = ("exposure_s: 0.005", "sensor: {pixel_m: 18.0e-6}", "lights: {dim: {ambient_w_m2: 0.3}}", BOARDS)
    return read_scene(write_scene(folder, *lines, rig=SERVED_RIG))
