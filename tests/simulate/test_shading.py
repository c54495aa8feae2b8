import numpy as np
import pytest

from ringpose.kernels.render import reflectances
from ringpose.types.target import MATERIALS, Material

UP = np.array([[0.0], [0.0], [1.0]])


def coating(material):
    return material.diffuse, material.specular, material.roughness


def directions(n=400):
    """Unit vectors on the upper half sphere, and the solid angle of each times its cosine."""
    cosine = (np.arange(n) + 0.5) / n
    angle = 2 * np.pi * (np.arange(2 * n) + 0.5) / (2 * n)
    z, phi = (grid.ravel() for grid in np.meshgrid(cosine, angle))
    sine = np.sqrt(1 - z**2)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), z]), z * 2 * np.pi / len(z)


def reflected_share(material, to_light):
    to_eye, weight = directions()
    n = to_eye.shape[1]
    light = np.repeat(to_light[:, None], n, axis=1)
    return float(reflectances(coating(material), np.repeat(UP, n, axis=1), light, to_eye) @ weight)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.7, 1.3])
@pytest.mark.parametrize("name", MATERIALS)
def test_surfaces_conserve_energy(name, tilt_rad):
    share = reflected_share(MATERIALS[name], np.array([np.sin(tilt_rad), 0.0, np.cos(tilt_rad)]))

    assert share < 1.0


def test_a_matt_surface_reflects_its_albedo():
    matt = Material(diffuse=0.3, specular=0.0, roughness=1.0)

    assert reflected_share(matt, np.array([0.6, 0.0, 0.8])) == pytest.approx(0.3, rel=1e-3)


def test_a_polished_surface_reflects_its_specular_reflectance():
    polished = Material(diffuse=0.0, specular=0.5, roughness=0.1)

    assert reflected_share(polished, np.array([0.0, 0.0, 1.0])) == pytest.approx(0.5, rel=0.03)


def test_light_and_eye_can_change_places(rng):
    pairs = rng.standard_normal((2, 3, 200))
    pairs[:, 2] = np.abs(pairs[:, 2])
    first, second = pairs / np.linalg.norm(pairs, axis=1, keepdims=True)
    metal = coating(MATERIALS["metal"])
    normal = np.repeat(UP, 200, axis=1)

    there = reflectances(metal, normal, first, second)
    back = reflectances(metal, normal, second.copy(), first)

    np.testing.assert_allclose(there, back, rtol=1e-4)


def test_the_mirror_direction_is_the_brightest():
    to_eye, _ = directions(200)
    light = np.repeat(np.array([[0.5], [0.0], [np.sqrt(0.75)]]), to_eye.shape[1], axis=1)
    foil = coating(MATERIALS["foil"])

    brightest = to_eye[:, np.argmax(reflectances(foil, np.repeat(UP, len(light.T), axis=1), light, to_eye))]

    assert brightest @ [-0.5, 0.0, np.sqrt(0.75)] > 0.99
