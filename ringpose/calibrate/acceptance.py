"""Acceptance of calibrations: limits and advice of all checks, and verdicts as keys of a file and as lines of text.

The limits of a camera are those of one that measures to 0.1 mm at 0.5 m (0.2 to 0.4 px) with boards of some dozens of
corners.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isnan, radians
from typing import Any

import numpy as np

from ringpose.types.board import BoardView
from ringpose.types.calibration import Check, Grade, Verdict


@dataclass(frozen=True, slots=True)
class Limit:
    """The limits of a quantity, and the advice beyond them, in which words in braces are given with the value."""

    good: float
    """Good up to this value (or from this value, if it is the larger of the two limits)."""
    redo: float
    """The calibration must be repeated beyond this value; infinite if this quantity alone never requires that."""
    advice: str
    if_redo: str | None = None
    """Advice beyond the limit `redo`, if it differs."""
    if_unknown: str | None = None
    """Advice if the value is not known (NaN), if it differs."""


# fmt: off
BOARD_LIMITS: Mapping[str, Limit] = {
    "marker_size_error": Limit(0.03, 0.1,  # relative to the markers' spacing; unrefined corners alone cause 0.01
        "relative to their spacing the markers are {width:.2f} times as wide and {height:.2f} times as high as "
        "marker_m (or the separate squares' square_m): measure the print, a size in the board file is wrong"),
    "bow_sigmas": Limit(5.0, inf,  # root of chi-squared of its three coefficients: 1.5 for flat boards, rarely 4
        "the board is not flat, by about {height_mm:.2f} mm, which changes fx by {fx_px:.1f} px (the standard "
        "deviations contain it): fix it to glass or a plate"),
}

CAMERA_LIMITS: Mapping[str, Limit] = {
    "other_camera_share": Limit(0.0, 0.2,  # if more views fit another camera, it is ambiguous which one is calibrated
        "views {views} look like another camera's, or another zoom's: focal length {difference}; calibrate each by "
        "itself"),
    "views_used": Limit(10.0, 4.0, "only {used} views were used: take ten or more"),
    "images_used_share": Limit(0.8, 0.5, "many images could not be used: the reasons are listed with their names"),
    "corner_sigma_px": Limit(0.3, 1.5,
        "the corners are inexact ({worst} most): focus, more light, a flat board held still"),
    "coverage_share": Limit(0.6, 0.25,
        "the corners cover little of the image: bring the board to its rims, or nearer"),
    "bare_regions": Limit(0.0, 6.0, "hardly any corners in the {regions}: add a view with the board there"),
    "largest_tilt_rad": Limit(radians(20), radians(10),
        "all boards are within {tilt_deg:.0f} degrees of frontal: tilt the board by 20 to 40"),
    "tilt_spread_across_rad": Limit(radians(4), -inf,
        "the boards are tilted about one axis only: tilt the board the other way too"),
    "distance_ratio": Limit(1.2, -inf, "one distance only ({distance_m:.2f} m): add views nearer and farther"),
    "focal_sigma_share": Limit(0.002, 0.02,
        "the focal length is uncertain: tilt the board more, and take it nearer and farther"),
    "projection_sigma_px": Limit(0.3, 5.0,
        "the projection is uncertain: add views, tilted to different sides, in every part of the image"),
    "projection_sigma_worst_px": Limit(1.0, inf,
        "the projection is most uncertain near pixel ({x:.0f}, {y:.0f}): bring the board there{or_hold}"),
    "projection_unknown_share": Limit(0.05, inf,
        "beyond the outermost corners this distortion model is not determined, even where its covariance is small: "
        "bring the board to the image's corners, or use --distortion-model plumb_bob"),
    "radial_stretch_sd": Limit(0.2, inf,  # k3 of lenses of this model changes the stretch in the corners by up to 0.2
        "k3 is held at 0, because the views determine it to +- {k3_sd:.2g} only: bring the board to the image's "
        "rims and corners"),
    "folded_share": Limit(0.0, inf,  # of the way from the farthest corner of the image to the principal point
        "k3 is held at 0, because the k3 of these views folds the image beyond pixel ({x:.0f}, {y:.0f}): bring the "
        "board to the image's rims and corners"),
    # The following are unknown if there are too few views, which another check reports.
    "view_disagreement": Limit(2.5, 15.0,
        "the views disagree by more than their noise (the standard deviations contain it): check that the board is "
        "flat and its sizes are true, that all images are one camera's, its focus and zoom fixed, and that no glare or "
        "cable is taken for a corner", if_unknown=""),
    "leave_one_out_px": Limit(1.0, inf,
        "the result depends mainly on {place}: add views like it, or leave it out", if_unknown=""),
    "split_half_px": Limit(1.0, inf,
        "half of the views give another camera than the rest, fx by {fx_px:.1f} px to each side: "
        "add views of every kind", if_unknown=""),
    "held_out_ratio": Limit(1.05, inf,
        "views left out fit another model better: use --distortion-model {other}", if_unknown=""),
}

PLANES_LIMITS: Mapping[str, Limit] = {
    "board_rms_px": Limit(0.3, 1.0,  # median over the views of the corner rms
        "see with --overlay whether the corners are sharp; measure the board's sizes; check the camera file",
        if_redo="the corners miss the boards by {rms_px:.1f} px: the camera file is another camera's, its lens moved, "
        "the board's sizes are others, or the board is bent; calibrate the camera anew"),
    "distance_ratio": Limit(1.4, 1.05,  # farthest over nearest board: planes are valid about as far beyond
        "add views of the board nearer than {near_m:.2f} m and farther than {far_m:.2f} m"),
    "variance_excess": Limit(3.0, 100.0,  # a board flat to 0.1 mm can reach 3; above 100 the covariance is meaningless
        "the views disagree{stray}: see that the board is flat, stood still in each shot and has the sizes in its "
        "file; calibrate the camera anew"),
    "sheet_height_m": Limit(1e-3, 3e-3,  # over the distance: depths on the planes are wrong by as much
        "the stripes beside the print lie {height_mm:.1f} mm {side} it, on another surface: see with --overlay, and "
        "give the width of the sheet around the print (--surround; 0 for the print alone)",
        if_unknown="whether the stripes beside the print lie in its plane is not determined: let them cross the "
        "print, or tilt the board to all sides"),
    "views": Limit(5.0, 2.0,  # two determine a plane without redundancy; of five, a wrong one stands out
        "add views that show the stripe of {place}: six to ten are good"),
    "condition": Limit(10.0, 50.0,  # 200 mm wide views that differ by 20 mm across their stripes; 50: collinear
        "add a view of the board 100 mm or more nearer or farther than {middle_m:.2f} m"),
    "held_out_rms_m": Limit(2e-4, 2e-3,  # over the distance: speckle makes 0.1 mm at 0.5 m; 1 mm: a wrong stripe
        "see with --overlay whether the stripe of {place} is sharp and unsaturated, in {worst} first",
        if_unknown="add a third view: two leave the held-out error undetermined"),
    "disagreement": Limit(3.0, 100.0,
        "the stripes of {place} disagree with the boards{others}: see with --overlay whether they are its own"),
    "depth_sd_m": Limit(1e-3, 1e-2,  # over the distance of the farthest board
        "{remedy}"),
    "ring_center_sd_m": Limit(1e-3, 1e-2,  # over the distance; the errors of a shot at 0.5 m are five times as large
        "poses {distance_m:.2f} m away will be off by {sd_mm:.1f} mm from this calibration alone: {remedy}"),
    "angle_error_rad": Limit(radians(1), radians(5),
        "see with --overlay whether each stripe belongs to its laser, or lasers are exchanged in all shots; check how "
        "the lasers are mounted"),
    "middle_outside_rad": Limit(radians(1), inf,
        "middle is not between left and right: see whether lasers are exchanged in all shots, or give their names in "
        "the order of their numbers (--laser-names)"),
}

MOUNT_LIMITS: Mapping[str, Limit] = {
    "board_moved": Limit(0.0, 0.5, "{moved}: repeat the views"),
    "board_scale_error": Limit(0.003, 0.05,
        "by the robot's motions the board is {factor:.4f} times as large as its file gives: measure its print, or the "
        "robot's lengths are wrong"),
    "board_scale_sd": Limit(0.2, inf,  # with half of it a poor robot hides a board that is wrong by a half
        "lengths of robot and board cannot be compared, so that a wrong unit would not be seen: add views from other "
        "distances"),
    "views_used": Limit(10.0, 3.0, "take ten views or more, turned about two axes"),
    "views_used_share": Limit(0.9, 0.6, "see why views are left out"),
    "largest_turn_rad": Limit(radians(30), radians(5), "turn the tool by 30 degrees or more between views"),
    "turn_across_rad": Limit(radians(20), radians(5), "{more}"),  # about a second axis
    "held_out_m": Limit(1e-3, 1e-2,  # rms over the views; robots that are not calibrated have errors of a millimetre
        "check the robot's calibration and tool, and that robot and board stand still at each view",
        if_unknown="add views: three leave the held-out error undetermined"),
    "rotation_sd_rad": Limit(radians(0.05), radians(0.5), "{more}"),  # in the worst direction: 0.4 mm at 0.5 m
    "translation_sd_m": Limit(5e-4, 5e-3, "{more}"),
    "robot_rotation_rad": Limit(radians(0.1), radians(1),
        "the robot's rotations are inaccurate; or the camera is, whose errors look alike: "
        "--refine-camera, --whole-rig"),
    "robot_translation_m": Limit(1e-3, 1e-2,
        "the robot's positions are inaccurate: calibrate the robot; or the camera is, whose errors look alike: "
        "--refine-camera, --whole-rig"),
    "disagreement": Limit(3.0, 30.0, "take views that differ more from each other"),
}

MOVING_LIMITS: Mapping[str, Limit] = {
    "delay_sd_s": Limit(2e-3, inf, "{more}"),  # 0.1 mm at 50 mm/s
    "stamp_sd_s": Limit(2e-3, inf, "the images are stamped late by different times: use the camera's own stamps"),
    "blur_sigmas": Limit(1.0, inf,  # of the corners' residuals
        "expose shorter or move slower: corners move by {blur_px:.2g} px within an exposure"),
}

MOUNT_CHECK_LIMITS: Mapping[str, Limit] = {
    "difference_sigmas": Limit(4.0, 8.0,
        "the given mount contradicts the views: something has moved, or it is inverted; calibrate it again"),
    "difference_rotation_sd_rad": Limit(radians(0.1), radians(1), "{uncertain}"),
    "difference_translation_sd_m": Limit(1e-3, 1e-2, "{uncertain}"),
}
# fmt: on


def check(
    limits: Mapping[str, Limit],
    name: str,
    value: float,
    place: str = "",
    *,
    scale: float = 1.0,
    margin: float = 0.0,
    **words: Any,
) -> Check:
    """The check of a value by its limits, with the words of its advice.

    The limits of a relative quantity are multiplied by `scale`; to the limit of a good value, `margin` is added.
    """
    limit = limits[name]
    checked = Check(
        name=name, value=value, pass_limit=scale * limit.good + margin, fail_limit=scale * limit.redo, place=place
    )
    special = limit.if_unknown if isnan(value) else limit.if_redo if checked.grade is Grade.REDO else None
    advice = limit.advice if special is None else special
    return replace(checked, advice=advice.format(place=place, **words))


def marker_size_findings(views: Sequence[BoardView]) -> tuple[Check, ...]:
    """Check of the markers' size relative to their spacing; empty for boards without markers."""
    ratios = [view.marker_size_ratio for view in views if view.marker_size_ratio is not None]
    if not ratios:
        return ()
    width, height = np.median(ratios, axis=0).tolist()
    error = max(abs(width - 1), abs(height - 1))
    return (check(BOARD_LIMITS, "marker_size_error", error, width=width, height=height),)


