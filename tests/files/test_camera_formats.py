"""Cameras in the formats of other programs: round trips, and files as those programs write them."""

import random
from pathlib import Path

import cv2
import numpy as np
import pytest
import scipy.io
import yaml

from ringpose.errors import DataError, UsageError
from ringpose.files.cameras import matlab
from ringpose.files.cameras.formats import read_camera, write_camera_as
from ringpose.files.cameras.ros import write_camera
from ringpose.types.options import CameraFormat
from ringpose.types.rig import Camera, ParameterCovariance

MATRIX = np.array([[700.123456789012, 0, 320.5], [0, 710.0 / 3, 240.25], [0, 0, 1]])
PLUMB_BOB = np.array([-0.1, 0.12, 1e-4, -2e-4, 0.0312345678901234])
RADTAN = np.array([-0.1, 0.12, 1e-4, -2e-4, 0.0])
RATIONAL = np.array([-0.1, 0.12, 1e-4, -2e-4, 0.03, 0.2, -0.01, 1e-3])


def camera(coefficients: np.ndarray = PLUMB_BOB) -> Camera:
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    return Camera(
        camera_name="c",
        image_width=640,
        image_height=480,
        camera_matrix=MATRIX,
        distortion_model="plumb_bob" if len(coefficients) == 5 else "rational_polynomial",
        distortion_coefficients=coefficients,
        covariance=ParameterCovariance(parameters=names, data=np.diag(np.arange(1.0, 10.0) ** 2)),
    )


def written(tmp_path, form: str, name: str, coefficients: np.ndarray = PLUMB_BOB):
    write_camera_as(tmp_path / name, camera(coefficients), CameraFormat(form), tmp_path / "c.yaml")
    return tmp_path / name


@pytest.mark.parametrize(
    ("form", "name", "coefficients"),
    [
        ("ros", "c.yaml", PLUMB_BOB),
        ("ros", "c.yaml", RATIONAL),
        ("opencv", "c.yml", PLUMB_BOB),
        ("opencv", "c.yml", RATIONAL),
        ("opencv", "c.xml", PLUMB_BOB),
        ("opencv", "c.xml", RATIONAL),
        ("kalibr", "c.yaml", RADTAN),
        ("matlab", "c.mat", PLUMB_BOB),
    ],
)
def test_cameras_round_trip_exactly(tmp_path, form, name, coefficients):
    after = read_camera(written(tmp_path, form, name, coefficients))

    np.testing.assert_array_equal(after.camera_matrix, MATRIX)
    np.testing.assert_array_equal(after.distortion_coefficients, coefficients)
    assert (after.image_width, after.image_height) == (640, 480)
    assert after.covariance is None


def test_the_ringpose_format_keeps_the_covariance(tmp_path):
    write_camera_as(tmp_path / "b.yaml", camera(), CameraFormat.RINGPOSE, written(tmp_path, "ros", "c.yaml"))

    after = read_camera(tmp_path / "b.yaml")
    assert after.covariance.standard_deviations["fy"] == 2.0
    np.testing.assert_array_equal(after.camera_matrix, MATRIX)
    np.testing.assert_array_equal(after.distortion_coefficients, PLUMB_BOB)
    assert (after.camera_name, after.image_width, after.image_height) == ("c", 640, 480)
    assert (tmp_path / "b.yaml").read_text().splitlines()[:2] == ["ringpose: camera/1", "provenance:"]


@pytest.mark.parametrize("name", ["c.yml", "c.xml"])
def test_opencv_reads_the_written_storage(tmp_path, name):
    path = written(tmp_path, "opencv", name)

    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), MATRIX)
    np.testing.assert_array_equal(np.ravel(storage.getNode("distortion_coefficients").mat()), PLUMB_BOB)
    assert storage.getNode("image_width").real() == 640


def test_ros_files_have_no_keys_of_ringpose(tmp_path):
    values = yaml.safe_load(written(tmp_path, "ros", "c.yaml").read_text())

    assert values.keys().isdisjoint({"ringpose", "covariance", "provenance"})


