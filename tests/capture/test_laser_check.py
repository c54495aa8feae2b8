"""Recognition of a laser line in an image, as opposed to ambient light."""

import numpy as np
import pytest

from ringpose.capture.laser_check import LitPixels, lit_pixels
from ringpose.types.arrays import Array, Float64, UInt8

ROW = 60


def pictured(light_dn: Float64[Array, "row column"], rng: np.random.Generator) -> UInt8[Array, "row column"]:
    noisy = light_dn + rng.normal(0.0, 1.0, light_dn.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@pytest.fixture
def line_dn():
    """A laser line, four pixels thick, in an image of 200 x 120 pixels."""
    light_dn = np.zeros((120, 200))
    light_dn[ROW : ROW + 4] = 40.0
    return light_dn


@pytest.fixture
def pixels(line_dn, rng) -> LitPixels:
    dark_dn = np.full(line_dn.shape, 5.0)
    found = lit_pixels(pictured(dark_dn + line_dn, rng), [pictured(dark_dn, rng)], 255)
    assert found is not None
    return found


@pytest.mark.parametrize("ambient_dn", [5.0, 60.0, 150.0])
def test_a_line_stands_out_in_any_ambient_light(pixels, line_dn, rng, ambient_dn):
    assert pixels.are_on_in(pictured(ambient_dn + line_dn, rng))


@pytest.mark.parametrize("ambient_dn", [5.0, 60.0, 150.0])
def test_ambient_light_is_no_line(pixels, line_dn, rng, ambient_dn):
    assert not pixels.are_on_in(pictured(np.full(line_dn.shape, ambient_dn), rng))


def test_ambient_light_on_a_surface_with_an_edge_is_no_line(pixels, line_dn, rng):
    surface_dn = np.zeros(line_dn.shape)
    surface_dn[ROW - 20 :] = 90.0

    assert pixels.are_lit_in(pictured(surface_dn, rng))
    assert not pixels.are_on_in(pictured(surface_dn, rng))


@pytest.mark.parametrize("is_on", [True, False])
def test_a_laser_along_a_bright_line_of_the_scene_is_told_from_it(line_dn, rng, is_on):
    scene_dn = 5.0 + line_dn
    pixels = lit_pixels(pictured(scene_dn + line_dn, rng), [pictured(scene_dn, rng)], 255)

    assert pixels is not None
    assert pixels.are_on_in(pictured(scene_dn + is_on * line_dn, rng)) is is_on


@pytest.mark.parametrize("is_on", [True, False])
def test_light_that_is_no_line_is_a_laser_s_where_no_lamp_can_have_lit_the_pixels(rng, is_on):
    spot_dn = np.zeros((120, 200))
    spot_dn[30:90, 60:140] = 40.0
    pixels = lit_pixels(pictured(5.0 + spot_dn, rng), [pictured(np.full((120, 200), 5.0), rng)], 255)

    assert pixels is not None
    image = pictured(5.0 + is_on * spot_dn, rng)
    assert pixels.are_on_in(image, by_lamp=False) is is_on
    assert not pixels.are_on_in(image)
