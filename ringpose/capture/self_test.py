"""Self-test of camera, lasers and exposures before a measurement."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np

from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.laser_check import LitPixels
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.lasers.uncontrolled import UncontrolledLasers
from ringpose.capture.settle import MAX_SETTLE_S, SETTLE_MARGIN, LaserResponse, laser_responses
from ringpose.types.record import Key, Presence

DeviceVerdict = Literal["ok", "warning", "fault"]
"""Verdicts from best to worst."""

FRAMES = 10
"""Frames without lasers, to measure the frame rate and to count repeated frames."""

MIN_USABLE = 10
"""Minimum number of unsaturated pixels to test the exposure with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceCheck:
    """The result of one check."""

    check: Annotated[str, Key("What was tried; `verdict` in the last record.")]
    verdict: Annotated[DeviceVerdict, Key("`ok`, `warning` or `fault`; the summary has the worst one.")]
    found: Annotated[str, Key("What was found.", blank=True)]
    remedy: Annotated[str, Key("What to do about it.", presence=Presence.IF_KNOWN)] = ""


def run_self_test(camera: CameraDriver, lasers: LaserDriver, exposure_s: float | None) -> Iterator[DeviceCheck]:
    """Yields the checks as they are made, with both devices open; all lasers are off at the end.

    Raises `LaserSafetyError` if a laser is seen that should be off.
    """
    lasers.set_mask(0)
    lasers.wait(MAX_SETTLE_S)
    camera.arm(exposure_s)
    description, bounds = camera.describe(), camera.bounds("ExposureTime")
    size = f"{description.image_width} x {description.image_height}"
    limits = "" if bounds is None else f", exposure {1e-6 * bounds[0]:g} to {1e-6 * bounds[1]:g} s"
    finding = f"{description.name}, {size}, {description.saturation_dn} dn{limits}"
    yield DeviceCheck(check="camera", verdict="ok", found=finding)
    yield from (DeviceCheck(check="camera", verdict="warning", found=line) for line in camera.warnings())
    if not isinstance(lasers, UncontrolledLasers):
        yield _check_report(lasers)
    yield _check_frames(camera)
    dark = camera.trigger(0).image
    share = float(dark.mean()) / description.saturation_dn
    finding = f"without lasers the image has {100 * share:.1f} % of the full grey value"
    yield _check("ambient light", finding, share > 0.5, "warning", "darken, or expose shorter")
    slowest_s = 0.0
    for response in () if isinstance(lasers, UncontrolledLasers) else laser_responses(camera, lasers, exposure_s):
        yield _check_laser(response, description.saturation_dn)
        if response.pixels is not None:
            slowest_s = max(slowest_s, response.settle_s)
            yield _check_exposure(camera, lasers, response.laser, response.pixels)
    if slowest_s >= MAX_SETTLE_S:
        yield DeviceCheck(check="settle", verdict="fault", found=f"a laser has not followed within {MAX_SETTLE_S} s")
    elif slowest_s:
        within = f"the slowest laser follows within {1e3 * slowest_s:.0f} ms"
        yield DeviceCheck(
            check="settle", verdict="ok", found=f"{within}; --settle {SETTLE_MARGIN * slowest_s:.3f} is enough"
        )


def summary(checks: Sequence[DeviceCheck]) -> DeviceCheck:
    """The worst verdict, and the number of checks with each verdict."""
    verdicts = [check.verdict for check in checks]
    worst = next(verdict for verdict in get_args(DeviceVerdict)[::-1] if verdict in verdicts)
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in get_args(DeviceVerdict))
    return DeviceCheck(check="verdict", verdict=worst, found=counts)


def _check_report(lasers: LaserDriver) -> DeviceCheck:
    """Whether the board reports its relays; one that does not cannot be told from a port without a board."""
    reported = lasers.read_mask()
    if reported is None:
        remedy = "only the images show whether it obeys: every laser must be seen"
        return DeviceCheck(check="board", verdict="warning", found="does not report which lasers are on", remedy=remedy)
    finding = (
        f"reports lasers on (mask {reported}) while all are off" if reported else "reports that all lasers are off"
    )
    return _check("board", finding, bool(reported), "fault", "cut the power")


def _check_frames(camera: CameraDriver) -> DeviceCheck:
    began_s = time.perf_counter()
    frames = [camera.trigger(0) for _ in range(FRAMES)]
    rate_hz = FRAMES / (time.perf_counter() - began_s)
    again = sum(frame.attempts - 1 for frame in frames)
    finding = f"{FRAMES} frames of {frames[0].exposure_s:g} s, {rate_hz:.1f} a second, {again} of them repeated"
    return _check("frames", finding, again > 0, "warning", "look for lost packets: cable, switch")


def _check_laser(response: LaserResponse, full_dn: int) -> DeviceCheck:
    """Whether a laser is seen when it is on, and whether it saturates the image."""
    check, pixels = f"laser {response.laser + 1}", response.pixels
    if pixels is None:
        remedy = "check that it shines on something in the image, and that the exposure is long enough"
        return DeviceCheck(check=check, verdict="fault", found="is not seen", remedy=remedy)
    finding = f"seen at {len(pixels.pixel)} pixels, {float(np.median(pixels.contrast_dn)):.0f} dn above the dark"
    full = float((pixels.contrast_dn + pixels.dark_dn >= full_dn).mean())
    finding += f", {100 * full:.0f} % saturated"
    remedy = "expose shorter: saturated pixels do not determine the centre of a stripe"
    return _check(check, finding, full > 0.5, "warning", remedy)


def _check_exposure(camera: CameraDriver, lasers: LaserDriver, laser: int, pixels: LitPixels) -> DeviceCheck:
    """Checks that half the exposure gives half the light."""
    check, light_dn = f"exposure, laser {laser + 1}", []
    whole_s = camera.trigger(0).exposure_s
    for exposure_s in (whole_s, whole_s / 2):
        pair = []
        for mask in (0, 1 << laser):
            lasers.set_mask(mask)
            lasers.wait(MAX_SETTLE_S)
            pair.append(camera.trigger(mask, exposure_s).image.ravel()[pixels.pixel].astype(np.float32))
        light_dn.append(pair)
    lasers.set_mask(0)
    usable = light_dn[0][1] < camera.describe().saturation_dn
    if usable.sum() < MIN_USABLE:
        return _check(check, "cannot be checked: all pixels are saturated", True, "warning", "expose shorter")
    whole, half = (float((bright - dark)[usable].mean()) for dark, bright in light_dn)
    finding = f"half the exposure gives {100 * half / whole:.0f} % of the light"
    remedy = "a camera that applies exposures late needs skip=1 in its URI"
    return _check(check, finding, not 0.4 < half / whole < 0.65, "fault", remedy)


def _check(check: str, finding: str, is_bad: bool, verdict: DeviceVerdict, remedy: str) -> DeviceCheck:
    """The check with its verdict: `ok`, or, if the finding is bad, `verdict` together with the remedy."""
    return DeviceCheck(check=check, verdict=verdict if is_bad else "ok", found=finding, remedy=remedy if is_bad else "")
