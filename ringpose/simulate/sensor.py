"""From light to grey values: EMVA 1288's linear model."""

import functools

import numpy as np

from ringpose.types.arrays import Array, Float32, UInt
from ringpose.types.scene import Lens, Sensor

_PLANCK_TIMES_LIGHT_J_M = 6.62607015e-34 * 299792458.0


def electrons_per_radiance(sensor: Sensor, lens: Lens) -> float:
    """Electrons a second in one pixel for each W/(m2 sr) of the surface that it sees."""
    irradiance_per_radiance = np.pi * lens.transmission / (4 * lens.f_number**2)
    photons_per_j = sensor.wavelength_m / _PLANCK_TIMES_LIGHT_J_M
    return float(irradiance_per_radiance * sensor.pixel_m**2 * photons_per_j * sensor.quantum_efficiency)


def digitised(
    electrons: Float32[Array, "row column"], sensor: Sensor, generator: np.random.Generator
) -> UInt[Array, "row column"]:
    """Grey values of one exposure, given the electrons expected in it.

    Shot noise is drawn as a Gaussian of the same variance: beside eight electrons of dark noise no histogram
    tells it from Poisson's. The pixel is full at its saturation capacity, the converter at its last code.
    """
    expected = electrons * pixel_responses(sensor, electrons.shape[0], electrons.shape[1])
    noise = generator.standard_normal(electrons.shape, dtype=np.float32)
    collected = expected + noise * np.sqrt(expected + np.float32(sensor.temporal_dark_noise_e**2))
    full = np.minimum(collected, np.float32(sensor.saturation_capacity_e))
    grey = full * np.float32(sensor.overall_system_gain_dn_per_e) + np.float32(sensor.black_level_dn)
    codes = np.asarray(np.rint(grey).clip(0, saturation_dn(sensor)))
    return codes.astype(np.uint8 if sensor.bits == 8 else np.uint16)


def saturation_dn(sensor: Sensor) -> int:
    """The converter's last code."""
    return int(2**sensor.bits - 1)


@functools.lru_cache(maxsize=2)
def pixel_responses(sensor: Sensor, height: int, width: int) -> Float32[Array, "row column"]:
    """Each pixel's own response, 1 on average; the same for every image of a sensor of that size."""
    generator = np.random.default_rng([height, width])
    deviation = generator.standard_normal((height, width), dtype=np.float32)
    responses: Float32[Array, "row column"] = 1 + np.float32(sensor.photo_response_non_uniformity) * deviation
    return responses
