"""A camera that is estimated with boards and light planes, on boards that this project did not draw."""

import numpy as np
import pytest

from ringpose.calibrate.camera.parameters import parameters_of
from ringpose.cli.main import main
from ringpose.files.rigs import read_rig
from ringpose.geometry.rotations import tilt_basis


@pytest.mark.slow
def test_freed_camera_and_planes_of_rendered_boards_lie_within_three_deviations(
    shared_data, rig_of_rendered_boards, tmp_path
):
    boards, rig_file = shared_data / "rendered" / "calib_b", tmp_path / "rig.yaml"
    camera = str(rig_of_rendered_boards.parent / "camera.yaml")
    words = ["--board", str(boards / "plane_board.yaml"), "--camera", camera, "--laser-order", "right,middle,left"]

    main(["calibrate-planes", str(boards / "planes"), *words, "--free-camera", "--output", str(rig_file), "--quiet"])

    found, true = read_rig(rig_file), read_rig(boards / "true_rig.yaml")
    errors = [parameters_of(found.camera) - parameters_of(true.camera)]
    for name, normal, distance_m in zip(found.lasers.names, found.lasers.normal, found.lasers.distance_m, strict=True):
        laser = true.lasers.names.index(name)
        along = true.lasers.normal[laser] @ normal
        errors.append(-tilt_basis(normal) @ true.lasers.normal[laser] / along)
        errors.append(np.array([distance_m - np.sign(along) * true.lasers.distance_m[laser]]))
    deviations = np.array(list(found.covariance.standard_deviations.values()))
    assert np.abs(np.concatenate(errors) / deviations).max() < 3.0
