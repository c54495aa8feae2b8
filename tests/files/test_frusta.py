"""Cameras by the frustum of OpenGL, against the matrices of glFrustum and glViewport and a rendered picture."""

import numpy as np
import pytest
import yaml
from ring_scenes import RIGS, Ring

from ringpose.cli.main import main
from ringpose.errors import DataError
from ringpose.files.images.shots import read_shot
from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig
from ringpose.geometry.rays import project
from ringpose.measure.stream import Setup

WIDTH, HEIGHT = 640, 480
FRUSTUM = {"left": -0.09, "right": 0.11, "bottom": -0.08, "top": 0.07, "near": 0.25}


def opengl_px(points_m):
    """Pixels of points in the camera frame by glFrustum and glViewport; OpenGL looks along -z, its y is upwards."""
    left, right, bottom, top, near = FRUSTUM.values()
    far = 100.0
    frustum = np.array([
        [2 * near / (right - left), 0, (right + left) / (right - left), 0],
        [0, 2 * near / (top - bottom), (top + bottom) / (top - bottom), 0],
        [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
        [0, 0, -1, 0],
    ])  # fmt: skip
    eye = points_m * [1, -1, -1]
    clip = np.column_stack([eye, np.ones(len(eye))]) @ frustum.T
    device = clip[:, :2] / clip[:, 3:]
    window = (device + 1) / 2 * [WIDTH, HEIGHT]  # from the lower left corner of the image
    return np.column_stack([window[:, 0] - 0.5, HEIGHT - window[:, 1] - 0.5])


def rig_values(**camera):
    rig = {"ringpose": "rig/1", "lasers": []}
    rig["camera"] = {
        "image_width": WIDTH,
        "image_height": HEIGHT,
        "frustum": FRUSTUM,
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0, 0, 0, 0, 0]},
        **camera,
    }
    lasers = RIGS["B"].lasers
    for name, normal, distance_m in zip(lasers.names, lasers.normal.tolist(), lasers.distance_m.tolist(), strict=True):
        rig["lasers"].append({"name": name, "normal": normal, "distance_m": distance_m, "projector_m": [0, -0.06, 0]})
    return rig


@pytest.fixture
def rig_file(tmp_path):
    def written(**camera):
        file = tmp_path / "rig.yaml"
        file.write_text(yaml.safe_dump(rig_values(**camera)))
        return file

    return written


def test_points_are_projected_as_by_opengl(rig_file):
    points_m = np.array([[0.0, 0.0, 0.5], [0.1, 0.05, 0.6], [-0.1, 0.1, 0.4], [0.02, -0.1, 2.0]])

    found_px = project(points_m, read_rig(rig_file()).camera)

    np.testing.assert_allclose(found_px, opengl_px(points_m), rtol=0, atol=1e-9)


def test_the_corners_of_the_near_plane_are_those_of_the_image(rig_file):
    corners_m = np.array(
        [[FRUSTUM["left"], -FRUSTUM["top"], FRUSTUM["near"]], [FRUSTUM["right"], -FRUSTUM["bottom"], 0.25]]
    )

    found_px = project(corners_m, read_rig(rig_file()).camera)

    np.testing.assert_allclose(found_px, [[-0.5, -0.5], [WIDTH - 0.5, HEIGHT - 0.5]], rtol=0, atol=1e-9)


def test_a_rendered_ring_is_where_opengl_projects_it(rig_file, tmp_path):
    scene = {
        "ringpose": "scene/1",
        "rig": rig_file().name,
        "sequence": "off,1,2,3",
        "stripe_dn": 170,
        "sensor": {"pixel_m": 9e-6},
        "ring": {"radius_inner_m": 0.567, "radius_outer_m": 0.597, "height_m": 0.06, "face": "metal", "wall": "metal"},
        "body": {"size_m": [2.2, 2.2, 1.0], "material": "foil", "foil": {"rms_m": 0.0008, "crinkle_m": 0.03}},
        "lasers": {"power_w": 0.02, "sigma_m": 0.0002, "divergence_rad": 0.0007},
        "lights": {"dim": {}},
        "trajectory": [{"name": "a", "center_m": [0.58, 0.02, 0.5], "normal": [0.0, 0.1, -0.9949874371066199]}],
    }
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    assert main(["simulate", str(tmp_path / "scene.yaml"), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    rig, (truth,) = read_rig(tmp_path / "rig.yaml"), read_truths(tmp_path / "out" / "truth.jsonl")
    ring = Ring(center_m=truth.center_m, normal=truth.normal, radius_m=(truth.radius_inner_m, truth.radius_outer_m))
    ends_m = ring.break_points_m(rig.lasers)

    found = Setup(rig=rig).detection(read_shot(tmp_path / "out" / "shots" / "a.npz"))

    off_px = found.break_points.position_px.reshape(-1, 2) - opengl_px(ends_m.reshape(-1, 3))
    assert np.abs(off_px).max() < 0.5


@pytest.mark.parametrize(
    ("camera", "finding"),
    [
        ({"frustum": FRUSTUM | {"right": -0.2}}, "must be greater than left"),
        ({"frustum": FRUSTUM | {"top": -0.07, "bottom": 0.08}}, "y is upwards"),
        ({"frustum": FRUSTUM | {"near": 0.0}}, "near"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [500, 0, 320, 0, 500, 240, 0, 0, 1]}}, "give one of them"),
        ({"frustum": None}, "neither camera_matrix nor frustum"),
    ],
)
def test_a_frustum_that_is_none_is_named(camera, finding, rig_file):
    with pytest.raises(DataError, match=finding):
        read_rig(rig_file(**camera))
