"""Priors of the nuisance parameters by their names."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import RIGS
from whole_records import measurement_with

from ringpose.errors import DataError
from ringpose.track.common_errors import common_errors
from ringpose.types.assumptions import Assumptions, RigStability
from ringpose.types.pose import PoseLine, Priors
from ringpose.types.rig import LaserBow, ParameterCovariance, PlaneCorrection

STABILITY = RigStability(plane_tilt_rad=1e-4, plane_distance_m=2e-5, focal_ratio=1e-4)
CALIBRATED = ("fx", "fy", "left.tilt_1", "left.distance")
CALIBRATION = np.array([[0.25, 0.2, 0, 0], [0.2, 0.36, 0, 0], [0, 0, 4e-8, 1e-9], [0, 0, 1e-9, 1e-10]])


def covariance_of(
    names, rig=None, rig_covariance=False, moved_planes=None, bent_planes=None, camera_motion="none", **assumed
) -> np.ndarray:
    """Prior covariance of the nuisance parameters of a record with these priors."""
    measurement = measurement_with(names, np.zeros((1, 13 + len(names))), camera_motion=camera_motion)
    assumptions = Assumptions(**assumed)
    planes = {"moved_planes": moved_planes or {}, "bent_planes": bent_planes or {}}
    priors = Priors(assumptions=assumptions, rig_covariance=rig_covariance, **planes)
    line = PoseLine(shot="a", stamp_s=0.0, pose=None, priors=priors)
    root = common_errors(line, measurement, rig).root
    return root @ root.T


def calibrated():
    return replace(RIGS["B"], covariance=ParameterCovariance(parameters=CALIBRATED, data=CALIBRATION))


def test_stability_is_added_to_the_covariance_of_the_calibration_in_the_order_of_the_record():
    names = (*CALIBRATED[::-1], "left.tilt_2", "focal_ratio")

    found = covariance_of(names, calibrated(), rig_covariance=True, stability=STABILITY)

    expected = np.diag([4e-10, 1e-8, 0.0, 0.0, 1e-8, 1e-8])
    expected[:4, :4] += CALIBRATION[::-1, ::-1]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-18)


def test_the_covariance_of_a_corrected_plane_replaces_calibration_and_stability():
    names, moved = ("left.tilt_1", "left.tilt_2", "left.distance", "right.tilt_1"), np.diag([1e-9, 4e-9, 1e-11])
    correction = PlaneCorrection(change=np.zeros(3), covariance=moved)

    found = covariance_of(names, stability=STABILITY, moved_planes={"left": correction})

    expected = np.diag([1e-9, 4e-9, 1e-11, 1e-8])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-20)


def test_a_bow_that_the_calibration_leaves_out_has_the_standard_deviation_of_the_record():
    found = covariance_of(
        ("left.bow", "left.tilt_1"), stability=STABILITY, bent_planes={"left": LaserBow(per_rad=0.01, sd_per_rad=3e-4)}
    )

    np.testing.assert_allclose(found, np.diag([9e-8, 1e-8]), rtol=1e-9, atol=1e-20)


def test_coefficients_of_the_rings_form_share_the_variance_of_its_tolerance():
    found = covariance_of(("form.inner.a2", "form.axial.b4"), ring_tolerance_m=3e-4)

    np.testing.assert_allclose(found, 3e-8 * np.eye(2), atol=1e-20)


@pytest.mark.parametrize(
    ("names", "priors", "word"),
    [
        (("fx",), {"stability": STABILITY}, "fx"),
        (CALIBRATED, {"rig_covariance": True}, "--rig"),
        ((), {"camera_motion": "robot_poses"}, "--robot-poses"),
    ],
    ids=["no prior", "no rig file", "no robot poses"],
)
def test_a_parameter_without_a_prior_is_an_error(names, priors, word):
    with pytest.raises(DataError, match=word):
        covariance_of(names, **priors)
