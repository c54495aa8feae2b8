"""Detection of changing ambient light, as opposed to noise, laser lines and motion."""

import cv2
import numpy as np
import pytest
from recorded_shots import make_shot

from ringpose.capture.ambient import ambient_change, same_ambient_light

HEIGHT, WIDTH = 120, 160


def shot_of(light_dn, rng, lasers=(0, 0), full_dn=255, noise_dn=1.5):
    noisy = np.asarray(light_dn) + noise_dn * rng.standard_normal(np.shape(light_dn))
    images = np.clip(np.rint(noisy), 0, full_dn).astype(np.uint8 if full_dn < 256 else np.uint16)
    return make_shot(images, lasers, exposure_s=0.001, meta={"saturation_dn": full_dn})


@pytest.fixture
def surface_dn(rng):
    """A texture of 10 to 60 DN in squares of five pixels."""
    return np.kron(rng.uniform(10, 60, (HEIGHT // 5, WIDTH // 5)), np.ones((5, 5)))


@pytest.mark.parametrize("change_dn", [30.0, -30.0])
@pytest.mark.parametrize("share", [0.2, 1.0])
@pytest.mark.parametrize("full_dn", [255, 4095])
def test_a_lamp_is_recognised_with_its_size(surface_dn, rng, change_dn, share, full_dn):
    lit = (np.arange(HEIGHT) < share * HEIGHT)[:, None]
    scale = full_dn / 255
    first, second = scale * (surface_dn + 40.0), scale * (surface_dn + 40.0 + np.where(lit, change_dn, 0.0))

    change = ambient_change(shot_of([first, second], rng, full_dn=full_dn, noise_dn=scale * 1.5))

    assert change is not None
    assert change.size_dn == pytest.approx(scale * change_dn, rel=0.1)
    assert change.share_of_full == pytest.approx(abs(change_dn) / 255, rel=0.1)
    assert not change.only_with_lasers


def test_a_flash_between_two_equal_dark_frames_is_recognised(surface_dn, rng):
    shot = shot_of([surface_dn, surface_dn + 20.0, surface_dn], rng, lasers=(0, 1, 0))

    change = ambient_change(shot)

    assert change is not None
    assert change.size_dn == pytest.approx(20.0, rel=0.1)
    assert change.only_with_lasers
    same = [[True, False, True], [False, True, False], [True, False, True]]
    assert same_ambient_light(shot.images, 255).tolist() == same


@pytest.mark.parametrize("noise_dn", [0.3, 3.0, 20.0])
def test_noise_is_no_change_of_light(rng, noise_dn):
    light_dn = np.full((2, HEIGHT, WIDTH), 100.0)

    assert all(ambient_change(shot_of(light_dn, rng, noise_dn=noise_dn)) is None for _ in range(60))


@pytest.mark.slow
def test_noise_is_no_change_of_light_in_thousands_of_shots(rng):
    light_dn = np.full((3, HEIGHT, WIDTH), 100.0)
    lasers = (0, 1, 0)

    assert not any(ambient_change(shot_of(light_dn, rng, lasers, noise_dn=3.0)) for _ in range(3000))


@pytest.mark.parametrize("angle_rad", [0.0, 0.4, np.pi / 2])
def test_lines_of_any_number_of_lasers_are_no_change_of_light(surface_dn, rng, angle_rad):
    lines = np.zeros((HEIGHT, WIDTH))
    for offset in range(-80, 81, 20):
        x, y = WIDTH / 2 - offset * np.sin(angle_rad), HEIGHT / 2 + offset * np.cos(angle_rad)
        along = 200 * np.array([np.cos(angle_rad), np.sin(angle_rad)])
        ends = [(round(x + sign * along[0]), round(y + sign * along[1])) for sign in (-1, 1)]
        cv2.line(lines, ends[0], ends[1], 150.0, 3)

    assert ambient_change(shot_of([surface_dn, surface_dn + lines], rng)) is None
    assert ambient_change(shot_of([surface_dn, surface_dn + lines], rng, lasers=(0, 7))) is None


@pytest.mark.parametrize("shift_px", [1, 2, 5, 9])
def test_a_surface_that_moves_is_no_change_of_light(surface_dn, rng, shift_px):
    moved = np.roll(surface_dn, shift_px, axis=1)

    assert ambient_change(shot_of([surface_dn, moved], rng)) is None


def test_a_bright_body_that_moves_before_dark_space_is_no_change_of_light(rng):
    first, second = np.full((2, HEIGHT, WIDTH), 3.0)
    first[20:100, 40:120] = second[20:100, 49:129] = 90.0

    assert ambient_change(shot_of([first, second], rng)) is None


def test_without_a_dark_frame_or_in_a_tiny_image_nothing_can_be_said(surface_dn, rng):
    light_dn = [surface_dn, surface_dn + 50.0]

    assert ambient_change(shot_of(light_dn, rng, lasers=(1, 2))) is None
    assert ambient_change(shot_of(np.array(light_dn)[:, :95, :95], rng)) is None
