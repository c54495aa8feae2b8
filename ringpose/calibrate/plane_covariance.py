"""Joint covariance of camera and light planes, from the joint fit of boards and planes (ringpose-method(7), section 6).

Points of one view share the error of that board's pose, and all views share the camera's: a covariance from the
scatter of the points about the plane would be far too small. Where the views disagree by more than corners and stripes
explain (a bent board, an inexact print), the variances of these are widened to what they show.
"""

import numpy as np

from ringpose.calibrate.corner_likeness import likeliest_pose
from ringpose.calibrate.intrinsics import parameter_names
from ringpose.calibrate.plane_joint import (
    JointData,
    JointFit,
    corner_chi2,
    free_parameters,
    joint_fit,
    prior_information,
)
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.covariance import PLANE_PARAMETERS, ParameterCovariance, laser_parameters

SIGNIFICANCE = 3.0
"""Standard deviations by which the sum of squares must exceed its mean (chi-squared) to be more than chance."""


def planes_covariance(
    names: tuple[str, ...], fit: JointFit, given: Camera, excess: float, free_camera: bool
) -> ParameterCovariance:
    """Covariance of the camera's parameters (if the camera has one) and of each plane's two tilts and distance."""
    planes = laser_parameters(names)
    if given.covariance is None:
        count = len(planes)
        return ParameterCovariance(parameters=planes, data=excess * inverse_of_scaled(fit.information[:count, :count]))
    joint = _with_free_camera if free_camera else _with_given_camera
    data = joint(fit, given, excess, len(planes))
    return ParameterCovariance(parameters=parameter_names(given.distortion_model) + planes, data=(data + data.T) / 2)


def inverse_of_scaled(information: Float64[Array, "n n"]) -> Float64[Array, "n n"]:
    """Inverse of a normal matrix whose parameters have different units; zero for those that nothing depends on."""
    inverse = np.zeros_like(information)
    seen = np.flatnonzero(np.diag(information) > 0)
    scale = np.sqrt(np.diag(information)[seen])
    inner = information[np.ix_(seen, seen)] / np.outer(scale, scale)
    inverse[np.ix_(seen, seen)] = np.linalg.inv(inner) / np.outer(scale, scale)
    return inverse


def variance_excess(data: JointData, fit: JointFit) -> float:
    """Factor by which stripes tear at the boards more than chance has it; one where it is chance.

    What the squares grow by when stripes have to lie on common planes follows chi-squared: two numbers a stripe, less
    three for each plane.
    """
    camera = fit.state.camera
    boards = [(view, likeliest_pose(view.board, camera)[0]) for view in data.views]
    sigmas = data.corner_px.tolist()
    alone = sum(corner_chi2(*board, camera, sigma) for board, sigma in zip(boards, sigmas, strict=True))
    lasers = range(len(fit.state.distance_m))
    numbers = sum(_numbers(data, laser) for laser in lasers)
    grown = fit.chi2 - alone
    if numbers <= 0 or grown < numbers + SIGNIFICANCE * np.sqrt(2 * numbers):
        return 1.0
    return grown / numbers


def laser_disagreements(data: JointData, fit: JointFit) -> tuple[float, ...]:
    """For each laser: what the squares lose without its stripes, over the numbers that it gives; NaN if it gives none.

    One laser whose plane disagrees with the boards that the others agree with stands out.
    """
    found = []
    for laser in range(len(fit.state.distance_m)):
        numbers = _numbers(data, laser)
        others = joint_fit(data.without_laser(laser), fit.state)
        found.append((fit.chi2 - others.chi2) / numbers if numbers > 0 else float("nan"))
    return tuple(found)


def _numbers(data: JointData, laser: int) -> int:
    """Numbers that a laser's stripes give beyond those that its plane takes."""
    return 2 * sum(len(own[laser]) > 0 for own in data.rays) - len(PLANE_PARAMETERS)


def _with_given_camera(fit: JointFit, given: Camera, excess: float, planes: int) -> Float64[Array, "n n"]:
    """The planes follow a camera that was wrong: their own errors, and those they have from it."""
    assert given.covariance is not None
    own = inverse_of_scaled(fit.information[:planes, :planes])
    by_camera = -own @ fit.information[:planes, planes:]
    cross = given.covariance.data @ by_camera.T
    return np.block([[given.covariance.data, cross], [cross.T, excess * own + by_camera @ cross]])


def _with_free_camera(fit: JointFit, given: Camera, excess: float, planes: int) -> Float64[Array, "n n"]:
    """Both as they come out of the fit with the camera's prior, in the order camera, planes."""
    information = fit.information / excess
    free = np.append(np.ones(planes, dtype=bool), free_parameters(given))
    prior = np.zeros_like(information)
    prior[planes:, planes:] = prior_information(given)
    information = np.where(np.outer(free, free), information + prior, 0.0)
    covariance = inverse_of_scaled(information)
    camera_first = np.roll(np.arange(len(covariance)), len(covariance) - planes)
    return covariance[np.ix_(camera_first, camera_first)]