@pytest.mark.parametrize("form", ["ros", "ringpose"])
def test_camera_files_have_the_matrices_that_ros_requires(tmp_path, form):
    source = written(tmp_path, "opencv", "source.yml")
    write_camera_as(tmp_path / "c.yaml", camera(PLUMB_BOB), CameraFormat(form), source)
    values = yaml.safe_load((tmp_path / "c.yaml").read_text())

    projection = np.reshape(values["projection_matrix"]["data"], (3, 4))
    np.testing.assert_array_equal(projection[:, :3], MATRIX)
    np.testing.assert_array_equal(projection[:, 3], np.zeros(3))
    assert values["rectification_matrix"]["data"] == np.eye(3).ravel().tolist()


@pytest.mark.parametrize("coefficients", [PLUMB_BOB, PLUMB_BOB[:4], PLUMB_BOB[:0]])
def test_a_camera_info_file_may_omit_coefficients(tmp_path, coefficients):
    path = written(tmp_path, "ros", "c.yaml")
    values = yaml.safe_load(path.read_text())
    values["distortion_coefficients"] = {"rows": 1, "cols": len(coefficients), "data": coefficients.tolist()}
    path.write_text(yaml.safe_dump(values))

    padded = np.pad(coefficients, (0, 5 - len(coefficients)))
    np.testing.assert_array_equal(read_camera(path).distortion_coefficients, padded)


@pytest.mark.parametrize("letters", ["K D", "k d"])
@pytest.mark.parametrize("end", ["", "---\n"])
def test_a_ros_message_is_read(tmp_path, letters, end):
    matrix, coefficients = letters.split()
    message = {"height": 480, "width": 640, "distortion_model": "plumb_bob", "header": {"frame_id": "camera"}}
    message |= {matrix: MATRIX.ravel().tolist(), coefficients: PLUMB_BOB.tolist()}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(message) + end)

    after = read_camera(tmp_path / "m.yaml")

    np.testing.assert_array_equal(after.camera_matrix, MATRIX)
    np.testing.assert_array_equal(after.distortion_coefficients, PLUMB_BOB)


MESSAGE = {"height": 480, "width": 640, "distortion_model": "plumb_bob", "d": [], "k": MATRIX.ravel().tolist()}


def read_message(folder, **changes):
    (folder / "m.yaml").write_text(yaml.safe_dump(MESSAGE | changes))
    return read_camera(folder / "m.yaml")


@pytest.mark.filterwarnings("ignore::ringpose.errors.ImplausibleValueWarning")  # a window beside the axis
def test_a_pixel_of_a_binned_window_is_the_middle_of_those_it_covers(tmp_path):
    roi = {"x_offset": 40, "y_offset": 30, "width": 400, "height": 300, "do_rectify": False}
    after = read_message(tmp_path, binning_x=4, binning_y=2, roi=roi)

    # a point at pixel (40 + 4 i + 1.5, 30 + 2 j + 0.5) of the full image is at (i, j) of the window
    point = np.array([0.1, -0.05, 1.0])
    full, binned = MATRIX @ point, after.camera_matrix @ point
    np.testing.assert_allclose(full[:2], [40 + 4 * binned[0] + 1.5, 30 + 2 * binned[1] + 0.5], rtol=1e-12)
    assert (after.image_width, after.image_height) == (100, 150)


@pytest.mark.filterwarnings("ignore::ringpose.errors.ImplausibleValueWarning")
def test_binning_and_window_of_a_file_are_applied_as_those_of_a_message(tmp_path):
    readout = {"binning_x": 2, "binning_y": 4, "roi": {"x_offset": 40, "y_offset": 30, "width": 400, "height": 300}}
    of_message = read_message(tmp_path, **readout)
    path = written(tmp_path, "ros", "c.yaml")
    path.write_text(path.read_text() + yaml.safe_dump(readout))

    of_file = read_camera(path)

    np.testing.assert_array_equal(of_file.camera_matrix, of_message.camera_matrix)
    assert (of_file.image_width, of_file.image_height) == (of_message.image_width, of_message.image_height) == (200, 75)


@pytest.mark.parametrize("changes", [{"binning_x": 0, "binning_y": 0}, {"roi": {"width": 0, "height": 0}}, {"roi": {}}])
def test_a_message_without_binning_and_window_is_of_the_full_image(tmp_path, changes):
    after = read_message(tmp_path, **changes)

    np.testing.assert_array_equal(after.camera_matrix, MATRIX)
    assert (after.image_width, after.image_height) == (640, 480)


