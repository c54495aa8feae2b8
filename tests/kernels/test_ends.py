"""Ends of stripes: the kernel finds the ends that were drawn, and its sigmas are those of the errors."""

import math
from dataclasses import astuple, replace

import cv2
import numpy as np
import pytest

from ringpose.detect.break_points import EndParams, LitLines, stripe_ends
from ringpose.detect.stripes import DISTORTION
from ringpose.kernels.lines import Lens

RULES = EndParams(saturation_dn=255)
STRAIGHT = Lens(fx=900.0, fy=900.0, cx=160.0, cy=60.0, **dict.fromkeys(DISTORTION, 0.0))
BENT = replace(STRAIGHT, fx=300.0, fy=300.0, k1=-0.1, k2=0.02, p1=0.001, p2=-0.001)
SIGMA = 3
LINE = np.array([[150.0, 60.31, 0.02, 100.0, 200.0]])


def drawn(start, end, *, peak=150.0, sigma=1.6, blur=1.0, ambient=10.0):
    """A stripe on LINE between two ends, as grey values (120 x 320)."""
    x, rows = np.arange(320.0), np.arange(120.0)[:, None]
    y = 60.31 + 0.02 * (x - 150)
    fade = [0.25 * math.erfc((start - k) / blur / math.sqrt(2)) * math.erfc((k - end) / blur / math.sqrt(2)) for k in x]
    return ambient + peak * np.array(fade) * np.exp(-0.5 * ((rows - y) / sigma) ** 2)


def image(values, rng=None, noise=0.0, dtype=np.uint8):
    noisy = values if rng is None else values + rng.normal(0, noise, values.shape)
    return np.clip(np.rint(noisy), 0, 255 if dtype is np.uint8 else 65535).astype(dtype)


@pytest.mark.parametrize("shift", [0.0, 0.25, 0.5, 0.75])
@pytest.mark.parametrize("blur", [0.8, 1.0, 1.3])
def test_a_drawn_end_is_found_without_bias(shift, blur):
    lit = image(drawn(100 + shift, 200 - shift, blur=blur))

    left, right = stripe_ends([LitLines(lit, None, LINE)], STRAIGHT, RULES)[0, :, 0]

    assert left == pytest.approx(100 + shift, abs=0.03)
    assert right == pytest.approx(200 - shift, abs=0.03)


@pytest.mark.parametrize(("peak", "ambient"), [(150.0, 10.0), (60.0, 150.0), (30.0, 40.0)])
def test_ends_before_a_dark_frame_are_found_as_well_as_their_sigmas_say(rng, peak, ambient):
    facets = np.kron(rng.uniform(0, ambient, (60, 80)), np.ones((2, 4)))
    lit = image(drawn(100.3, 199.6, peak=peak, ambient=0.0) + facets, rng, 1.5)
    dark = image(facets, rng, 1.5)

    found = stripe_ends([LitLines(lit, dark, LINE)], STRAIGHT, RULES)[0]

    assert np.all(np.abs(found[:, 0] - [100.3, 199.6]) < 4 * found[:, SIGMA])
    assert np.all(found[:, SIGMA] < 0.5)


def test_ends_of_a_stripe_that_the_lens_bends_lie_on_the_bent_line(rng):
    straight = np.stack([np.linspace(10, 310, 900), np.full(900, 20.0)], axis=-1)
    rays = np.column_stack([(straight - [BENT.cx, BENT.cy]) / [BENT.fx, BENT.fy], np.ones(900)])
    matrix = np.array([[BENT.fx, 0, BENT.cx], [0, BENT.fy, BENT.cy], [0, 0, 1]])
    bent = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(astuple(BENT)[4:9]))[0].reshape(-1, 2)
    y = np.interp(np.arange(320.0), *bent.T)
    along = 150 * np.array([0.25 * math.erfc((100.3 - k) / 1.4) * math.erfc((k - 199.6) / 1.4) for k in range(320)])
    lit = image(10 + along * np.exp(-0.5 * ((np.arange(120.0)[:, None] - y) / 1.6) ** 2), rng, 1.5)

    found = stripe_ends([LitLines(lit, None, np.array([[150.0, 20.0, 0.0, 101.0, 199.0]]))], BENT, RULES)[0]

    assert found[:, 0] == pytest.approx([100.3, 199.6], abs=0.15)
    assert found[:, 1] == pytest.approx(np.interp([100.3, 199.6], *bent.T), abs=0.01)
    assert found[:, 2] == pytest.approx(np.interp([100.3, 199.6], np.arange(320), np.gradient(y)), abs=1e-3)


