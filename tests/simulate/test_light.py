"""Sun, Earth and shadows between parts, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from ringpose.simulate.light import earthshine_w_m2, radiance_along
from ringpose.simulate.pipeline import illuminated_ring
from ringpose.simulate.renderer import layers, pixel_rays
from ringpose.types.scene import Earth, Light
from ringpose.types.target import MATERIALS, Box, Part

SUN_W_M2 = 1361.0
TOWARDS_CAMERA = np.array([0.0, 0.0, -1.0])


def plate(name, center_m, size_m, material="white"):
    half_m = np.array(size_m) / 2
    return Part(
        name=name,
        shape=Box(low_m=-half_m, high_m=half_m),
        materials=(MATERIALS[material],) * 6,
        translation_m=np.array(center_m, dtype=float),
    )


@pytest.fixture
def plates(clean_scene, view):
    """A white plate that faces the camera 1 m away (z = 0 in the target frame), and what else is given."""

    def made(light, *parts):
        scene = replace(
            clean_scene,
            body=None,
            parts=(plate("screen", [0, 0, -0.01], [3.0, 3.0, 0.02]), *parts),
            ring=replace(clean_scene.ring, profile_m=np.array([[1.0, 0.0], [1.1, 0.0]])),
            lights={"sky": light},
        )
        facing = replace(view, center_m=np.array([0.0, 0.0, 1.0]), normal=TOWARDS_CAMERA, light="sky", target="body")
        return scene, facing

    return made


def ambient(scene, view):
    return layers(illuminated_ring(scene, view), pixel_rays(scene.rig.camera)).ambient


OBLIQUE = np.array([0.6, 0.0, -0.8])
EARTH = Earth(direction=TOWARDS_CAMERA)


@pytest.mark.parametrize(
    ("light", "irradiance_w_m2", "tolerance"),
    [
        (Light(name="sky", sun_w_m2=SUN_W_M2, sun_direction=OBLIQUE), 0.8 * SUN_W_M2, 1e-6),
        (Light(name="sky", sun_w_m2=SUN_W_M2, sun_direction=-TOWARDS_CAMERA, earth=EARTH), SUN_W_M2 / 220, 0.03),
        (Light(name="sky", earth=EARTH), 0.0, 0.0),
    ],
    ids=["sun", "earth opposite the sun", "earth without sun"],
)
def test_a_white_screen_reflects_sun_and_earthshine_by_lamberts_law(plates, light, irradiance_w_m2, tolerance):
    scene, view = plates(light)

    assert ambient(scene, view)[120, 160] == pytest.approx(irradiance_w_m2 * 0.8 / np.pi, rel=tolerance)


def test_the_penumbra_of_an_edge_is_as_wide_as_the_suns_disc(plates):
    """Light beside the shadow of a long edge: the share of a disc on one side of a chord."""
    above_m = 0.4
    edge = plate("edge", [1.0, 0.0, above_m], [1.0, 3.0, 1e-4], "black")
    light = Light(name="sky", sun_w_m2=SUN_W_M2, sun_direction=np.array([0.8, 0.0, -0.6]), sun_diameter_rad=0.04)
    scene, view = plates(light, edge)
    shadow_x_m = 0.5 - above_m * 0.8 / 0.6  # of the edge at x = 0.5, in the target frame
    target_x = illuminated_ring(scene, view).placement.rotation[:, 0]

    x_m = shadow_x_m + np.linspace(-0.02, 0.02, 9)
    scene = replace(scene, rig=replace(scene.rig, camera=replace(scene.rig.camera, image_width=320)))
    light_share = shares_along(scene, view, x_m * target_x[0])

    half_width_m = 0.02 * above_m / 0.6**2  # of the penumbra: the disc's radius, cast obliquely
    u = np.clip((shadow_x_m - x_m) / half_width_m, -1, 1)
    expected = 1 - (np.arccos(u) - u * np.sqrt(1 - u * u)) / np.pi
    np.testing.assert_allclose(light_share, expected, atol=0.05)


def shares_along(scene, view, x_m):
    """Light at points of the screen, as a share of that without a shadow, averaged over the pixels in a column."""
    image = ambient(scene, view)
    matrix = scene.rig.camera.camera_matrix
    columns = matrix[0, 0] * x_m + matrix[0, 2]
    full = SUN_W_M2 * 0.6 * 0.8 / np.pi
    rows = image[100:140].mean(axis=0)
    return np.interp(columns, np.arange(image.shape[1]), rows) / full


def test_every_part_shadows_every_other_from_the_sun(plates):
    small = plate("small", [0.0, 0.0, 0.3], [0.1, 0.1, 0.01], "black")
    light = Light(name="sky", sun_w_m2=SUN_W_M2, sun_direction=np.array([0.3, 0.0, -1.0]))
    scene, view = plates(light, small)
    illuminated = illuminated_ring(scene, view)
    x_axis = illuminated.placement.rotation[:, 0]

    shadow, beside = -0.09 * x_axis, 0.12 * x_axis
    radiance = radiance_along(illuminated, np.stack([shadow, beside]) - TOWARDS_CAMERA)[0]

    assert radiance[0] == 0.0
    assert radiance[1] > 0.0


def test_earthshine_is_a_220th_of_the_sun_and_follows_the_phase_of_a_lambert_sphere():
    earth = Earth(direction=np.array([0.0, 0.0, -1.0]))

    full, half, new = (
        earthshine_w_m2(earth, SUN_W_M2, np.array(sun)) for sun in ([0.0, 0, 1], [1.0, 0, 0], [0.0, 0, -1])
    )

    assert SUN_W_M2 / full == pytest.approx(220, rel=0.02)
    assert np.degrees(2 * earth.angular_radius_rad) == pytest.approx(17.4, abs=0.05)
    assert half / full == pytest.approx(1 / np.pi)
    assert new == pytest.approx(0.0, abs=1e-12)


def test_the_earth_stands_behind_the_target_with_its_angular_size(plates):
    """Area of the disc in the image; its radiance is that of a Lambert sphere lit from behind the camera."""
    earth = Earth(direction=np.array([0.0, 0.0, 1.0]), orbit_radius_m=6.378e6 / np.sin(0.15))
    scene, view = plates(Light(name="sky", sun_w_m2=SUN_W_M2, sun_direction=TOWARDS_CAMERA, earth=earth))

    image = ambient(scene, replace(view, target="none"))

    assert (image > 0).sum() == pytest.approx(np.pi * (356 * np.tan(0.15)) ** 2, rel=0.03)
    assert image.max() == pytest.approx(SUN_W_M2 * 0.3 / np.pi, rel=1e-3)
