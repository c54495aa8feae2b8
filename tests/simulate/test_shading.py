"""Reflection by coatings: the radiance of a wide plate in the sun."""

import numpy as np
import pytest

from ringpose.simulate.light import IlluminatedTarget, radiance_along
from ringpose.simulate.placement import Placement
from ringpose.simulate.target.parts import target_tables
from ringpose.types.scene import LaserLight, Light
from ringpose.types.target import MATERIALS, Box, Material, Part

SIDE_M = np.array([1e4, 1e4, 1.0])
FACING = Placement(rotation=np.diag([1.0, -1.0, -1.0]), translation_m=np.array([0.0, 0.0, 1.0]))


@pytest.fixture
def brdf(small_rig):
    """Returns the BRDF (1/sr) of a material with the normal (0, 0, 1), by unit vectors towards a light and eyes."""

    def found(material, to_light, to_eye):
        shape = Box(low_m=-SIDE_M, high_m=SIDE_M * [1.0, 1.0, 0.0])
        illuminated = IlluminatedTarget(
            target=target_tables([Part(name="plate", shape=shape, materials=(material,) * 6)]),
            placement=FACING, during=(FACING,), planes=small_rig.lasers, laser_light=LaserLight(), lasers=(),
            light=Light(name="sun", sun_w_m2=1.0, sun_direction=FACING.rotation @ to_light),
        )  # fmt: skip
        return radiance_along(illuminated, -(FACING.rotation @ to_eye).T)[0].astype(float) / to_light[2]

    return found


def hemisphere(n=400):
    """Unit vectors on the upper half sphere, and the solid angle of each times its cosine."""
    cosine = (np.arange(n) + 0.5) / n
    angle = 2 * np.pi * (np.arange(2 * n) + 0.5) / (2 * n)
    z, phi = (grid.ravel() for grid in np.meshgrid(cosine, angle))
    sine = np.sqrt(1 - z**2)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), z]), z * 2 * np.pi / len(z)


@pytest.mark.parametrize("tilt_rad", [0.0, 1.3])
@pytest.mark.parametrize("name", MATERIALS)
def test_surfaces_conserve_energy(brdf, name, tilt_rad):
    to_eye, weight = hemisphere()

    assert brdf(MATERIALS[name], np.array([np.sin(tilt_rad), 0.0, np.cos(tilt_rad)]), to_eye) @ weight < 1.0


@pytest.mark.parametrize(
    ("material", "to_light", "share", "tolerance"),
    [
        (Material(diffuse=0.3, specular=0.0, roughness=1.0), [0.6, 0.0, 0.8], 0.3, 1e-3),
        (Material(diffuse=0.0, specular=0.5, roughness=0.1), [0.0, 0.0, 1.0], 0.5, 0.03),
    ],
    ids=["matt", "polished"],
)
def test_a_surface_reflects_its_albedo_or_its_specular_reflectance(brdf, material, to_light, share, tolerance):
    to_eye, weight = hemisphere()

    assert brdf(material, np.array(to_light), to_eye) @ weight == pytest.approx(share, rel=tolerance)


def test_light_and_eye_can_change_places(brdf, rng):
    pairs = rng.standard_normal((20, 2, 3))
    pairs[..., 2] = np.abs(pairs[..., 2])
    pairs /= np.linalg.norm(pairs, axis=-1, keepdims=True)

    there, back = ([brdf(MATERIALS["metal"], a, b[:, None])[0] for a, b in both] for both in (pairs, pairs[:, ::-1]))

    np.testing.assert_allclose(there, back, rtol=1e-4)


def test_the_mirror_direction_is_the_brightest(brdf):
    to_eye, _ = hemisphere(200)

    brightest = to_eye[:, np.argmax(brdf(MATERIALS["foil"], np.array([0.5, 0.0, np.sqrt(0.75)]), to_eye))]

    assert brightest @ [-0.5, 0.0, np.sqrt(0.75)] > 0.99
