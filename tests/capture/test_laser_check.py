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
def places(line_dn, rng) -> LitPixels:
    dark_dn = np.full(line_dn.shape, 5.0)
    found = lit_pixels(pictured(dark_dn + line_dn, rng), [pictured(dark_dn, rng)], 255)
    assert found is not None
    return found


@pytest.mark.parametrize("ambient_dn", [5.0, 60.0, 150.0])
def test_a_line_stands_out_in_any_ambient_light(places, line_dn, rng, ambient_dn):
    assert places.stand_out_in(pictured(ambient_dn + line_dn, rng))


@pytest.mark.parametrize("ambient_dn", [5.0, 60.0, 150.0])
def test_ambient_light_is_no_line(places, line_dn, rng, ambient_dn):
    assert not places.stand_out_in(pictured(np.full(line_dn.shape, ambient_dn), rng))


def test_ambient_light_on_a_surface_with_an_edge_is_no_line(places, line_dn, rng):
    surface_dn = np.zeros(line_dn.shape)
    surface_dn[ROW - 20 :] = 90.0

    assert places.are_lit_in(pictured(surface_dn, rng))
    assert not places.stand_out_in(pictured(surface_dn, rng))
