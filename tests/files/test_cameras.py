import cv2
import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files.cameras.formats import read_camera
from ringpose.files.cameras.ros import write_camera
from ringpose.types.rig import Camera, ParameterCovariance

MATRIX = np.array([[700.0, 0, 320.5], [0, 710.0, 240.25], [0, 0, 1]])
COEFFICIENTS = np.array([-0.1, 0.12, 1e-4, -2e-4, 0.03])

ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix: {rows: 3, cols: 3, data: [700., 0., 320.5, 0., 710., 240.25, 0., 0., 1.]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: %d, data: %s}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}
"""


def storage_file(path, coefficients, size=(640, 480)):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", coefficients)
    for key, length in zip(("image_width", "image_height"), size, strict=False):
        storage.write(key, length)
    storage.release()
    return path


def test_camera_is_read_as_it_was_written(tmp_path):
    covariance = ParameterCovariance(parameters=("fx", "k1"), data=np.array([[1e-2, 1e-5], [1e-5, 1e-6]]))
    camera = Camera(
        camera_name="c",
        image_width=640,
        image_height=480,
        camera_matrix=MATRIX,
        distortion_model="plumb_bob",
        distortion_coefficients=COEFFICIENTS,
        covariance=covariance,
    )

    write_camera(tmp_path / "camera.yaml", camera, extra={"quality": {"rms_px": 0.1}})
    after = read_camera(tmp_path / "camera.yaml")

    np.testing.assert_array_equal(after.camera_matrix, MATRIX)
    np.testing.assert_array_equal(after.distortion_coefficients, COEFFICIENTS)
    np.testing.assert_array_equal(after.covariance.data, covariance.data)
    assert (after.camera_name, after.image_width, after.image_height) == ("c", 640, 480)


def test_camera_file_begins_with_provenance(tmp_path, rig_file):
    write_camera(tmp_path / "camera.yaml", read_camera(rig_file()), inputs=[tmp_path / "rig.yaml"])

    lines = (tmp_path / "camera.yaml").read_text().splitlines()

    assert lines[:2] == ["ringpose: camera/1", "provenance:"]


def test_camera_of_a_rig_is_read(rig_file):
    np.testing.assert_array_equal(read_camera(rig_file()).camera_matrix, MATRIX)


@pytest.mark.parametrize("coefficients", [[-0.1, 0.12, 1e-4, -2e-4, 0.03], [-0.1, 0.12, 1e-4, -2e-4], []])
def test_ros_camera_info_with_omitted_coefficients_is_read(tmp_path, coefficients):
    file = tmp_path / "ros.yaml"
    file.write_text(ROS % (len(coefficients), coefficients))

    camera = read_camera(file)

    np.testing.assert_array_equal(camera.camera_matrix, MATRIX)
    np.testing.assert_array_equal(camera.distortion_coefficients, [*coefficients, *[0.0] * (5 - len(coefficients))])


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
@pytest.mark.parametrize(
    ("coefficients", "model"),
    [
        (COEFFICIENTS[None], "plumb_bob"),
        (COEFFICIENTS[:, None], "plumb_bob"),
        (COEFFICIENTS, "plumb_bob"),
        (COEFFICIENTS[:4], "plumb_bob"),
        (np.array([-0.1, 0.1, 0, 0, 0.2, 0.3, 0.1, 0.02]), "rational_polynomial"),
        (np.array([-0.1, 0.1, 0, 0, 0.2, 0, 0, 0, 0, 0, 0, 0]), "plumb_bob"),
    ],
)
def test_opencv_storage_is_read(tmp_path, suffix, coefficients, model):
    camera = read_camera(storage_file(tmp_path / f"c{suffix}", coefficients))

    assert (camera.distortion_model, camera.image_width, camera.image_height) == (model, 640, 480)
    np.testing.assert_array_equal(camera.camera_matrix, MATRIX)
    used = min(coefficients.size, len(camera.distortion_coefficients))
    np.testing.assert_array_equal(camera.distortion_coefficients[:used], coefficients.ravel()[:used])


def test_thin_prism_terms_are_rejected(tmp_path):
    file = storage_file(tmp_path / "c.yml", np.full(12, 0.01))

    with pytest.raises(DataError, match="thin prism"):
        read_camera(file)


def test_opencv_storage_without_image_size_is_rejected(tmp_path):
    file = storage_file(tmp_path / "c.yml", COEFFICIENTS, size=())

    with pytest.raises(DataError, match="add image_width: and image_height: to it"):
        read_camera(file)


@pytest.mark.parametrize(
    "text", ["a: 1", "- 1", "%YAML:1.0\n---\na: 1", "<?xml version='1.0'?><opencv_storage>", "<?xml"]
)
def test_a_file_that_is_not_a_camera_gives_one_line(tmp_path, text, capfd):
    (tmp_path / "c.yaml").write_text(text)

    with pytest.raises(DataError) as caught:
        read_camera(tmp_path / "c.yaml")

    assert str(caught.value).startswith(str(tmp_path / "c.yaml"))
    assert capfd.readouterr().err == ""


def test_reference_cameras_of_opencv_are_read(shared_data):
    camera = read_camera(shared_data / "real/opencv_samples_stereo/left_intrinsics.yml")

    assert camera.camera_matrix[0, 0] == pytest.approx(535.91573396163199)
    assert camera.distortion_coefficients[4] == pytest.approx(0.23839153080878486)
