"""Unions of tracks: the line and scatter of all centres together, and which tracks are tried."""

import numpy as np
import pytest

from ringpose.detect.collinear import collinear_tracks, union
from ringpose.detect.tracks import Track


def track_of(x, y, spilt=20, laser=-1, clipped=False):
    """The track that least squares make of centres."""
    slope, _ = np.polyfit(x, y, 1)
    residual = y - y.mean() - slope * (x - x.mean())
    return Track(
        laser=laser,
        count=len(x),
        x_start=float(x[0]),
        x_end=float(x[-1]),
        middle_x=float(x.mean()),
        middle_y=float(y.mean()),
        slope=float(slope),
        scatter=float(residual.std()),
        correlation=1.0,
        clipped=clipped,
        spilt=spilt,
    )


def halves(rng, step_px=0.0, **of_second):
    """Two tracks on one line, the second off it by a step; and the centres of both."""
    x = np.concatenate([np.arange(100.0, 140.0), np.arange(150.0, 200.0)])
    y = 300.0 + 0.05 * x + rng.normal(0, 0.3, len(x)) + step_px * (x >= 150)
    return track_of(x[:40], y[:40]), track_of(x[40:], y[40:], **of_second), x, y


def test_a_union_is_the_line_through_all_centres(rng):
    first, second, x, y = halves(rng)

    both, expected = union(first, second), track_of(x, y)

    assert both.y(150.0) == pytest.approx(expected.y(150.0), abs=0.01)
    assert both.slope == pytest.approx(expected.slope, abs=3e-4)
    assert both.scatter == pytest.approx(expected.scatter, rel=0.05)


def test_pieces_of_one_line_are_tried_as_one(rng):
    first, second, _, _ = halves(rng)

    (both,) = collinear_tracks([second, first])

    assert (both.x_start, both.x_end, both.count) == (100.0, 199.0, 90)


@pytest.mark.parametrize(
    "of_second",
    [{"step_px": 3.0}, {"spilt": 0}, {"laser": 1}, {"clipped": True}],
    ids=["off", "whole", "other", "clipped"],
)
def test_what_cannot_be_one_stripe_is_not_joined(rng, of_second):
    first, second, _, _ = halves(rng, **of_second)

    assert collinear_tracks([first, second]) == []