@pytest.mark.parametrize(
    ("changes", "finding"),
    [
        ({"roi": {"x_offset": 300, "width": 400, "height": 300}}, "roi: reaches beyond the image of 640 x 480 pixels"),
        ({"k": [0.0] * 9}, "camera_matrix: is all zeros: the camera is not calibrated"),
        ({"distortion_model": "", "d": [0.1]}, "distortion_model: is the text ''"),
        ({"binning_x": 1000, "binning_y": 1}, "image_width: is 0, must be at least 1"),
    ],
)
def test_a_message_without_a_usable_camera_is_rejected(tmp_path, changes, finding):
    with pytest.raises(DataError, match=finding):
        read_message(tmp_path, **changes)


CASES = Path(__file__).parents[1] / "cases" / "files"


@pytest.mark.parametrize(
    ("name", "matrix", "coefficients"),
    [
        ("ost.ini", [612.1, 611.8, 321.5, 240.9], [-0.3, 0.1, -0.0004, -0.0011, 0]),
        ("two_messages.yaml", [612.1, 611.8, 321.5, 240.9], [-0.3, 0.1, 0, 0, 0]),
        ("empty_model.yaml", [612.1, 611.8, 321.5, 240.9], [0, 0, 0, 0, 0]),
        ("opencv_without_blanks.yaml", [1039, 1044, 639.5, 356], [0.2, -0.3, 0, 0, 0]),
        ("opencv24_sample_keys.xml", [510, 510, 319.5, 239.5], [0.085, -0.22, 0, 0, 0.038]),
    ],
)
def test_files_of_other_programs_are_read(name, matrix, coefficients):
    after = read_camera(CASES / name)

    assert after.camera_matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == matrix
    assert after.distortion_coefficients.tolist() == coefficients


def test_messages_of_one_camera_may_differ_in_their_headers_only(tmp_path):
    first, second = (
        f"header:\n  seq: {number}\n  stamp: {{secs: {number}}}\n{yaml.safe_dump(MESSAGE)}---\n" for number in (1, 2)
    )
    (tmp_path / "m.yaml").write_text(first + second)
    np.testing.assert_array_equal(read_camera(tmp_path / "m.yaml").camera_matrix, MATRIX)

    (tmp_path / "m.yaml").write_text(first + second.replace("640", "320"))
    with pytest.raises(DataError, match="holds 2 messages of different cameras; keep one message"):
        read_camera(tmp_path / "m.yaml")


