import hashlib
from dataclasses import replace

import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files.rigs import median_board_rms_px, read_mount, read_rig, require_mount, write_mount, write_rig
from ringpose.types.rig import LaserBow, LaserGhost, Mount, ParameterCovariance

MIRROR = [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]
"""Turns the z axis over alone: what comes of a left-handed frame."""


def test_a_rig_is_read_with_its_hash(rig_file):
    file = rig_file()

    rig = read_rig(file)

    assert rig.lasers.names == ("left", "right")
    np.testing.assert_array_equal(rig.lasers.distance_m, [-0.04, 0.05])
    np.testing.assert_array_equal(rig.lasers.projector_m, [[-0.03, -0.04, 0], [np.nan] * 3])
    np.testing.assert_array_equal(rig.camera.camera_matrix, [[700, 0, 320.5], [0, 710, 240.25], [0, 0, 1]])
    assert rig.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()


def test_corner_rms_is_the_median_of_the_boards_if_the_rig_has_them(rig_file, tmp_path):
    boards = [{"name": str(rms_px), "rms_px": rms_px} for rms_px in (0.5, 0.01, 0.03)]

    write_rig(tmp_path / "judged.yaml", read_rig(rig_file()), extra={"quality": {"boards": boards}})

    assert median_board_rms_px(tmp_path / "judged.yaml") == 0.03
    assert median_board_rms_px(rig_file()) is None


def test_rig_with_everything_is_read_as_it_was_written(rig_file, tmp_path, rng):
    names = ("fx", "k3", "left.tilt_1", "right.distance", "left.bow", "left.projector_1")
    root = rng.normal(size=(6, 6)) * np.array([[1.0], [0.01], [1e-4], [1e-5], [1e-3], [0.01]])
    before = read_rig(rig_file())
    joint = ParameterCovariance(parameters=names, data=root @ root.T)
    ghost = LaserGhost(offset_px=-15.0, offset_sd_px=0.02, ratio=0.1, ratio_sd=0.001)
    before = replace(
        before, covariance=joint, ghosts={"right": ghost}, bows={"left": LaserBow(per_rad=-0.01, sd_per_rad=0.001)}
    )

    write_rig(tmp_path / "again.yaml", before, inputs=[tmp_path / "rig.yaml"])
    after = read_rig(tmp_path / "again.yaml")

    np.testing.assert_array_equal(after.lasers.normal, before.lasers.normal)
    np.testing.assert_array_equal(after.lasers.projector_m, before.lasers.projector_m)
    np.testing.assert_array_equal(after.camera.distortion_coefficients, before.camera.distortion_coefficients)
    np.testing.assert_allclose(after.mount.carrier_from_camera, before.mount.carrier_from_camera, atol=1e-15)
    np.testing.assert_allclose(after.mount.covariance, before.mount.covariance, atol=1e-15)
    assert after.mount.delay_s == before.mount.delay_s
    assert after.mount.robot_translation_sd_m == before.mount.robot_translation_sd_m == 1e-4
    assert after.covariance.parameters == names
    assert (after.ghosts, after.bows) == (before.ghosts, before.bows)
    np.testing.assert_allclose(after.covariance.data, joint.data, rtol=1e-15)
    assert after.provenance["inputs"] == {str(tmp_path / "rig.yaml"): before.sha256}


def test_the_covariance_of_poses_in_the_base_is_kept_instead_of_the_robots_errors(rig_file, tmp_path, rng):
    rig = read_rig(rig_file())
    root = 1e-3 * rng.normal(size=(6, 6))
    mount = replace(rig.mount, robot_rotation_sd_rad=0.0, robot_translation_sd_m=0.0, pose_root=root)

    write_rig(tmp_path / "new.yaml", replace(rig, mount=mount))

    read = read_mount(tmp_path / "new.yaml").pose_root
    np.testing.assert_allclose(read @ read.T, root @ root.T, atol=1e-15)


