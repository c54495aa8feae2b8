"""Without noise the poses are exact, at random poses."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ring_scenes import make_scene

from ringpose.pose.closed_form import FORMS, SINGULAR_BELOW
from ringpose.pose.closed_form import closed_form_pose as estimate_pose

POSES = st.fixed_dictionaries(
    {
        "distance_m": st.floats(0.2, 1.0),
        "across": st.floats(-0.2, 0.2),
        "tilt_rad": st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
        "turn_rad": st.floats(-0.3, 0.3),
        "side": st.sampled_from([-1, 1]),
        "size": st.sampled_from(["R597", "R1194"]),
    }
)


BOTH_RIGS = pytest.mark.parametrize("rig", ["A", "B"])
BOTH_METHODS = pytest.mark.parametrize("method", list(FORMS))


def exact_tolerance_m(pose):
    """Rounding, raised by the square of the condition: the arc's height is a difference of squares."""
    return (1e-10 if pose.method == "paper" else 1e-12) + 3e-16 * pose.condition_number**2


def is_undamped(pose):
    return pose.condition_number * SINGULAR_BELOW < 1.0


@BOTH_RIGS
@BOTH_METHODS
@given(where=POSES)
def test_true_points_give_the_true_ring_and_at_least_its_normal_if_damped(rig, method, where):
    scene = make_scene(rig, **where)

    pose = estimate_pose(scene.break_points(), scene.rig, method)

    np.testing.assert_allclose(pose.normal, scene.ring.normal, rtol=0, atol=1e-12)
    assume(is_undamped(pose))
    tolerance_m = exact_tolerance_m(pose)
    np.testing.assert_allclose(pose.center_m, scene.ring.center_m, rtol=0, atol=tolerance_m)
    radii = [pose.radius_inner_m, pose.radius_outer_m]
    np.testing.assert_allclose(radii, scene.ring.radius_m, rtol=0, atol=tolerance_m)
    assert pose.residual_rms_px < 1e-9