def test_a_level_beyond_the_end_is_reported_as_a_share_of_that_inside():
    lit = image(drawn(100.3, 199.6) + drawn(20.0, 300.0, peak=45.0, ambient=0.0))

    found = stripe_ends([LitLines(lit, None, LINE)], STRAIGHT, RULES)[0]

    assert found[:, 4] == pytest.approx(45.0 / 195.0, abs=0.02)
    assert found[:, 0] == pytest.approx([100.3, 199.6], abs=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_ends_on_noise_stay_in_the_image_or_are_none(seed):
    rng = np.random.default_rng(seed)
    lit = rng.integers(0, 256, (120, 320)).astype(np.uint8)
    line = np.array([[rng.uniform(20, 300), rng.uniform(-5, 125), rng.uniform(-0.3, 0.3), 60.0, rng.uniform(62, 310)]])

    found = stripe_ends([LitLines(lit, None, line)], BENT, RULES)[0]

    seen = found[np.isfinite(found[:, 0])]
    assert ((seen[:, 0] > -1) & (seen[:, 0] < 320) & (seen[:, SIGMA] > 0)).all()


def test_scatter_is_the_reported_sigma(rng):
    errors = []
    for _ in range(60):
        found = stripe_ends([LitLines(image(drawn(100.3, 199.6), rng, 6.0), None, LINE)], STRAIGHT, RULES)[0]
        errors += [(found[0, 0] - 100.3) / found[0, 3], (found[1, 0] - 199.6) / found[1, 3]]

    assert 0.5 < np.mean(np.square(errors)) < 1.6


@pytest.mark.parametrize("peak", [400.0, 600.0])
def test_saturation_does_not_move_an_end_outward(peak):
    found = stripe_ends([LitLines(image(drawn(100.0, 200.0, peak=peak)), None, LINE)], STRAIGHT, RULES)[0]

    assert found[0, 0] == pytest.approx(100.0, abs=0.2)
    assert found[1, 0] == pytest.approx(200.0, abs=0.2)
    assert np.all(found[:, 5] > 0.5)


def test_sixteen_bits_are_read():
    lit = image(drawn(100.0, 200.0, peak=3000.0, ambient=100.0), dtype=np.uint16)

    found = stripe_ends([LitLines(lit, None, LINE)], STRAIGHT, replace(RULES, saturation_dn=4095))[0]

    assert found[:, 0] == pytest.approx([100.0, 200.0], abs=0.03)


@pytest.mark.parametrize("rows", [5, 6])
def test_stripes_on_a_body_a_few_rows_beside_the_ends_do_not_displace_them(rng, rows):
    """Without a frame that shows the background, the rows beside the stripe give its level."""
    bright = {"peak": 400.0 + 400.0 * (rows == 5), "sigma": 1.2, "ambient": 0.0}
    body = np.roll(drawn(-50.0, 100.0, **bright) + drawn(200.0, 400.0, **bright), rows, axis=0)
    speckle = np.kron(rng.normal(1.0, 0.1, 160), np.ones(2))
    lit = image(drawn(100.3, 199.6, sigma=1.0, ambient=0.0) * speckle + body, rng, 1.5)

    found = stripe_ends([LitLines(lit, None, LINE)], STRAIGHT, RULES)[0]

    assert found[:, 0] == pytest.approx([100.3, 199.6], abs=0.5)
    assert np.all(found[:, SIGMA] < 0.3)


def test_ends_are_the_same_whether_one_frame_shows_both_stripes_or_each_of_two_frames_has_one(rng):
    lower = np.add(LINE, [0.0, 30.0, 0.0, 0.0, 0.0])
    blurred = np.roll(drawn(110.2, 190.7, blur=1.4, ambient=0.0), 30, axis=0)
    lit = image(drawn(100.3, 199.6) + blurred, rng, 3.0)

    both = stripe_ends([LitLines(lit, None, np.concatenate([LINE, lower]))], STRAIGHT, RULES)
    split = stripe_ends([LitLines(lit, None, LINE), LitLines(lit, None, lower)], STRAIGHT, RULES)
    alone = stripe_ends([LitLines(lit, None, LINE)], STRAIGHT, RULES)

    assert np.isfinite(both).all()
    np.testing.assert_array_equal(split, both)
    assert (split[0, :, SIGMA] != alone[0, :, SIGMA]).all()  # noise and blur are those of both stripes


def test_a_line_outside_the_image_has_no_end():
    far = np.array([[5000.0, 60.0, 0.0, 4950.0, 5050.0]])

    assert np.all(np.isnan(stripe_ends([LitLines(image(drawn(100, 200)), None, far)], STRAIGHT, RULES)[..., 0]))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_wild_lines_have_no_end(value):
    wild = np.array([[150.0, value, 0.0, 100.0, 200.0], [150.0, 60.0, 0.0, 100.0, value]])

    assert stripe_ends([LitLines(image(drawn(100, 200)), None, wild)], STRAIGHT, RULES).shape == (2, 2, 10)


@pytest.mark.parametrize(("blur", "blunt"), [(0.6, 0.0), (1.2, 0.0), (3.0, 1.0)])
def test_an_end_that_fades_over_more_than_the_stripe_is_thick_is_blunt(rng, blur, blunt):
    lit = image(drawn(100.3, 199.6, blur=blur), rng, 1.5)

    found = stripe_ends([LitLines(lit, None, LINE)], STRAIGHT, RULES)

    np.testing.assert_array_equal(found[0, :, 8], [blunt, blunt])
    assert np.all(found[0, :, SIGMA] > 2.0 * blunt)  # a blunt end is known no better than it is wide


@pytest.mark.parametrize("sigma", [1.0, 1.6, 2.4, 3.2])
@pytest.mark.parametrize("peak", [40.0, 150.0, 450.0])
def test_the_width_of_the_section_is_found_under_noise_and_saturation(rng, sigma, peak):
    lit = image(drawn(100.0, 200.0, peak=peak, sigma=sigma), rng, 1.5)

    found = stripe_ends([LitLines(lit, None, LINE)], STRAIGHT, RULES)

    np.testing.assert_allclose(found[0, :, 7], sigma, rtol=0.06)


def test_a_step_of_the_light_beneath_moves_an_end_by_no_more_than_its_sigmas(rng):
    background = np.where(np.arange(320.0) + 0.4 * np.arange(120.0)[:, None] > 225.0, 60.0, 20.0)
    lit = image(drawn(100.3, 199.6, ambient=0.0) + background, rng, 1.5)

    found = stripe_ends([LitLines(lit, None, LINE)], STRAIGHT, RULES)

    assert abs(found[0, 1, 0] - 199.6) < 3 * found[0, 1, 3]
    assert found[0, 1, 3] < 1.0


FARTHER = 7.0
"""Columns by which half of the stripe goes on."""


def two_ends(rng):
    """A stripe of which half ends at 199.6 and half `FARTHER` columns on, and facets beneath both ends."""
    near, far = drawn(100.3, 199.6, ambient=0.0, peak=75.0), drawn(100.3, 199.6 + FARTHER, ambient=0.0, peak=75.0)
    facets = np.kron(rng.normal(0, 45.0, (60, 80)), np.ones((2, 4)))
    return image(near + far + 40 + facets * (np.arange(320) > 197), rng, 1.5)


def test_where_an_end_may_as_well_lie_elsewhere_both_places_are_within_three_sigmas(rng):
    found = np.array([stripe_ends([LitLines(two_ends(rng), None, LINE)], STRAIGHT, RULES)[0, 1] for _ in range(100)])

    off = np.abs(found[:, :1] - [199.6, 199.6 + FARTHER]) / found[:, [SIGMA]]
    assert np.mean(off.max(axis=1) < 3) > 0.55


def test_ends_where_all_is_saturated_have_a_sigma_that_says_so():
    lit = image(drawn(100.3, 199.6, ambient=40.0))

    found = stripe_ends([LitLines(lit, None, LINE)], STRAIGHT, replace(RULES, saturation_dn=30))[0]

    assert np.all(np.isfinite(found[:, 0]))
    assert np.all(found[:, SIGMA] > 3.0)
