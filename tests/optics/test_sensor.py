from dataclasses import replace

import numpy as np
import pytest

from ringpose.optics.sensor import digitised, electrons_per_radiance
from ringpose.types.scene import Optics, Sensor

EVEN = Sensor(photo_response_non_uniformity=0.0, bits=12, overall_system_gain_dn_per_e=0.3, black_level_dn=20.0)


def image_at(level_e, sensor, rng):
    return digitised(np.full((200, 300), level_e, dtype=np.float32), sensor, rng).astype(float)


def test_variance_grows_with_the_mean_by_the_systems_gain(rng):
    """EMVA 1288: var = K^2 dark + K (mean - black), K in DN per electron."""
    levels_e = np.linspace(0, 9000, 12)

    images = [image_at(level, EVEN, rng) for level in levels_e]

    gain, dark_variance = np.polyfit([im.mean() - 20.0 for im in images], [im.var() for im in images], 1)
    assert gain == pytest.approx(0.3, rel=0.02)
    assert dark_variance == pytest.approx((0.3 * 8.0) ** 2 + 1 / 12, abs=4.0)


@pytest.mark.parametrize(("bits", "kind", "most"), [(8, np.uint8, 255), (12, np.uint16, 4095)])
def test_the_converters_last_code(bits, kind, most, rng):
    steep = replace(EVEN, bits=bits, overall_system_gain_dn_per_e=1.0)

    image = digitised(np.full((20, 30), 5e4, dtype=np.float32), steep, rng)

    assert (image.dtype, image.max()) == (kind, most)


def test_the_pattern_of_the_pixels_stays(rng):
    """The mean over many frames shows the responses of the pixels."""
    uneven = replace(EVEN, photo_response_non_uniformity=0.02)
    first, second = (np.mean([image_at(8000.0, uneven, rng) for _ in range(30)], axis=0) for _ in range(2))

    correlation = np.corrcoef(first.ravel(), second.ravel())[0, 1]

    assert correlation > 0.9


def test_grey_values_are_black_level_plus_gain_times_electrons_up_to_the_capacity(rng):
    assert image_at(5000.0, EVEN, rng).mean() == pytest.approx(20.0 + 0.3 * 5000.0, abs=0.5)
    assert image_at(0.0, EVEN, rng).std() == pytest.approx(0.3 * 8.0, rel=0.02)
    assert image_at(50000.0, EVEN, rng).max() == round(20 + 0.3 * 12000)


def test_electrons_scale_with_the_inverse_square_of_the_f_number():
    wide, narrow = (electrons_per_radiance(Sensor(), Optics(f_number=stop)) for stop in (4.0, 8.0))

    assert wide == pytest.approx(4 * narrow)


def test_electrons_per_radiance_by_hand():
    """1 W/(m2 sr) at f/8, 0.9 transmitted: 11 mW/m2; on 4.5 um: 0.22 pW = 7.3e5 photons of 650 nm a second."""
    assert electrons_per_radiance(Sensor(), Optics()) == pytest.approx(0.5 * 7.32e5, rel=0.01)
