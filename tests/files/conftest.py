"""A rig file and a scene that tests modify."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from ringpose.files.scenes.scene import read_scene
from ringpose.types.scene import Scene

RIG: dict[str, Any] = {
    "ringpose": "rig/1",
    "camera": {
        "image_width": 640,
        "image_height": 480,
        "camera_name": "test",
        "camera_matrix": {"rows": 3, "cols": 3, "data": [700.0, 0, 320.5, 0, 710.0, 240.25, 0, 0, 1]},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.1, 0.12, 1e-4, -2e-4, 0.03]},
    },
    "lasers": [
        {"name": "left", "normal": [0, 0.6, -0.8], "distance_m": -0.04, "projector_m": [-0.03, -0.04, 0]},
        {"name": "right", "normal": [0, 0.6, 0.8], "distance_m": 0.05},
    ],
    "mount": {
        "tool_from_camera": [[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, -0.3], [0, 0, 0, 1]],
        "covariance": [[1e-6 * (row == column) for column in range(6)] for row in range(6)],
        "delay_s": 0.02,
        "delay_sd_s": 0.001,
        "robot_rotation_sd_rad": 2e-4,
        "robot_translation_sd_m": 1e-4,
    },
}


def changed(values: Any, path: str, value: Any) -> Any:
    """The nested values with another value at a path such as `lasers.0.normal`; `...` removes it."""
    key, _, rest = path.partition(".")
    copy = list(values) if isinstance(values, list) else dict(values)
    index = int(key) if isinstance(copy, list) else key
    if not rest and value is ...:
        del copy[index]
    else:
        copy[index] = changed(copy[index], rest, value) if rest else value
    return copy


BOARD: dict[str, Any] = {"kind": "charuco", "squares_x": 7, "squares_y": 5, "square_m": 0.04, "marker_m": 0.03}
BOARD["dictionary"] = "DICT_4X4_50"

SCENE: dict[str, Any] = {
    "ringpose": "scene/1",
    "rig": "rig.yaml",
    "ring": {"radius_inner_m": 0.567, "radius_outer_m": 0.597, "height_m": 0.06},
    "body": {"size_m": [2.2, 2.1, 1.0], "foil": {"rms_m": 0.001}},
    "lights": {"dim": {}, "sun": {"sun_w_m2": 15, "sun_direction": [0, -1, -1]}},
    "trajectory": [
        {"name": "a", "center_m": [-0.58, 0.0, 0.5], "normal": [0.0, 0.0, -1.0]},
        {"generate": {"distances_m": [0.5], "count": 2, "lights": ["dim", "sun"]}},
    ],
    "boards": {"camera": {"board": BOARD, "generate": {"count": 3}}},
}


@pytest.fixture
def rig_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes a valid rig.yaml, or one with another value at a path."""

    def written(path: str = "", value: Any = None) -> Path:
        file = tmp_path / "rig.yaml"
        file.write_text(yaml.safe_dump(changed(RIG, path, value) if path else RIG))
        return file

    return written


@pytest.fixture
def scene_of(tmp_path: Path, rig_file: Callable[..., Path]) -> Callable[..., Scene]:
    """Reads the scene with other values at paths; None removes a key."""

    def read(*changes: tuple[str, Any], with_projectors: bool = True) -> Scene:
        values: Any = SCENE
        for path, value in changes:
            values = changed(values, path, ... if value is None else value)
        rig_file(*(("lasers.1.projector_m", [0, 0.03, 0.04]) if with_projectors else ()))
        (tmp_path / "scene.yaml").write_text(yaml.safe_dump(values))
        return read_scene(tmp_path / "scene.yaml")

    return read
