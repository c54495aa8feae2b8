"""Acceptance of calibrations: the limits of all checks, and verdicts as keys of a file and as lines of text.

The limits of a camera are those of one that measures to 0.1 mm at 0.5 m (0.2 to 0.4 px) with boards of some dozens of
corners.
"""

from collections.abc import Mapping
from math import inf, isnan, radians
from typing import Any

from ringpose.types.calibration import Check, Grade, Verdict

Limits = Mapping[str, tuple[float, float]]
"""By name of a check: limit of a good value, and limit beyond which the calibration must be repeated."""

BOARD_LIMITS: Limits = {
    "marker_size_error": (0.03, 0.1),  # relative to the markers' spacing; unrefined corners alone cause 0.01
    "bow_sigmas": (5.0, inf),  # root of chi-squared of its three coefficients: 1.5 for flat boards on average, rarely 4
}

CAMERA_LIMITS: Limits = {
    "other_camera_share": (0.0, 0.2),  # if more views fit another camera, it is ambiguous which one is calibrated
    "views_used": (10.0, 4.0),
    "images_used_share": (0.8, 0.5),
    "corner_sigma_px": (0.3, 1.5),
    "coverage_share": (0.6, 0.25),
    "bare_regions": (0.0, 6.0),
    "largest_tilt_rad": (radians(20), radians(10)),
    "tilt_spread_across_rad": (radians(4), -inf),
    "distance_ratio": (1.2, -inf),
    "focal_sigma_share": (0.002, 0.02),
    "projection_sigma_px": (0.3, 5.0),
    "projection_sigma_worst_px": (1.0, inf),
    "projection_unknown_share": (0.05, inf),
    "view_disagreement": (2.5, 15.0),
    "leave_one_out_px": (1.0, inf),
    "split_half_px": (1.0, inf),
    "held_out_ratio": (1.05, inf),
}

PLANES_LIMITS: Limits = {
    "board_rms_px": (0.3, 1.0),  # median over the views of the corner rms
    "distance_ratio": (1.4, 1.05),  # farthest over nearest board: planes are valid about as far beyond
    "variance_excess": (3.0, 100.0),  # a board flat to 0.1 mm can reach 3; above 100 the covariance is meaningless
    "views": (5.0, 2.0),  # two determine a plane without redundancy; of five, a wrong one stands out
    "condition": (10.0, 50.0),  # 200 mm wide views that differ by 20 mm across their stripes; 50: collinear
    "held_out_rms_m": (2e-4, 2e-3),  # over the distance: speckle makes 0.1 mm at 0.5 m; 1 mm indicates a wrong stripe
    "disagreement": (3.0, 100.0),
    "depth_sd_m": (1e-3, 1e-2),  # over the distance of the farthest board
    "ring_center_sd_m": (1e-3, 1e-2),  # over the distance; the errors of a shot at 0.5 m are five times as large
    "angle_error_rad": (radians(1), radians(5)),
    "middle_outside_rad": (radians(1), inf),
}


def check(limits: Limits, name: str, value: float, advice: str, place: str = "", *, scale: float = 1.0) -> Check:
    """The check of a value by its limits; the limits of a relative quantity are multiplied by `scale`."""
    pass_limit, fail_limit = (scale * limit for limit in limits[name])
    return Check(name=name, value=value, pass_limit=pass_limit, fail_limit=fail_limit, advice=advice, place=place)


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
    """Lines of text: the grade with the values that are not good, `left views 3 (limit 5)`, then the advice."""
    poor = []
    for finding in verdict.findings:
        if finding.grade is not Grade.GOOD:
            value = "unknown" if isnan(finding.value) else f"{finding.value:.4g}"
            poor.append(f"{finding.place} {finding.name} {value} (limit {finding.pass_limit:.4g})".lstrip())
    reasons = "; ".join(poor) or "every number is within its limit"
    return [f"verdict: {verdict.grade}: {reasons}", *(f"advice: {sentence}" for sentence in verdict.advice)]
