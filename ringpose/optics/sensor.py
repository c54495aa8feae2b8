"""Linear camera model of EMVA 1288: from radiance to grey values."""

import functools

import numpy as np

from ringpose.types.arrays import Array, Float32, UInt
from ringpose.types.scene import Optics, Sensor

_PLANCK_TIMES_LIGHT_J_M = 6.62607015e-34 * 299792458.0


def electrons_per_radiance(sensor: Sensor, lens: Optics) -> float:
    """Electrons per second in a pixel for a surface radiance of 1 W/(m2 sr)."""
    irradiance_per_radiance = np.pi * lens.transmission / (4 * lens.f_number**2)
    photons_per_j = sensor.wavelength_m / _PLANCK_TIMES_LIGHT_J_M
    return float(irradiance_per_radiance * sensor.pixel_m**2 * photons_per_j * sensor.quantum_efficiency)


def digitised(
    electrons: Float32[Array, "row column"], sensor: Sensor, generator: np.random.Generator
) -> UInt[Array, "row column"]:
    """Grey values of one exposure with this expected number of electrons.

    Shot noise is Gaussian with the variance of the Poisson distribution; with 8 electrons of dark noise, the two are
    indistinguishable. Electrons are limited by the saturation capacity, grey values by the maximum code.
    """
    expected = electrons * pixel_responses(sensor, electrons.shape[0], electrons.shape[1])
    noise = generator.standard_normal(electrons.shape, dtype=np.float32)
    collected = expected + noise * np.sqrt(expected + np.float32(sensor.temporal_dark_noise_e**2))
    full = np.minimum(collected, np.float32(sensor.saturation_capacity_e))
    grey = full * np.float32(sensor.overall_system_gain_dn_per_e) + np.float32(sensor.black_level_dn)
    codes = np.asarray(np.rint(grey).clip(0, saturation_dn(sensor)))
    return codes.astype(np.uint8 if sensor.bits == 8 else np.uint16)


def saturation_dn(sensor: Sensor) -> int:
    """Maximum grey value of the analogue-to-digital converter."""
    return int(2**sensor.bits - 1)


@functools.lru_cache(maxsize=2)
def pixel_responses(sensor: Sensor, height: int, width: int) -> Float32[Array, "row column"]:
    """Relative response of each pixel (PRNU), 1 on average; the same for all images of this size."""
    generator = np.random.default_rng([height, width])
    deviation = generator.standard_normal((height, width), dtype=np.float32)
    responses: Float32[Array, "row column"] = 1 + np.float32(sensor.photo_response_non_uniformity) * deviation
    return responses
