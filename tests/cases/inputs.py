"""Inputs of the cases (cases.yaml): carried files, and functions that make what is too large to carry."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from small_rig import SMALL_RIG, write_scene

from ringpose.detect.pipeline import detect
from ringpose.files.images.shots import read_shot
from ringpose.files.records import line_of
from ringpose.files.records.poses import pose_record
from ringpose.files.rigs import read_rig
from ringpose.measure.stream import pose_line

CARRIED = Path(__file__).parent / "files"
DATA = Path(__file__).parents[1] / "data"
SHOTS = DATA / "rig_b" / "shots"
RIG_FILE = DATA / "rig_b" / "rig.yaml"


def _data(path: Path) -> None:
    shutil.copytree(DATA / path.name, path)


def _rig(**changes: Any) -> Callable[[Path], None]:
    """The rig of rig_b with other keys."""

    def build(path: Path) -> None:
        path.write_text(yaml.safe_dump(yaml.safe_load(RIG_FILE.read_text()) | changes))

    return build


def _scene(**changes: Any) -> Callable[[Path], None]:
    """A scene with the rig of rig_b and one view, with other keys; a key of a part is written as `lasers__power_w`."""

    def build(path: Path) -> None:
        shutil.copy(RIG_FILE, path.with_name("rig_of_scene.yaml"))
        scene: dict[str, Any] = {
            "ringpose": "scene/1",
            "rig": "rig_of_scene.yaml",
            "ring": {"radius_inner_m": 0.567, "radius_outer_m": 0.597, "height_m": 0.06},
            "body": {"size_m": [2.2, 2.2, 1.0]},
            "lasers": {},
            "trajectory": [{"name": "a", "center_m": [-0.58, 0, 0.5], "pitch_rad": 0.1, "yaw_rad": 0}],
        }
        for key, value in changes.items():
            part, _, name = key.partition("__")
            scene[part] = scene[part] | {name: value} if name else value
        path.write_text(yaml.safe_dump(scene))

    return build


def _exchanged_principal_point(path: Path) -> None:
    """The camera of rig_b with cx and cy exchanged."""
    camera = yaml.safe_load(RIG_FILE.read_text())["camera"]
    matrix = camera["camera_matrix"]["data"]
    matrix[2], matrix[5] = matrix[5], matrix[2]
    path.write_text(yaml.safe_dump(camera))


def _camera_of_a_corner(path: Path) -> None:
    """The camera of rig_b with its principal point at a quarter of the image."""
    camera = yaml.safe_load(RIG_FILE.read_text())["camera"]
    camera["camera_matrix"]["data"][2] = camera["image_width"] / 4
    path.write_text(yaml.safe_dump(camera))


def _rig_of_camera_keys(path: Path) -> None:
    camera = yaml.safe_load(RIG_FILE.read_text())["camera"]
    path.write_text(yaml.safe_dump({"ringpose": "rig/1", **camera}))


def _camera(path: Path) -> None:
    path.write_text(yaml.safe_dump(yaml.safe_load(RIG_FILE.read_text())["camera"]))


def _pose_lines(path: Path) -> None:
    """The pose line of one shot, computed with the rig of rig_b."""
    rig = read_rig(RIG_FILE)
    line = pose_line(detect(read_shot(SHOTS / "B_z0500_p01_dim.npz"), rig), rig)
    path.write_text(line_of(pose_record(line)))


def _changed_shot(name: str, **changes: Callable[[Any], Any]) -> Callable[[Path], None]:
    """A shot of rig_b of which some arrays are changed."""

    def build(path: Path) -> None:
        arrays = dict(np.load(SHOTS / name))
        np.savez(path, **arrays | {key: change(arrays[key]) for key, change in changes.items()})

    return build


def _small_scene(path: Path) -> None:
    """A scene that is rendered fast, and its rig, with a mount."""
    path.mkdir()
    write_scene(path, "stripe_dn: 200", rig=f"{SMALL_RIG}mount: {{tool_from_camera: {np.eye(4).tolist()}}}\n")


def _mirrored_board(path: Path) -> None:
    """Three views of the ChArUco board, mirrored."""
    path.mkdir()
    for view in sorted((DATA / "calib_b" / "camera").iterdir())[:3]:
        cv2.imwrite(str(path / f"{view.stem}.png"), read_shot(view).images[0][:, ::-1])


BUILT: dict[str, Callable[[Path], None]] = {
    "rig_b": _data,
    "calib_b": _data,
    "rig_with_mount.yaml": _rig(mount={"tool_from_camera": np.eye(4).tolist()}),
    "rig_of_camera_keys.yaml": _rig_of_camera_keys,
    "camera_of_rig_b.yaml": _camera,
    "poses.jsonl": _pose_lines,
    "upside_down.npz": _changed_shot("B_z0500_p01_dim.npz", images=lambda images: images[:, ::-1, ::-1]),
    "flipped.npz": _changed_shot("B_z0500_p00_dim.npz", images=lambda images: images[:, ::-1]),
    "mirrored.npz": _changed_shot("B_z0500_p00_dim.npz", images=lambda images: images[:, :, ::-1]),
    "mirrored_pair.npz": _changed_shot("B_z0500_p01_dim.npz", images=lambda images: images[:, :, ::-1]),
    "reversed.npz": _changed_shot("B_z0500_p00_dim.npz", images=lambda images: images[::-1]),
    "reversed_pair.npz": _changed_shot("B_z0500_p01_dim.npz", images=lambda images: images[::-1]),
    "two_axes.npz": _changed_shot("B_z0500_p01_dim.npz", images=lambda images: images[1]),
    "small": _small_scene,
    "mirrored_board": _mirrored_board,
    "exchanged.yaml": _exchanged_principal_point,
    "quarter.yaml": _camera_of_a_corner,
    "near_ring.yaml": _scene(trajectory=[{"name": "a", "center_m": [0, 0, 0.02], "pitch_rad": 0, "yaw_rad": 0}]),
    "laser_20_w.yaml": _scene(lasers__power_w=20),
    "high_ring.yaml": _scene(ring__height_m=4.9),
    "ring_in_cm.yaml": _scene(ring={"radius_inner_m": 56.7, "radius_outer_m": 59.7, "height_m": 0.06}),
    "no_exposure.yaml": _scene(exposure_s=0),
    "no_board_exposure.yaml": _scene(
        boards={
            "camera": {
                "board": {"kind": "chessboard", "squares_x": 9, "squares_y": 7, "square_m": 0.02},
                "exposure_s": 0,
            }
        }
    ),
    "exposure_in_ms.yaml": _scene(exposure_s=500),
    "no_shots.yaml": _scene(trajectory=[{"generate": {"count": 0}}]),
    "endless_shots.yaml": _scene(motion={"preset": "geo-bound", "shots": 10**9}),
    "large_board.yaml": lambda path: path.write_text("{kind: chessboard, squares_x: 9, squares_y: 7, square_m: 2.5}\n"),
}
"""For each file or folder that is not carried, the function that makes it at a path."""


def make_inputs(words: list[str], folder: Path) -> None:
    """Make the inputs that are named in the words of a command line, and copy all carried files."""
    shutil.copytree(CARRIED, folder, dirs_exist_ok=True)
    for name in dict.fromkeys(Path(word.removeprefix("sim:")).parts[0] for word in words if word):
        if name in BUILT:
            BUILT[name](folder / name)