@pytest.mark.parametrize(
    ("part", "changes", "key"),
    [
        ("lasers", {"distance_m": np.array([0.0, 0.05])}, "distance_m"),
        ("lasers", {"names": ("left", "left")}, "name"),
        ("camera", {"camera_matrix": np.diag([-700.0, 710.0, 1.0])}, "camera_matrix"),
    ],
)
def test_a_rig_that_could_not_be_read_is_not_written(rig_file, tmp_path, part, changes, key):
    rig = read_rig(rig_file())

    with pytest.raises(DataError, match=key):
        write_rig(tmp_path / "new.yaml", replace(rig, **{part: replace(getattr(rig, part), **changes)}))

    assert not (tmp_path / "new.yaml").exists()


def test_a_rig_whose_stripe_is_too_steep_is_rejected_only_for_measuring_rings(rig_file, tmp_path):
    rig = read_rig(rig_file())
    upright = replace(rig.lasers, normal=np.array([[0.6, 0.0, 0.8], [0.0, 0.8, -0.6]]))

    write_rig(tmp_path / "new.yaml", replace(rig, lasers=upright))

    with pytest.raises(DataError, match=r"lasers\[0\].normal: draws a stripe at 90.0 degrees"):
        read_rig(tmp_path / "new.yaml")
    np.testing.assert_array_equal(read_rig(tmp_path / "new.yaml", for_rings=False).lasers.normal, upright.normal)


def test_a_rig_whose_stripes_all_run_along_the_columns_is_read(rig_file, tmp_path):
    rig = read_rig(rig_file())
    upright = replace(rig.lasers, normal=np.array([[0.8, 0.0, 0.6], [0.6, 0.1, -np.sqrt(0.63)]]))

    write_rig(tmp_path / "new.yaml", replace(rig, lasers=upright))

    assert read_rig(tmp_path / "new.yaml").stripes_along_columns


def test_a_rounded_normal_is_normalised(rig_file):
    rig = read_rig(rig_file("lasers.0.normal", [0, 0.6000001, -0.8]))

    np.testing.assert_allclose(np.linalg.norm(rig.lasers.normal, axis=1), 1, rtol=1e-15)


@pytest.mark.parametrize(
    ("path", "value", "finding"),
    [
        ("ringpose", "rig/2", "ringpose: is 'rig/2', must be one of rig/1"),
        (
            "lasers.1.distance_m",
            -39.5,
            "lasers[1].distance_m: is -39.5, must be -5 to 5; give metres: -0.0395 if it is in millimetres, -0.395 if",
        ),
        ("lasers.0.projector_m", [-30, -40, 0], "lasers[0].projector_m: is -40, must be -5 to 5; give metres: -0.04"),
        (
            "mount.pose_covariance",
            np.eye(6).tolist(),
            "mount.pose_covariance: contains the robot's error, which robot_",
        ),
        ("mount.tool_from_camera.0.3", 100.0, "mount.tool_from_camera: is 100, must be -5 to 5; give metres"),
        ("lasers.1.normal", [0, 0.6, 0.79], "lasers[1].normal: has length 0.992018, must be 1"),
        ("lasers.1.distance_m", 0, "lasers[1].distance_m: is 0: the plane contains the camera"),
        ("lasers.1.normal", [0.8, 0.6, 0], "lasers[1].normal: draws a stripe at 53.1 degrees to the image's rows"),
        ("lasers.1.normal", [0, 0, 0], "lasers[1].normal: has length 0, must be 1"),
        ("lasers.1.normal.0", float("nan"), "lasers[1].normal: has null or NaN among its numbers"),
        ("lasers.1.name", "left", "lasers[1].name: 'left' occurs twice"),
        ("lasers.1.name", "a.b", "lasers[1].name: is 'a.b', must not contain a full stop"),
        ("lasers.1.distnace_m", 1, "lasers[1]: unknown key 'distnace_m'; did you mean 'distance_m'?"),
        ("lasers", [], "lasers: has 0 lasers, must have 1 to 8"),
        ("mount.tool_from_camera.0.0", 0.5, "mount.tool_from_camera: its upper left 3 x 3 matrix is not a rotation"),
        ("mount.tool_from_camera.0.1", 1, "mount.tool_from_camera: its upper left 3 x 3 matrix is not a rotation"),
        ("mount.tool_from_camera", MIRROR, "mount.tool_from_camera: its upper left 3 x 3 matrix is not a rotation"),
        ("mount.tool_from_camera.2.3", -5.5, "mount.tool_from_camera: is -5.5, must be -5 to 5; give metres"),
        ("mount.tool_from_camera.3.3", 2, "mount.tool_from_camera: must end with the row [0, 0, 0, 1]"),
        ("mount.tool_from_camera", ..., "mount: has neither tool_from_camera nor base_from_camera"),
        ("mount.base_from_camera", MIRROR, "mount.base_from_camera: and tool_from_camera exclude each other"),
        ("camera.image_width", 0, "camera.image_width: is 0, must be at least 1"),
        ("camera.camera_matrix.data.0", -700, "camera.camera_matrix: has a focal length that is not positive"),
        ("camera.camera_matrix.data.1", 0.5, "camera.camera_matrix: must have the form"),
        ("camera.camera_matrix.data.2", 9000, "camera.camera_matrix: has its principal point at (9000, 240.25)"),
        ("camera.camera_matrix.rows", 2, "camera.camera_matrix.rows: is 2, must be 3"),
        ("camera.distortion_model", "fisheye", "camera.distortion_model: is 'fisheye', must be one of plumb_bob"),
        ("camera.distortion_coefficients.cols", 4, "camera.distortion_coefficients.data: has 5 numbers, must have 4"),
        ("camera", ..., "has no key 'camera'"),
        ("lasers", ..., "has no key 'lasers'"),
        ("lasers.0.normal", ..., "lasers[0]: has no key 'normal'"),
        ("lasers.0.distance_m", ..., "lasers[0]: has no key 'distance_m'"),
        ("camera.camera_matrix.data", ..., "camera.camera_matrix: has no key 'data'"),
    ],
)
def test_an_invalid_rig_is_rejected_with_its_location(rig_file, path, value, finding):
    file = rig_file(path, value)

    with pytest.raises(DataError) as caught:
        read_rig(file)

    assert str(caught.value).startswith(f"{file}: {finding}")


