"""Quality of a mount: verdict with advice, values for the file, summary for the user, check of a given mount."""

from collections.abc import Mapping
from math import degrees, sqrt
from typing import Any, NamedTuple

import numpy as np

from ringpose.calibrate.acceptance import (
    MOUNT_CHECK_LIMITS,
    MOUNT_LIMITS,
    MOVING_LIMITS,
    check,
    verdict_lines,
    verdict_values,
)
from ringpose.calibrate.mount.adjustment import (
    MIN_FREE_VIEWS,
    PRIOR_FACTOR,
    PRIOR_ROTATION_RAD,
    PRIOR_TRANSLATION_M,
    ROTATION_BOUNDS_RAD,
    TRANSLATION_BOUNDS_M,
)
from ringpose.calibrate.mount.pipeline import MountCalibration
from ringpose.calibrate.mount.systematic import SystematicError
from ringpose.calibrate.mount.whole_rig import HeldOutErrors, WholeRig
from ringpose.geometry.rotations import rotation_vector
from ringpose.types.arrays import Array, Float64
from ringpose.types.calibration import Verdict
from ringpose.types.rig import Mount

SIGNIFICANT_SIGMAS = 3.0
"""Standard deviations from which an error of the board's scale is one: chance gives it in one session of 400. With an
inaccurate robot (2.7 mm) a board that is wrong by 20 % is at 3.8 to 4.6; doubled, it would not be named."""

SHOWN = 0.95
"""Probability from which an error that depends on the robot's pose counts as shown, or as excluded."""


