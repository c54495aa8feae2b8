"""Lines through stripe centres have consistent sigmas, also with few centres of correlated errors."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_scene import drawn_rig

from ringpose.detect.break_points import flagged_ends
from ringpose.detect.stripes import stripe_line_segments
from ringpose.types.detection import Stripes

RIG = drawn_rig()
RIG = replace(RIG, camera=replace(RIG.camera, distortion_coefficients=np.zeros(5)))


def grainy(rng, columns, grain_px):
    """Correlated errors of 0.1 px, and independent ones of 0.03 px."""
    alike = cv2.GaussianBlur(rng.normal(size=(1, columns + 200)), (0, 0), grain_px)[0, 100:-100]
    return 0.1 * alike * np.sqrt(2.0 * np.sqrt(np.pi) * grain_px) + 0.03 * rng.normal(size=columns)


def line_errors(rng, columns, grain_px):
    """Errors of one line's ends, in their standard deviations."""
    x = 700.0 + np.arange(columns)
    stripes = Stripes(
        position_px=np.column_stack([x, 600.0 + grainy(rng, columns, grain_px)]),
        sigma_px=np.full(columns, 0.1),
        peak_dn=np.full(columns, 100.0),
        piece=np.zeros(columns, dtype=np.int64),
        laser=np.zeros(1, dtype=np.int64),
    )
    segments = stripe_line_segments(stripes, RIG.camera)
    ends = flagged_ends(segments, np.full((1, 2, 10), np.nan), [0], RIG)
    return (ends.straight_px[0, :, 1] - 600.0) / ends.straight_sigma_px[0]


@pytest.mark.parametrize("columns", [29, 58, 120, 250])
@pytest.mark.parametrize("grain_px", [pytest.param(1.0, marks=pytest.mark.slow), 2.0])
def test_lines_are_as_sure_as_they_say(rng, columns, grain_px):
    errors = np.array([line_errors(rng, columns, grain_px) for _ in range(400)])

    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.1
