"""Two arcs about one centre, through points with a known answer."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.pose.closed_form import arc_crossings, arc_equations

ARC = np.array([0, 1, 0, 1, 0, 1])


def two_arcs(radius, band, heights):
    """Points at these heights of two arcs about one centre to the right, the second one `band` farther from it."""
    radii = radius + band * np.array([0.0, 1.0])
    return np.stack([[radius - np.sqrt(r * r - h * h), h] for h in heights for r in radii])


@given(radius=st.floats(0.3, 5.0), band=st.floats(0.01, 0.05), spacing=st.floats(0.01, 0.2))
def test_arcs_cross_the_radius_through_the_mean_at_their_radii(radius, band, spacing):
    points = two_arcs(radius, band, [-spacing, 0.1 * spacing, spacing])
    center, mean = np.array([radius, 0.0]), points.mean(axis=0)

    crossings = arc_crossings(arc_equations(points, ARC))

    # positive x is towards the centre
    expected = np.linalg.norm(mean - center) - radius - np.array([0.0, band])
    np.testing.assert_allclose(crossings, expected, rtol=0, atol=1e-9)


@given(lean=st.floats(-0.5, 0.5))
def test_straight_arcs_have_no_curvature(lean):
    points = np.array([[x + lean * y, y] for y in (-0.1, 0.0, 0.1) for x in (0.0, 0.03)])

    assert float(arc_equations(points, ARC).bend[0]) == pytest.approx(0.0, abs=1e-9)