@pytest.mark.parametrize(
    ("parameters", "data", "finding"),
    [
        (["fx", "fz"], [[1, 0], [0, 1]], "unknown parameter 'fz'"),
        (["fx", "middle.tilt_1"], [[1, 0], [0, 1]], "unknown parameter 'middle.tilt_1'"),
        (["fx", "fx"], [[1, 0], [0, 1]], "a parameter occurs twice"),
        (["fx", "fy"], [[1, 0, 0], [0, 1, 0]], "has 2 x 3 numbers, must have 2 x 2"),
        (["fx", "left.tilt_1"], [[1, 1e-4], [0, 1e-6]], "is not symmetric"),
        (["fx", "left.tilt_1"], [[1, 2e-3], [2e-3, 1e-6]], "is not positive semidefinite"),
        (["fx", "fy"], [[1, 0], [0, -1]], "has a negative variance"),
        (["fx", "fy"], [[0, 1], [1, 1]], "is not positive semidefinite"),
    ],
)
def test_an_invalid_covariance_is_rejected(rig_file, parameters, data, finding):
    file = rig_file("covariance", {"parameters": parameters, "data": data})

    with pytest.raises(DataError) as caught:
        read_rig(file)

    assert finding in str(caught.value)


def test_a_covariance_of_rank_one_is_accepted(rig_file):
    rig = read_rig(rig_file("covariance", {"parameters": ["fx", "left.distance"], "data": [[4, 2e-3], [2e-3, 1e-6]]}))

    assert rig.covariance.parameters == ("fx", "left.distance")


def test_another_mount_keeps_the_delay_of_the_robots_poses(rig_file, tmp_path):
    file = rig_file("mount.delay_s", 0.02)
    mount = Mount(carrier_from_camera=np.eye(4), root=1e-3 * np.eye(6))

    write_mount(tmp_path / "mounted.yaml", mount, file, {}, force=False, inputs=[])

    written = read_rig(tmp_path / "mounted.yaml", for_rings=False).mount
    np.testing.assert_array_equal(written.carrier_from_camera, np.eye(4))
    assert written.delay_s == 0.02


def test_a_rig_without_mount_is_rejected_for_the_tool_frame(rig_file):
    file = rig_file("mount", ...)

    with pytest.raises(DataError, match="has no mount"):
        require_mount(read_rig(file), file)
