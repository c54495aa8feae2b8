"""Accumulation of shots for the light planes: checks of methods and options."""

from dataclasses import replace

import pytest
from drawn_boards import FOUR
from known_views import TRUE_CAMERA, stripe_views, true_poses

from ringpose.calibrate.planes.shots import StripeShots, check_method
from ringpose.errors import UsageError
from ringpose.types.options import PlanesMethod


@pytest.fixture
def shots(rng):
    """Three shots of three lasers."""
    found = StripeShots(FOUR, TRUE_CAMERA, "left,middle,right", None)
    found.names = ("left", "middle", "right")
    found.views = stripe_views(true_poses(rng, 3), rng, 0.02, 0.05)
    return found


@pytest.mark.parametrize(
    ("method", "finding"),
    [(PlanesMethod.JOINT, "no covariance"), (PlanesMethod.TOTAL_LEAST_SQUARES, "only the joint method")],
)
def test_a_camera_without_covariance_or_joint_method_cannot_be_free(method, finding):
    with pytest.raises(UsageError, match=finding):
        check_method(method, True, FOUR, replace(TRUE_CAMERA, covariance=None))


def test_the_assessment_compares_other_methods_with_the_papers(shots):
    assessment = shots.assessment(PlanesMethod.TOTAL_LEAST_SQUARES)

    assert assessment.paper is not None
    assert assessment.paper.method == "paper"
    assert shots.assessment(PlanesMethod.PAPER).paper is None