CAMCHAIN = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.29404, 0.08204, 0.00031, -0.00012]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
"""


def test_a_camchain_is_read(tmp_path):
    (tmp_path / "camchain.yaml").write_text(CAMCHAIN)

    after = read_camera(tmp_path / "camchain.yaml")

    assert after.camera_matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == [458.654, 457.296, 367.215, 248.375]
    assert after.distortion_coefficients.tolist() == [-0.29404, 0.08204, 0.00031, -0.00012, 0.0]
    assert (after.image_width, after.image_height) == (752, 480)


@pytest.mark.parametrize(
    ("before", "after", "found"),
    [
        ("radtan", "equidistant", "must be one of radtan, none"),
        ("pinhole", "omni", "must be one of pinhole"),
        ("[752, 480]", "[752]", "must have 2"),
        ("-0.00012]", "-0.00012, 0.1]", "must have 4"),
        ("rostopic", "cam_overlap", "did you mean 'cam_overlaps'"),
        (CAMCHAIN, CAMCHAIN + CAMCHAIN.replace("cam0:", "cam1:"), "has 2 cameras"),
    ],
)
def test_a_camchain_of_another_model_is_rejected(tmp_path, before, after, found):
    (tmp_path / "c.yaml").write_text(CAMCHAIN.replace(before, after))

    with pytest.raises(DataError, match=found):
        read_camera(tmp_path / "c.yaml")


@pytest.mark.parametrize(("form", "name"), [("kalibr", "c.yaml"), ("matlab", "c.mat")])
def test_coefficients_that_a_format_does_not_have_are_rejected(tmp_path, form, name):
    with pytest.raises(DataError, match="only"):
        written(tmp_path, form, name, RATIONAL)

    assert not (tmp_path / name).exists()


def test_uncertainties_are_three_standard_deviations_as_in_the_toolbox(tmp_path):
    variables = scipy.io.loadmat(written(tmp_path, "matlab", "c.mat"))

    assert variables["fc_error"].ravel().tolist() == [3.0, 6.0]
    assert variables["kc_error"].ravel().tolist() == [15.0, 18.0, 21.0, 24.0, 27.0]


FROM_ONE = MATRIX + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])

PARAMETERS = {
    "ImageSize": [480, 640],
    "RadialDistortion": [-0.1, 0.12, 0.03],
    "TangentialDistortion": [1e-4, -2e-4],
    "Version": {"Name": "MATLAB"},
}


def test_pixels_of_camera_parameters_are_counted_from_one(tmp_path):
    scipy.io.savemat(tmp_path / "c.mat", {"params": {"K": FROM_ONE, **PARAMETERS}}, do_compression=True)

    after = read_camera(tmp_path / "c.mat")

    np.testing.assert_allclose(after.camera_matrix, MATRIX, atol=1e-12)
    assert after.distortion_coefficients.tolist() == [-0.1, 0.12, 1e-4, -2e-4, 0.03]
    assert (after.image_width, after.image_height) == (640, 480)


def test_an_intrinsic_matrix_is_transposed():
    after = matlab.camera_of({"params": {"IntrinsicMatrix": FROM_ONE.T.tolist(), **PARAMETERS}}, "c.mat", "c")

    np.testing.assert_allclose(after.camera_matrix, MATRIX, atol=1e-12)


@pytest.mark.parametrize(
    ("key", "value", "finding"),
    [
        ("alpha_c", 0.1, "skew"),
        ("nx", None, "has no nx"),
        ("fc", [657.3], "fc: has 1 numbers, must have 2"),
        ("nx", "width", "nx: is the text 'width', must be a number"),
        ("kc", np.zeros(6), "6 distortion coefficients"),
    ],
)
def test_other_mat_variables_are_rejected(key, value, finding):
    toolbox = {"fc": [657.3, 657.7], "cc": [302.7, 242.3], "kc": [-0.26, 0.13, 0, 0, 0], "nx": 640, "ny": 480}
    values = {name: entry for name, entry in {**toolbox, key: value}.items() if entry is not None}

    with pytest.raises(DataError, match=finding):
        matlab.camera_of(values, "c.mat", "c")


def test_damaged_mat_files_give_one_line(tmp_path, capfd):
    content = written(tmp_path, "matlab", "c.mat").read_bytes()
    offset = content.index(np.float64(MATRIX[0, 0]).tobytes()) - 8  # of the type of the numbers of fc
    (tmp_path / "c.mat").write_bytes(content[:offset] + b"\xff" + content[offset + 1 :])

    with pytest.raises(DataError, match=r"c\.mat: is not a valid \.mat file"):
        read_camera(tmp_path / "c.mat")

    assert capfd.readouterr().err == ""


def test_a_mat_file_of_version_7_3_is_rejected_with_a_remedy(tmp_path):
    (tmp_path / "c.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM" + bytes(512))

    with pytest.raises(DataError, match="save it again with -v7"):
        read_camera(tmp_path / "c.mat")


def test_a_mat_file_needs_the_suffix_mat(tmp_path):
    with pytest.raises(UsageError, match=r"c\.m "):
        written(tmp_path, "matlab", "c.m")


def test_a_real_calib_results_file_is_read(shared_data):
    after = read_camera(shared_data / "real" / "uba_laser_plane" / "Calib_Results.mat")

    assert after.camera_matrix[[0, 1, 0, 1], [0, 1, 2, 2]] == pytest.approx(
        [819.580391, 820.87185144, 589.72908798, 355.78486577], abs=1e-6
    )
    assert after.distortion_coefficients[:2] == pytest.approx([0.0981042148, -0.182481427])
    assert (after.image_width, after.image_height) == (1152, 768)


def stored(path, coefficients: np.ndarray, **numbers: int):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, number in ({"image_width": 640, "image_height": 480} | numbers).items():
        if number:
            storage.write(key, number)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", coefficients)
    storage.release()
    return path


STORAGES = ("c.json", "c.yml", "c.xml")


@pytest.mark.parametrize("name", STORAGES)
@pytest.mark.parametrize(
    ("coefficients", "model"),
    [
        (PLUMB_BOB[None], "plumb_bob"),
        (PLUMB_BOB[:, None], "plumb_bob"),
        (PLUMB_BOB, "plumb_bob"),
        (PLUMB_BOB[:4], "plumb_bob"),
        (RATIONAL[:, None], "rational_polynomial"),
        (np.array([-0.1, 0.1, 0, 0, 0.2, 0, 0, 0, 0, 0, 0, 0]), "plumb_bob"),
    ],
)
def test_storage_written_by_opencv_is_read(tmp_path, name, coefficients, model):
    after = read_camera(stored(tmp_path / name, coefficients))

    assert (after.distortion_model, after.image_width, after.image_height) == (model, 640, 480)
    np.testing.assert_array_equal(after.camera_matrix, MATRIX)
    used = min(coefficients.size, len(after.distortion_coefficients))
    np.testing.assert_array_equal(after.distortion_coefficients[:used], coefficients.ravel()[:used])


@pytest.mark.parametrize(
    ("coefficients", "numbers", "finding"),
    [
        (np.full(12, 0.01), {}, "thin prism"),
        (PLUMB_BOB, {"image_width": 0, "image_height": 0}, "add image_width: and image_height: to it"),
        (PLUMB_BOB[:4], {"fisheye_model": 1}, "fisheye_model: is set; calibrate with plumb_bob or rational_polynomial"),
    ],
)
@pytest.mark.parametrize("name", STORAGES)
def test_storage_of_another_camera_is_rejected(tmp_path, name, coefficients, numbers, finding):
    with pytest.raises(DataError, match=finding):
        read_camera(stored(tmp_path / name, coefficients, **numbers))


@pytest.mark.parametrize("name", [*STORAGES, pytest.param("c.mat", marks=pytest.mark.slow)])
def test_a_file_with_random_damage_is_read_or_rejected(tmp_path, name):
    is_mat = name == "c.mat"
    path = written(tmp_path, "matlab", name) if is_mat else stored(tmp_path / name, PLUMB_BOB)
    trials, shortest, first = (20, 200, 126) if is_mat else (25, 20, 0)

    whole, damage, rejected = path.read_bytes(), random.Random(7), 0
    for _ in range(trials):
        content = bytearray(whole[: damage.randrange(shortest, len(whole) + 200)])
        for _ in range(3 if is_mat else 2):
            content[damage.randrange(first, len(content))] = damage.randrange(256)
        path.write_bytes(content)
        try:
            read_camera(path)
        except DataError:
            rejected += 1

    assert rejected > (5 if is_mat else 12)


NESTED = ("%YAML:1.0\n---\na: " + "[" * 99_999, "<?xml version='1.0'?>" + "<a>" * 99_999)
OTHERS = ("a: 1", "- 1", "%YAML:1.0\n---\na: 1", "<?xml version='1.0'?><opencv_storage>", "<?xml")


@pytest.mark.parametrize("text", [*NESTED, *OTHERS])
def test_a_file_that_is_not_a_camera_gives_one_line(tmp_path, text, capfd):
    (tmp_path / "c.yml").write_text(text)

    with pytest.raises(DataError) as caught:
        read_camera(tmp_path / "c.yml")

    assert str(caught.value).startswith(str(tmp_path / "c.yml"))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("values", "finding"),
    [
        ({"width": 640, "k": [8.0, 0, 4, 0, 8, 3, 0, 0, 1]}, "has a focal length of 8 pixels; give pixels"),
        ({"width": 10**30, "k": MATRIX.ravel().tolist()}, "image_width: is 1e\\+30, must be at least 1 and at most"),
    ],
)
def test_invalid_image_sizes_are_rejected(tmp_path, values, finding):
    message = {"height": 480, "distortion_model": "plumb_bob", "d": PLUMB_BOB.tolist()} | values
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(message))

    with pytest.raises(DataError, match=finding):
        read_camera(tmp_path / "m.yaml")


def test_the_camera_of_a_rig_has_its_part_of_the_joint_covariance(tmp_path):
    write_camera(tmp_path / "c.yaml", camera())
    values = yaml.safe_load((tmp_path / "c.yaml").read_text())
    joint = np.diag([100.0, *np.arange(1.0, 10.0) ** 2])
    names = ["left.distance", *values["covariance"]["parameters"]]
    del values["covariance"], values["ringpose"], values["provenance"]
    rig = {"ringpose": "rig/1", "camera": values, "covariance": {"parameters": names, "data": joint.tolist()}}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))

    covariance = read_camera(tmp_path / "rig.yaml").covariance

    assert covariance.parameters == tuple(names[1:])
    np.testing.assert_array_equal(covariance.data, joint[1:, 1:])
