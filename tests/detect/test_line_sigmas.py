"""Standard deviation of a stripe's line with correlated errors of the columns: clipped, or on facets of foil."""

import numpy as np
import pytest
from benchmarks.detection_errors import break_point_errors, joined
from benchmarks.stripe_images import Kind, shot_of, stripe_image

from ringpose.detect.pipeline import detect


@pytest.mark.slow
def test_lines_through_clipped_stripes_have_consistent_sigmas() -> None:
    images = [stripe_image(Kind.SATURATED, seed) for seed in range(100, 125)]

    errors = joined([break_point_errors(detect(shot_of(image), image.rig, edges=False), image) for image in images])

    assert 0.7 < np.mean((errors.across_px / errors.across_sigma_px) ** 2) < 1.3


def test_a_line_through_a_clipped_stripe_is_known_no_better_than_the_phase_of_the_pixels() -> None:
    image = stripe_image(Kind.SATURATED, 49)

    errors = break_point_errors(detect(shot_of(image), image.rig, edges=False), image)

    assert errors.across_sigma_px.min() > 0.02 / image.stripe_sigma_px


def test_facets_beneath_a_stripe_make_its_line_less_certain_than_its_centres_scatter() -> None:
    image = stripe_image(Kind.FOIL, 9)
    dark = stripe_image(Kind.DARK, 9)

    errors, clear = (break_point_errors(detect(shot_of(each), each.rig, edges=False), each) for each in (image, dark))

    assert errors.across_sigma_px.max() > 10 * clear.across_sigma_px.max()
