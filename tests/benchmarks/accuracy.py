"""Accuracy of stripe centres, break points and poses on synthetic images, relative to their Cramer-Rao bounds."""

import math
from dataclasses import replace

import numpy as np
from benchmarks.detection_errors import (
    WRONG_PX,
    BreakPointErrors,
    CenterErrors,
    break_point_errors,
    center_errors,
    joined,
    mean,
    median,
    rms,
    robust_sd,
)
from benchmarks.limits import Figure
from benchmarks.stripe_images import Kind, exact_break_points, shot_of, stripe_image

from ringpose.detect.pipeline import detect
from ringpose.detect.stripes import find_stripes
from ringpose.estimate.factors.lines import line_whitening
from ringpose.measure.stream import estimate_pose
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.detection import BreakPointFlag, BreakPoints
from ringpose.types.pose import RingPose

CLEAN = (Kind.DARK, Kind.DIM)
"""Kinds with sensor noise only, to which the bound applies."""

MAX_SIGMA_PX = {Kind.DARK: 0.05, Kind.DIM: 0.12, Kind.SPECKLE: 0.35, Kind.FOIL: 0.35}

MIN_NEES, MAX_NEES = 0.8, 1.25
"""Band for stripe centres."""

END_NEES = {Kind.SATURATED: (0.4, 1.5), Kind.BRIGHT_FOIL: (0.4, 2.5)}
"""Bands for break points where they differ: sigmas of saturated ones allow for speckle, which these images lack; glints
of bright foil leave few points without a flag, some of them far off."""

MIN_END_NEES, MAX_END_NEES = 0.6, 1.5

MIN_FOUND = {Kind.BRIGHT_FOIL: 0.45}
"""Least share of break points that are found, where it is not `USUAL_FOUND`."""

USUAL_FOUND = 0.85

WRONG_SIGMAS = 5.0

MAD_ERROR = 1.17
"""Standard error of `robust_sd` of n normal values, times sqrt(n) over it."""


def accuracy_figures(seeds: int) -> tuple[list[Figure], list[Figure]]:
    """Figures of stripe centres, column by column, and of break points, on the same images of each kind."""
    centers, ends = [], []
    for kind in Kind:
        images = [stripe_image(kind, seed) for seed in range(seeds)]
        if kind in MAX_SIGMA_PX:
            errors = [center_errors(find_stripes(image.image), image) for image in images]
            centers += _center_figures(kind, joined(errors))
        ends += _break_point_figures(
            kind, joined([break_point_errors(detect(shot_of(image), image.rig), image) for image in images])
        )
    return centers, ends


def pose_accuracy(samples: int) -> list[Figure]:
    """RMS error of centre and normal of `ml` over their bounds, with break points that have exactly the reported noise.

    The bound is the covariance at the true break points.
    """
    image = stripe_image(Kind.DARK, 0)
    exact = exact_break_points(image)
    truth = estimate_pose(exact, image.rig)
    assert isinstance(truth, RingPose)
    assert truth.covariance is not None
    assert truth.covariance_center_m2 is not None
    poses = [estimate_pose(_noisy(exact, np.random.default_rng(seed)), image.rig) for seed in range(samples)]
    found = [pose for pose in poses if isinstance(pose, RingPose)]
    center_m = rms(np.array([np.linalg.norm(pose.center_m - truth.center_m) for pose in found]))
    normal = rms(np.array([np.linalg.norm(pose.normal - truth.normal) for pose in found]))
    bound_center_m = math.sqrt(np.trace(truth.covariance_center_m2))
    bound_normal = math.sqrt(np.trace(truth.covariance[:2, :2]))
    unit = f"x bound, standard error {1.0 / math.sqrt(2 * len(found)):.2f}"  # of one dominating error
    return [
        Figure(name="ml: centre", measured=center_m / bound_center_m, unit=unit, max_value=1.1),
        Figure(name="ml: normal", measured=normal / bound_normal, unit=unit, max_value=1.1),
    ]


