"""The table of plausible ranges: what it holds, and the likely causes that it names."""

import re
from pathlib import Path

import pytest

from ringpose.types import plausible
from ringpose.types.plausible import RANGES

PAGE = Path(__file__).parents[2] / "man" / "ringpose-conventions.7"


@pytest.mark.parametrize(
    ("range_", "value", "remedy"),
    [
        (plausible.RING_RADIUS_M, 597, "give metres: 0.597 if it is in millimetres"),
        (
            plausible.RING_RADIUS_M,
            59.7,
            "give metres: 0.0597 if it is in millimetres, 0.597 if it is in centimetres",
        ),
        (plausible.PLANE_DISTANCE_M, -39.5, "-0.0395 if it is in millimetres, -0.395 if it is in centimetres"),
        (plausible.LASER_POWER_W, 20, "give watts: 0.02 if it is in milliwatts"),
        (plausible.EXPOSURE_S, 5000, "give seconds: 5 if it is in milliseconds, 0.005 if it is in microseconds"),
        (plausible.LASER_ANGLE_RAD, 10, "give radians: 0.1745 if it is in degrees"),
        (plausible.WAVELENGTH_M, 650, "give metres: 6.5e-07 if it is in nanometres"),
        (plausible.RING_HEIGHT_M, 4.9, "give metres: 0.0049 if it is in millimetres, 0.049 if it is in centimetres"),
    ],
)
def test_remedy_names_the_value_in_each_unit_in_which_it_is_plausible(range_, value, remedy):
    found, given = range_.finding(value)

    assert found == f"is {value:g}, must be {range_.bounds}"
    assert remedy in given


@pytest.mark.parametrize(
    ("range_", "planned"),
    [
        (plausible.RING_RADIUS_M, (0.02, 5.0)),
        (plausible.FACE_WIDTH_M, (0.002, 0.3)),
        (plausible.DISTANCE_M, (0.05, 20.0)),
        (plausible.SQUARE_M, (0.001, 1.0)),
        (plausible.EXPOSURE_S, (1e-6, 60.0)),
        (plausible.LASER_POWER_W, (0.0, 1.0)),
    ],
)
def test_ranges_hold_what_is_built_and_planned(range_, planned):
    assert all(map(range_.holds, planned))
    assert not range_.holds(float("nan"))


def test_manual_lists_all_ranges():
    listed = re.findall(r"^\.It (\S+ to \S+) Ta (.+)$", PAGE.read_text(), re.MULTILINE)
    units = [each.unit.partition(",")[0] for each in RANGES]

    texts = [f"{each.quantity}: {unit}" if unit else each.quantity for each, unit in zip(RANGES, units, strict=True)]
    assert listed == [(each.bounds, text) for each, text in zip(RANGES, texts, strict=True)]
