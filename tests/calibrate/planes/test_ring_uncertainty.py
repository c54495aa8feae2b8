"""Uncertainty of a ring's centre by the calibration's covariance, against sampled rigs."""

import numpy as np
import pytest
from known_views import DISTANCES_M, NORMALS, TRUE_CAMERA

from ringpose.calibrate.planes.covariance import of_camera, ring_center_sd_m
from ringpose.types.rig import LaserPlanes, ParameterCovariance, Rig

NAMES = ("left", "middle", "right")
RADII_M = np.array([0.567, 0.597])
PLANES = tuple(f"{name}.{what}" for name in NAMES for what in ("tilt_1", "tilt_2", "distance"))
SD = np.tile([1e-5, 3e-5, 1.5e-5], 3)
DRAWS = 400


@pytest.fixture
def rig() -> Rig:
    lasers = LaserPlanes(names=NAMES, normal=NORMALS, distance_m=DISTANCES_M, projector_m=np.full((3, 3), np.nan))
    return Rig(camera=TRUE_CAMERA, lasers=lasers, covariance=planes_covariance())


def planes_covariance(sd: np.ndarray = SD) -> ParameterCovariance:
    return ParameterCovariance(parameters=PLANES, data=np.diag(sd**2))


def break_points_m(depth_m: float) -> np.ndarray:
    """Where the planes, which run along x, cut a ring that faces the camera: inner and outer edge of each in turn."""
    y = (DISTANCES_M - NORMALS[:, 2] * depth_m) / NORMALS[:, 1]
    side = np.sqrt(RADII_M**2 - (y[:, None] - np.median(y)) ** 2)
    x = RADII_M.mean() - side
    return np.stack([x, np.repeat(y[:, None], 2, axis=1), np.full((3, 2), depth_m)], axis=-1)


def seen_center_m(points: np.ndarray, wrong: np.ndarray) -> np.ndarray:
    """The centre measured with planes wrong by tilts about z and x and by distance: two circles in their plane."""
    normal = NORMALS - wrong[:, :1] * [1.0, 0.0, 0.0]
    normal[:, 1:] += wrong[:, 1:2] * np.stack([-NORMALS[:, 2], NORMALS[:, 1]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    share = (DISTANCES_M + wrong[:, 2])[:, None] / np.einsum("lex,lx->le", points, normal)
    seen = (share[..., None] * points).reshape(-1, 3)
    middle = seen.mean(axis=0)
    first, second, _ = np.linalg.svd(seen - middle, full_matrices=False)[2]
    flat = (seen - middle) @ np.stack([first, second]).T
    design = np.column_stack([2 * flat, np.tile(np.eye(2), (3, 1))])
    found = np.linalg.lstsq(design, np.sum(flat**2, axis=1), rcond=None)[0]
    return middle + found[0] * first + found[1] * second


@pytest.mark.parametrize("depth_m", [0.5, 1.0])
def test_the_centre_of_a_ring_has_the_predicted_errors(depth_m, rng, rig):
    points = break_points_m(depth_m)
    drawn = np.array([seen_center_m(points, (SD * rng.standard_normal(9)).reshape(3, 3)) for _ in range(DRAWS)])

    predicted = ring_center_sd_m(rig, depth_m)

    assert predicted == pytest.approx(np.std(drawn, axis=0), rel=0.15)
    assert np.isnan(ring_center_sd_m(rig, 0.1)).all()  # it misses a stripe


def test_the_share_of_the_camera_is_the_covariance_by_which_the_planes_follow_it(rng):
    camera = np.diag([0.1, 0.2, 1e-4]) ** 2
    follow = rng.standard_normal((9, 3)) * [1e-4, 1e-4, 0.1]
    cross = follow @ camera
    data = np.block([[camera, cross.T], [cross, np.diag(SD**2) + cross @ follow.T]])

    found = of_camera(ParameterCovariance(parameters=("fx", "fy", "k1", *PLANES), data=data)).data

    assert found[3:, 3:] == pytest.approx(cross @ follow.T, rel=1e-6, abs=1e-18)
    assert not of_camera(planes_covariance()).data.any()
