"""How many shots of a data set show how many stripes."""

import numpy as np

from ringpose.report.stripes import stripes_shown
from ringpose.types.truth import Truth


def truth(*seen) -> Truth:
    """A truth of which these lasers show both ends, or, with 1, one of them."""
    points_px = np.full((len(seen), 2, 2), np.nan)
    for laser, ends in enumerate(seen):
        points_px[laser, :ends] = 100.0
    return Truth(
        shot="a",
        center_m=np.array([0.0, 0.0, 0.5]),
        normal=np.array([0.0, 0.0, -1.0]),
        radius_inner_m=0.5,
        radius_outer_m=0.6,
        break_points_px=points_px,
        expect="pose",
        groups={},
    )


def test_shots_are_counted_by_number_and_by_laser():
    line = stripes_shown([truth(2, 2, 2), truth(2, 1, 2), truth(0, 2, 2), truth(0, 0, 0)], ["left", "middle"])

    assert line.endswith("of 4 shots with a ring: 3 in 1, 2 in 2, 0 in 1; left in 2, middle in 2, laser 3 in 3")


def test_a_truth_without_break_points_counts_nothing():
    assert stripes_shown([]) == ""
