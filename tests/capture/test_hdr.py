"""Merging of exposure brackets, for synthetic images with known light and noise."""

import numpy as np
import pytest
from recorded_shots import make_shot

from ringpose.capture.hdr import exposure_groups, merged_brackets, scaled_like
from ringpose.detect.stripes import find_stripes

BLACK_DN, DARK_DN, GAIN = 5.0, 1.2, 0.04

FULL = {8: 255, 12: 4095}


def exposed(rate, exposure_s, rng, bits=8):
    """An exposure by the EMVA 1288 model; `rate` in grey values per second."""
    electrons = rng.poisson(rate * exposure_s / GAIN)
    grey = BLACK_DN + GAIN * electrons + rng.normal(0, DARK_DN, rate.shape)
    return np.clip(np.rint(grey), 0, FULL[bits]).astype(np.uint8 if bits == 8 else np.uint16)


def bracketed(rate, exposures_s, rng, lasers=None, bits=8):
    images = np.stack([exposed(rate, exposure_s, rng, bits) for exposure_s in exposures_s])
    masks, meta = lasers or [1] * len(images), {"saturation_dn": FULL[bits]}
    return make_shot(images, masks, start_s=100.0, exposure_s=exposures_s, meta=meta)


@pytest.fixture
def ramp():
    """Rates from dark to five times the saturation of an exposure of 8 ms."""
    return np.tile(np.geomspace(20.0, 150_000.0, 600), (200, 1))


def truth_of(shot, rate):
    merged = shot.meta["merged"]
    return merged["pedestal_dn"] + rate * merged["scale_s"]


@pytest.mark.parametrize("bits", [8, 12])
def test_a_merged_frame_has_the_true_grey_values_from_dark_to_full_in_all(rng, ramp, bits):
    shot = merged_brackets(bracketed(ramp * FULL[bits] / 255, [0.001, 0.008], rng, bits=bits))

    truth = truth_of(shot, ramp * FULL[bits] / 255)[0]
    unclipped = truth < 0.9 * shot.saturation_dn
    mean = shot.images[0].mean(axis=0)
    standard_error = shot.images[0].std(axis=0) / np.sqrt(200)
    assert np.abs((mean - truth)[unclipped] / standard_error[unclipped]).mean() < 1.2
    assert np.all(np.abs((mean / truth - 1)[unclipped & (truth > 100)]) < 0.02)
    assert np.all(shot.images[0][:, truth > 1.2 * shot.saturation_dn] == shot.saturation_dn)


def test_the_noise_of_a_merged_frame_is_that_of_the_best_weighted_mean(rng, ramp):
    shot = merged_brackets(bracketed(ramp, [0.001, 0.008], rng))

    merged = shot.meta["merged"]
    variance = np.array([(DARK_DN**2 + 1 / 12 + GAIN * ramp[0] * t) / t**2 for t in (0.001, 0.008)])
    full = BLACK_DN + ramp[0] * 0.008 > 240.0
    best = np.where(full, variance[0], 1 / (1 / variance).sum(axis=0)) * merged["scale_s"] ** 2 + 1 / 12
    clear = (np.abs(BLACK_DN + ramp[0] * 0.008 - 250) > 30) & (truth_of(shot, ramp[0]) < 0.85 * shot.saturation_dn)
    ratio = shot.images[0].astype(float).var(axis=0)[clear] / best[clear]
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)


def test_the_black_level_is_read_from_the_brackets_themselves(rng, ramp):
    merged = merged_brackets(bracketed(ramp, [0.001, 0.008], rng)).meta["merged"]

    assert merged["black_dn"] == pytest.approx(BLACK_DN, abs=0.1)


def test_a_merged_stripe_keeps_its_shape_where_single_exposures_are_full_or_dark(rng):
    rows = np.arange(60.0)[:, None]
    peak = np.geomspace(2_000.0, 150_000.0, 300)[None, :]
    rate = 1_000.0 + peak * np.exp(-(((rows - 30.3) / 2.0) ** 2) / 2)
    shot = merged_brackets(bracketed(rate, [0.001, 0.008], rng))

    signal = shot.images[0] - np.median(shot.images[0], axis=0)
    inside = slice(24, 37)
    centre = (signal[inside] * rows[inside]).sum(axis=0) / signal[inside].sum(axis=0)
    assert np.abs(centre[peak[0] > 20_000].mean() - 30.3) < 0.02


def test_all_frames_of_a_shot_come_onto_one_scale(rng, ramp):
    shot = merged_brackets(bracketed(ramp, [0.004, 0.001, 0.008, 0.004], rng, lasers=[0, 1, 1, 0]))

    dim = slice(0, 250)
    means = shot.images[:, :, dim].mean(axis=(1, 2))
    assert shot.lasers.tolist() == [0, 1, 0]
    assert np.ptp(means) < 0.02 * means[1]
    assert shot.exposure_s.tolist() == [0.004, 0.008, 0.004]


def test_shots_of_one_exposure_stay_as_they_are(rng, ramp):
    shot = bracketed(ramp, [0.004, 0.004], rng, lasers=[0, 1])

    assert merged_brackets(shot) is shot


def test_a_later_frame_is_brought_onto_the_scale(rng, ramp):
    shot = merged_brackets(bracketed(ramp, [0.001, 0.008], rng))

    scaled = scaled_like(exposed(ramp, 0.004, rng), 0.004, shot)

    assert np.abs(scaled[:, :250].mean() / shot.images[0][:, :250].mean() - 1) < 0.02


@pytest.mark.parametrize(
    ("masks", "exposures_s", "groups"),
    [
        ([0, 1, 1, 2, 0], [5.0, 1.0, 4.0, 5.0, 5.0], ((0,), (1, 2), (3,), (4,))),
        ([1, 1, 1], [1.0, 2.0, 1.0], ((0, 1), (2,))),
        ([0, 0], [1.0, 1.0], ((0,), (1,))),
    ],
)
def test_consecutive_frames_of_the_same_lasers_form_a_group(masks, exposures_s, groups):
    assert exposure_groups(masks, exposures_s) == groups


def test_a_stripe_that_only_the_longest_exposure_shows_is_found_beside_one_that_only_the_shortest_does(rng):
    rows = np.arange(120.0)[:, None]
    rate = 500.0 + sum(
        peak * np.exp(-(((rows - row) / 1.8) ** 2) / 2) for peak, row in ((1_200.0, 30.2), (2_000_000.0, 80.4))
    )
    rate = np.broadcast_to(rate, (120, 400))
    shot = merged_brackets(bracketed(rate, [0.0001, 0.001, 0.008], rng))

    stripes = find_stripes(shot.images[0], saturation_dn=shot.usual_full_dn)

    found = [float(np.median(stripes.position_px[stripes.piece == piece, 1])) for piece in set(stripes.piece.tolist())]
    assert sorted(found) == pytest.approx([30.2, 80.4], abs=0.1)