def held_out_rms_m(calibration: MountCalibration) -> float:
    """Root mean square of the held-out errors; NaN if the other views determine the mount for none."""
    known = calibration.without.distance_m[np.isfinite(calibration.without.distance_m)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def sds(calibration: MountCalibration) -> tuple[float, float]:
    """Standard deviations of the mount in the worst direction: rotation in radians, translation in metres."""
    return _worst_sds(calibration.covariance)


def _worst_sds(covariance: Float64[Array, "n n"]) -> tuple[float, float]:
    turn, shift = covariance[:3, :3], covariance[3:6, 3:6]
    return float(np.sqrt(np.linalg.eigvalsh(turn)[-1])), float(np.sqrt(np.linalg.eigvalsh(shift)[-1]))


def mount_verdict(calibration: MountCalibration) -> Verdict:
    """The verdict, with advice for each value beyond its limit."""
    used, given = len(calibration.stations), len(calibration.stations) + len(calibration.rejected)
    frame = "base" if calibration.eye_to_hand else "tool"
    largest, across, _ = calibration.turns.spread_rad.tolist()
    axis = calibration.turns.main_axis
    missing = "xyz"[int(np.argmin(np.abs(axis)))]
    rotation_sd, translation_sd = sds(calibration)
    sigmas = calibration.solution.sigmas
    share, share_sd = calibration.board_scale
    known = share_sd < MOUNT_LIMITS["board_scale_sd"].good and abs(share) > SIGNIFICANT_SIGMAS * share_sd
    scale_error = abs(share) if known else 0.0
    more = f"add views, turned by 20 degrees or more about the {frame}'s {missing} axis and to both sides"
    findings = [
        check(MOUNT_LIMITS, "board_moved", float(bool(calibration.board_moved)), moved=calibration.board_moved),
        check(MOUNT_LIMITS, "board_scale_error", scale_error, factor=1 + share),
        check(MOUNT_LIMITS, "board_scale_sd", share_sd),
        check(MOUNT_LIMITS, "views_used", float(used)),
        check(MOUNT_LIMITS, "views_used_share", used / given),
        check(MOUNT_LIMITS, "largest_turn_rad", largest),
        check(MOUNT_LIMITS, "turn_across_rad", across, more=more),
        check(MOUNT_LIMITS, "held_out_m", held_out_rms_m(calibration)),
        check(MOUNT_LIMITS, "rotation_sd_rad", rotation_sd, more=more),
        check(MOUNT_LIMITS, "translation_sd_m", translation_sd, more=more),
        check(MOUNT_LIMITS, "robot_rotation_rad", sigmas.rotation_rad),
        check(MOUNT_LIMITS, "robot_translation_m", sigmas.translation_m),
        check(MOUNT_LIMITS, "disagreement", float(max(calibration.disagreement))),
    ]
    if calibration.is_moving:
        moved_px = image_motion_px(calibration)
        sigmas_of_blur = (
            moved_px / sqrt(12.0) / calibration.solution.corner_px
        )  # of a place that is anywhere on the way
        worst = int(np.argmax(sigmas_of_blur))
        findings += [
            check(MOVING_LIMITS, "delay_sd_s", calibration.delay_sd_s, more=_delay_advice(calibration)),
            check(MOVING_LIMITS, "stamp_sd_s", calibration.solution.stamp_sd_s),
            check(MOVING_LIMITS, "blur_sigmas", float(sigmas_of_blur[worst]), blur_px=moved_px[worst]),
        ]
    return Verdict(findings=tuple(findings))


def _delay_advice(calibration: MountCalibration) -> str:
    if calibration.open_delay is not None:
        return "the robot hardly moves at the views: move it there to know its clock, or leave out --moving"
    return "move the robot faster at the views, and not alike at all of them"


def image_motion_px(calibration: MountCalibration) -> Float64[Array, "view"]:
    """How far the corners move within the exposure of each view, root mean square, by the pinhole."""
    solution, moved_px = calibration.solution, []
    focal_px = float(solution.state.camera.camera_matrix[0, 0])
    for station, pose, wrt_error in zip(calibration.stations, solution.boards, solution.numbers.wrt_error, strict=True):
        rate = wrt_error @ station.twist
        arm_m = station.view.points_board_m @ pose.rotation.T
        point_m, velocity_m_s = arm_m + pose.translation_m, np.cross(rate[:3], arm_m) + rate[3:]
        along = velocity_m_s[:, :2] - point_m[:, :2] / point_m[:, 2:] * velocity_m_s[:, 2:]
        speed_px_s = focal_px * np.sqrt(np.mean(np.sum((along / point_m[:, 2:]) ** 2, axis=1)))
        moved_px.append(speed_px_s * (0.0 if station.sighting is None else station.sighting.exposure_s))
    return np.array(moved_px)


def mount_quality(calibration: MountCalibration, verdict: Verdict) -> Mapping[str, Any]:
    """The key `quality.mount` of the rig file."""
    solution, without = calibration.solution, calibration.without
    rotation_sd, translation_sd = sds(calibration)
    share, share_sd = calibration.board_scale
    board = "tool_from_board" if calibration.eye_to_hand else "base_from_board"
    robot: dict[str, Any] = {
        "rotation_sd_rad": solution.sigmas.rotation_rad,
        "translation_sd_m": solution.sigmas.translation_m,
        "bounds": {"rotation_rad": list(ROTATION_BOUNDS_RAD), "translation_m": list(TRANSLATION_BOUNDS_M)},
    }
    if calibration.has_prior:
        robot["prior"] = {
            "rotation_rad": PRIOR_ROTATION_RAD, "translation_m": PRIOR_TRANSLATION_M, "factor": PRIOR_FACTOR
        }  # fmt: skip
    robot["systematic_probability"] = calibration.systematic.probability
    if calibration.systematic.probability > SHOWN:
        parts = {"repeatability": calibration.systematic.repeatability, "systematic": calibration.systematic.systematic}
        robot |= {
            name: {"rotation_sd_rad": part.rotation_rad, "translation_sd_m": part.translation_m}
            for name, part in parts.items()
        }
    views = [
        {"name": station.name, "rms_px": rms, "corner_sigma_px": sigma, "held_out_m": held, "held_out_rad": angle}
        for station, rms, sigma, held, angle in zip(
            calibration.stations, solution.residual_rms_px.tolist(), solution.corner_px.tolist(),
            without.distance_m.tolist(), without.angle_rad.tolist(), strict=True,
        )
    ]  # fmt: skip
    delay = {} if not calibration.is_moving else {
        "delay": {
            "delay_s": solution.state.delay_s, "sd_s": calibration.delay_sd_s,
            "is_determined": calibration.is_delay_known, "stamp_sd_s": solution.stamp_sd_s,
            "speed_m_s": calibration.speeds[0], "rate_rad_s": calibration.speeds[1],
            "image_motion_px": float(image_motion_px(calibration).max()),
        }
    }  # fmt: skip
    known = [
        {key: value for key, value in view.items() if isinstance(value, str) or np.isfinite(value)} for view in views
    ]
    return {
        "verdict": verdict_values(verdict),
        "held_out_rms_m": held_out_rms_m(calibration) if np.isfinite(held_out_rms_m(calibration)) else None,
        "rotation_sd_rad": rotation_sd,
        "translation_sd_m": translation_sd,
        "disagreement": list(calibration.disagreement),
        "robot_error": robot,
        **delay,
        "board_scale": {"share": share, "sd": share_sd},
        board: solution.state.board.matrix,
        f"{board}_covariance": calibration.covariance[6:12, 6:12],
        "views": known,
        "left_out": [{"name": name, "reason": reason} for name, reason in calibration.rejected.items()],
    }


def mount_summary(calibration: MountCalibration, verdict: Verdict) -> list[str]:
    """The result as lines of text."""
    lines = [f"{name}: left out: {reason}" for name, reason in calibration.rejected.items()]
    solution, without = calibration.solution, calibration.without
    used, given = len(calibration.stations), len(calibration.stations) + len(calibration.rejected)
    largest, across, _ = (degrees(angle) for angle in calibration.turns.spread_rad.tolist())
    lines.append(
        f"{used} of {given} views used, turned by up to {largest:.0f} degrees, by {across:.0f} about a second axis; "
        f"corners {np.sqrt(np.mean(solution.residual_rms_px**2)):.3f} px rms"
    )
    sigmas = solution.sigmas
    prior = f", partly from a prior, as there are fewer than {MIN_FREE_VIEWS} views" if calibration.has_prior else ""
    lines.append(
        f"error of the robot's poses: {1e3 * sigmas.translation_m:.3f} mm, {degrees(sigmas.rotation_rad):.3f} degrees "
        f"each axis{prior}"
    )
    lines += _systematic_lines(calibration.systematic)
    frame = "base" if calibration.eye_to_hand else "tool"
    mount, sd = solution.state.mount, np.sqrt(np.diag(calibration.covariance))
    place = ", ".join(
        f"{1e3 * value:.2f} ± {1e3 * sigma:.2f}" for value, sigma in zip(mount.translation_m, sd[3:6], strict=True)
    )
    turn = ", ".join(
        f"{degrees(value):.3f} ± {degrees(sigma):.3f}"
        for value, sigma in zip(rotation_vector(mount.rotation), sd[:3], strict=True)
    )
    lines += [f"camera in the {frame} frame: {place} mm", f"  rotation vector: {turn} degrees"]
    if calibration.is_moving:
        lines.append(_delay_line(calibration))
    if np.isfinite(held_out_rms_m(calibration)):
        worst = int(np.nanargmax(without.distance_m))
        lines.append(
            f"held-out error of the board's place: {1e3 * held_out_rms_m(calibration):.2f} mm rms, at most "
            f"{1e3 * without.distance_m[worst]:.2f} mm ({calibration.stations[worst].name}), "
            f"{degrees(float(np.nanmax(without.angle_rad))):.2f} degrees"
        )
    return lines + verdict_lines(verdict)


def _delay_line(calibration: MountCalibration) -> str:
    speed_m_s, rate_rad_s = calibration.speeds
    delay_ms = round(1e3 * calibration.solution.state.delay_s, 2)
    offset = f"{'-' if delay_ms < 0.0 else '+'} {abs(delay_ms):.2f} ± {1e3 * calibration.delay_sd_s:.2f} ms"
    motion = f"up to {1e3 * speed_m_s:.3g} mm/s and {degrees(rate_rad_s):.2g} degrees/s at the views"
    if calibration.is_delay_known:
        scatter = f"the stamps of the images scatter by {1e3 * calibration.solution.stamp_sd_s:.2f} ms"
        return f"the robot's stamps are those of the camera {offset}, {scatter}; it moves by {motion}"
    why = "hardly moves" if calibration.open_delay is not None else "moves alike at all views, as with another mount"
    return f"the offset of the robot's stamps is not determined, {offset}: the robot {why} ({motion})"


def _systematic_lines(found: SystematicError) -> list[str]:
    """What the views show about an error that depends on the robot's pose; nothing if it is improbable."""
    part, rest = found.systematic, found.repeatability
    if found.probability > SHOWN:
        return [
            f"  it depends on the robot's pose: {1e3 * part.translation_m:.3f} mm, {degrees(part.rotation_rad):.3f} "
            f"degrees, beside a repeatability of {1e3 * rest.translation_m:.3f} mm, {degrees(rest.rotation_rad):.3f} "
            "degrees; what is the same in all views is part of the covariance"
        ]
    if found.probability > 1.0 - SHOWN:
        return [
            f"  the views do not show whether it depends on the robot's pose (probability {found.probability:.0%}): "
            "the covariance contains so much of what is the same in all views then"
        ]
    return []


def whole_rig_quality(rig: WholeRig) -> Mapping[str, Any]:
    """The key `quality.whole_rig` of the rig file: what each solution predicts of views that are left out."""

    def errors(held_out: HeldOutErrors) -> dict[str, float | None]:
        values = {"stripes_rms_m": held_out.rms_m, "corners_rms_px": held_out.rms_px}
        return {name: value if np.isfinite(value) else None for name, value in values.items()}

    kept = "joint" if rig.is_joint else "separate"
    return {"kept": kept, "held_out": {"separate": errors(rig.separate), "joint": errors(rig.joint)}}


def whole_rig_lines(rig: WholeRig) -> list[str]:
    """The held-out errors of both solutions as lines of text."""
    lines = [
        f"{name} solution: stripe points of views left out lie {1e3 * held_out.rms_m:.2f} mm rms off the board's face "
        f"in the base, corners {held_out.rms_px:.2f} px off"
        for name, held_out in (("separate", rig.separate), ("joint", rig.joint))
    ]
    return [*lines, f"kept: the {'joint' if rig.is_joint else 'separate'} solution"]


class MountComparison(NamedTuple):
    """A given mount against that of the views."""

    shift_m: Float64[Array, "xyz=3"]
    turn_rad: Float64[Array, "3"]
    sigmas: float
    """Root of the squared Mahalanobis distance over its degrees of freedom, six or, with a delay, seven."""
    rotation_sd_rad: float
    translation_sd_m: float
    """Standard deviations of the difference in the worst direction."""
    delay_s: float | None = None
    """Difference of the delays, of a robot that moved."""


def compared_mount(calibration: MountCalibration, given: Mount) -> MountComparison:
    """How far a given mount is from that of the views, by the covariances of both."""
    mount = calibration.solution.state.mount
    turn_rad = rotation_vector(given.carrier_from_camera[:3, :3] @ mount.rotation.T)
    shift_m = given.carrier_from_camera[:3, 3] - mount.translation_m
    difference, delay_s = np.append(turn_rad, shift_m), None
    both = calibration.covariance[:6, :6] + given.covariance[:6, :6]
    if calibration.is_moving:
        delay_s = given.delay_s - calibration.solution.state.delay_s
        difference, both = np.append(difference, delay_s), np.pad(both, (0, 1))
        both[6, 6] = calibration.delay_sd_s**2 + given.delay_sd_s**2
        if calibration.solution.has_delay:
            both[6, :6] = both[:6, 6] = calibration.covariance[12, :6]
    sigmas = float(np.sqrt(difference @ np.linalg.solve(both, difference) / len(difference)))
    return MountComparison(shift_m, turn_rad, sigmas, *_worst_sds(both), delay_s)


def comparison_verdict(comparison: MountComparison) -> Verdict:
    """Whether a given mount agrees with the views."""
    uncertain = "the given mount or the views are too uncertain to tell; take more views, turned more"
    values = {
        "difference_sigmas": comparison.sigmas,
        "difference_rotation_sd_rad": comparison.rotation_sd_rad,
        "difference_translation_sd_m": comparison.translation_sd_m,
    }
    return Verdict(
        findings=tuple(check(MOUNT_CHECK_LIMITS, name, value, uncertain=uncertain) for name, value in values.items())
    )


def comparison_lines(comparison: MountComparison, verdict: Verdict) -> list[str]:
    """The comparison as lines of text."""
    shift = ", ".join(f"{1e3 * each:.2f}" for each in comparison.shift_m)
    angle = degrees(float(np.linalg.norm(comparison.turn_rad)))
    far = f"{1e3 * np.linalg.norm(comparison.shift_m):.2f} mm ({shift}) and {angle:.3f} degrees"
    if comparison.delay_s is not None:
        far += f", its delay by {1e3 * comparison.delay_s:.2f} ms"
    return [f"the given mount differs by {far}, {comparison.sigmas:.1f} sigmas", *verdict_lines(verdict)]