def _noisy(points: BreakPoints, generator: np.random.Generator) -> BreakPoints:
    """Points with noise of their covariance along the stripes, and lines with that of fits to evenly spread centres.

    The errors of a line's two ends are correlated: -1/2 for equal sigmas (`line_whitening`).
    """
    along_px = np.sqrt(points.covariance_px2[..., 0, 0]) * generator.normal(size=points.flags.shape)
    across_px = np.zeros((*points.flags.shape, 2))
    for laser, sigma_px in enumerate(points.face_sigma_px.tolist()):
        first, mixed, second = line_whitening(*sigma_px)
        across_px[laser, :, 1] = np.linalg.solve([[first, 0.0], [mixed, second]], generator.normal(size=2))
    return replace(
        points,
        position_px=points.position_px + along_px[..., None] * [1.0, 0.0],
        face_start_undistorted_px=points.face_start_undistorted_px + across_px[:, 0],
        face_end_undistorted_px=points.face_end_undistorted_px + across_px[:, 1],
    )


def _center_figures(kind: Kind, errors: CenterErrors) -> list[Figure]:
    error = rms(errors.error_px / errors.bound_px) if kind in CLEAN else rms(errors.error_px)
    unit, limit = ("x bound", 1.15) if kind in CLEAN else ("px", math.inf)
    nees = mean((errors.error_px / errors.sigma_px) ** 2)
    return [
        Figure(name=f"{kind}: error", measured=error, unit=unit, max_value=limit),
        Figure(name=f"{kind}: NEES", measured=nees, min_value=MIN_NEES, max_value=MAX_NEES),
    ]


def _break_point_figures(kind: Kind, errors: BreakPointErrors) -> list[Figure]:
    limit = MAX_SIGMA_PX.get(kind, math.inf)
    min_nees, max_nees = END_NEES.get(kind, (MIN_END_NEES, MAX_END_NEES))
    min_found = MIN_FOUND.get(kind, USUAL_FOUND)
    unflagged = errors.flags & ~BreakPointFlag.SATURATED == 0
    nees_along = _nees(errors.along_px, errors.along_sigma_px, unflagged)
    nees_across = _nees(errors.across_px, errors.across_sigma_px, unflagged)
    figures = [
        Figure(
            name=f"{kind}: found", measured=len(errors.along_px) / errors.expected, unit="of all", min_value=min_found
        ),
        Figure(name=f"{kind}: sigma along", measured=robust_sd(errors.along_px), unit="px", max_value=limit),
        Figure(name=f"{kind}: bias along", measured=abs(median(errors.along_px)), unit="px", max_value=limit / 3),
        Figure(name=f"{kind}: sigma across", measured=robust_sd(errors.across_px), unit="px"),
        Figure(name=f"{kind}: NEES", measured=mean(errors.nees[unflagged]), min_value=min_nees, max_value=max_nees),
        Figure(name=f"{kind}: NEES along", measured=nees_along),
        Figure(name=f"{kind}: NEES across", measured=nees_across),
        Figure(name=f"{kind}: wrong without a flag", measured=_wrong(errors), max_value=0.0),
    ]
    if kind in CLEAN:
        ratio = robust_sd(errors.along_px / errors.bound_px)
        unit = f"x bound, standard error {MAD_ERROR * ratio / math.sqrt(len(errors.along_px)):.2f}"
        figures.append(Figure(name=f"{kind}: sigma along", measured=ratio, unit=unit, max_value=1.6))
    return figures


def _nees(error_px: Float64[Array, "point"], sigma_px: Float64[Array, "point"], which: Bool[Array, "point"]) -> float:
    return mean((error_px[which] / sigma_px[which]) ** 2)


def _wrong(errors: BreakPointErrors) -> float:
    """Number of break points without a flag that are off by more than 1.5 px, or 5 of their own sigmas."""
    far = np.hypot(errors.along_px, errors.across_px) > WRONG_PX
    far |= np.abs(errors.along_px) > WRONG_SIGMAS * errors.along_sigma_px
    far |= np.abs(errors.across_px) > WRONG_SIGMAS * errors.across_sigma_px
    return float((far & (errors.flags == 0)).sum())