def verdict_values(verdict: Verdict) -> dict[str, Any]:
    """The key `verdict` of a calibration file: grade, advice, every value with its limits."""
    findings = []
    for finding in verdict.findings:
        values: dict[str, Any] = {"place": finding.place} if finding.place else {}
        limits = {"good_limit": finding.pass_limit, "redo_limit": finding.fail_limit}
        findings.append(
            values | {"name": finding.name, "value": finding.value} | limits | {"grade": str(finding.grade)}
        )
    return {"grade": str(verdict.grade), "advice": list(verdict.advice), "findings": findings}


def verdict_lines(verdict: Verdict) -> list[str]:
    """Lines of text: the grade with the values that are not good and the limits that they miss, then the advice."""
    reasons = "; ".join(map(_reason, verdict.poor)) or "every number is within its limit"
    return [f"verdict: {verdict.grade}: {reasons}", *(f"advice: {sentence}" for sentence in verdict.advice)]


def _reason(finding: Check) -> str:
    """`left views 3 (limit 5)`, or `left views 1 (redo below 2)`; with as many digits as tell the two numbers apart."""
    missed, words = finding.pass_limit, "limit"
    if finding.grade is Grade.REDO:
        missed = finding.fail_limit
        words = f"redo {'beyond' if finding.fail_limit >= finding.pass_limit else 'below'}"
    digits = next((n for n in range(4, 17) if f"{finding.value:.{n}g}" != f"{missed:.{n}g}"), 17)
    value = "unknown" if isnan(finding.value) else f"{finding.value:.{digits}g}"
    return f"{finding.place} {finding.name} {value} ({words} {missed:.{digits}g})".lstrip()
