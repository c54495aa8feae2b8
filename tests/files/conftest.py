"""A rig file that tests modify, and the marker of a deleted value."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

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
    },
}


def changed(values: Any, path: str, value: Any) -> Any:
    """The nested values with another value at a path such as `lasers.0.normal`; `DELETED` removes it."""
    key, _, rest = path.partition(".")
    copy = list(values) if isinstance(values, list) else dict(values)
    index = int(key) if isinstance(copy, list) else key
    if not rest and value is DELETED:
        del copy[index]
    else:
        copy[index] = changed(copy[index], rest, value) if rest else value
    return copy


DELETED = object()


@pytest.fixture
def rig_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes a valid rig.yaml, or one with another value at a path."""

    def written(path: str = "", value: Any = None) -> Path:
        file = tmp_path / "rig.yaml"
        file.write_text(yaml.safe_dump(changed(RIG, path, value) if path else RIG))
        return file

    return written


@pytest.fixture
def deleted() -> object:
    """The value that removes a key."""
    return DELETED
