"""A walk through camera, exposures and lasers before anything is measured with them."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.laser_check import STRIPE_IN_THE_DARK, Image, LitPlaces, places_lit, shows_stripe
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.lasers.uncontrolled import UncontrolledLasers
from ringpose.errors import LaserSafetyError

Verdict = Literal["ok", "warning", "fault"]

FRAMES = 10
"""Taken without lasers, for the rate and for lost ones."""

MAX_SETTLE_S = 0.5
"""A laser that follows later does not follow."""

SETTLED = 0.9
"""Share of a laser's final contrast at which it counts as on, and one minus it at which it counts as off."""

MIN_USABLE = 10
"""Pixels that are not full, to judge an exposure by."""

MARGIN = 1.5
"""Between the slowest laser and the settling time that is recommended."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One thing that was looked at."""

    check: str
    verdict: Verdict
    found: str
    remedy: str = ""


def dry_run(camera: CameraDriver, lasers: LaserDriver, exposure_s: float | None) -> Iterator[Check]:
    """Finding by finding; every laser is off in the end, and one that is not is a `LaserSafetyError`.

    Both devices are open.
    """
    lasers.set_mask(0)
    lasers.wait(MAX_SETTLE_S)
    camera.arm(exposure_s)
    yield _camera(camera)
    yield from (Check(check="camera", verdict="warning", found=line) for line in camera.warnings())
    yield _frames(camera)
    dark = _image(camera, 0)
    yield _darkness(camera, dark)
    slowest_s = 0.0
    for laser in range(0 if isinstance(lasers, UncontrolledLasers) else lasers.count):
        places, finding = _laser(camera, lasers, laser, dark)
        yield finding
        if places is not None:
            times_s = [_followed_after_s(camera, lasers, mask, places) for mask in (1 << laser, 0)]
            slowest_s = max(slowest_s, *times_s)
            yield _exposure(camera, lasers, laser, places)
    if slowest_s >= MAX_SETTLE_S:
        yield Check(check="settle", verdict="fault", found=f"a laser has not followed within {MAX_SETTLE_S} s")
    elif slowest_s:
        found = (
            f"the slowest laser follows within {1e3 * slowest_s:.0f} ms; --settle {MARGIN * slowest_s:.3f} is enough"
        )
        yield Check(check="settle", verdict="ok", found=found)


def _camera(camera: CameraDriver) -> Check:
    description, bounds = camera.describe(), camera.bounds("ExposureTime")
    said = f"{description.name}, {description.image_width} x {description.image_height}, {description.saturation_dn} dn"
    limits = "" if bounds is None else f", exposure {1e-6 * bounds[0]:g} to {1e-6 * bounds[1]:g} s"
    return Check(check="camera", verdict="ok", found=said + limits)


def _frames(camera: CameraDriver) -> Check:
    began_s = time.perf_counter()
    frames = [camera.trigger(0) for _ in range(FRAMES)]
    rate_hz = FRAMES / (time.perf_counter() - began_s)
    again = sum(frame.attempts - 1 for frame in frames)
    found = f"{FRAMES} frames of {frames[0].exposure_s:g} s, {rate_hz:.1f} a second, {again} of them taken again"
    if again:
        return Check(check="frames", verdict="warning", found=found, remedy="look for lost packets: cable, switch")
    return Check(check="frames", verdict="ok", found=found)


def _darkness(camera: CameraDriver, dark: Image) -> Check:
    full_dn = camera.describe().saturation_dn
    share = float(dark.mean()) / full_dn
    found = f"without lasers the image has {100 * share:.1f} % of the full grey value"
    if share > 0.5:
        return Check(check="ambient light", verdict="warning", found=found, remedy="darken, or expose shorter")
    return Check(check="ambient light", verdict="ok", found=found)


def _laser(camera: CameraDriver, lasers: LaserDriver, laser: int, dark: Image) -> tuple[LitPlaces | None, Check]:
    """Whether a laser is seen when it is on, and gone when it is off."""
    full_dn, check = camera.describe().saturation_dn, f"laser {laser + 1}"
    lasers.set_mask(1 << laser)
    lasers.wait(MAX_SETTLE_S)
    lit = _image(camera, 1 << laser)
    lasers.set_mask(0)
    lasers.wait(MAX_SETTLE_S)
    after = _image(camera, 0)
    places = places_lit(lit, [dark], full_dn)
    if places is None and shows_stripe(after):
        found = "is not seen to go on or off, and a stripe shows while all are off"
        raise LaserSafetyError(check, found, STRIPE_IN_THE_DARK)
    if places is None:
        remedy = "look whether it shines, at something that the camera sees, and whether the exposure is long enough"
        return None, Check(check=check, verdict="fault", found="is not seen", remedy=remedy)
    if places.are_lit_in(after):
        raise LaserSafetyError(check, "is seen after it was switched off", "cut the power")
    found = f"seen at {len(places.pixel)} pixels, {float(np.median(places.contrast_dn)):.0f} dn above the dark"
    full = float((places.contrast_dn + places.dark_dn >= full_dn).mean())
    if full > 0.5:
        remedy = "expose shorter: full pixels tell nothing of a stripe's middle"
        return places, Check(check=check, verdict="warning", found=f"{found}, {100 * full:.0f} % full", remedy=remedy)
    return places, Check(check=check, verdict="ok", found=found)


def _followed_after_s(camera: CameraDriver, lasers: LaserDriver, mask: int, places: LitPlaces) -> float:
    """From the command until a frame began in which the laser had come on, or had gone off if the mask is 0."""
    lasers.set_mask(mask)
    commanded_s = time.perf_counter()
    while (elapsed_s := time.perf_counter() - commanded_s) < MAX_SETTLE_S:
        above = _image(camera, mask).ravel()[places.pixel] - places.dark_dn
        share = float(above.mean() / places.contrast_dn.mean())
        if (share > SETTLED) if mask else (share < 1 - SETTLED):
            break
    return elapsed_s


def _exposure(camera: CameraDriver, lasers: LaserDriver, laser: int, places: LitPlaces) -> Check:
    """Whether half the exposure gives half the light."""
    check, light_dn = f"exposure, laser {laser + 1}", []
    whole_s = camera.trigger(0).exposure_s
    for exposure_s in (whole_s, whole_s / 2):
        pair = []
        for mask in (0, 1 << laser):
            lasers.set_mask(mask)
            lasers.wait(MAX_SETTLE_S)
            pair.append(camera.trigger(mask, exposure_s).image.ravel()[places.pixel].astype(np.float32))
        light_dn.append(pair)
    lasers.set_mask(0)
    usable = light_dn[0][1] < camera.describe().saturation_dn
    if usable.sum() < MIN_USABLE:
        return Check(check=check, verdict="warning", found="cannot be judged: all is full", remedy="expose shorter")
    whole, half = (float((lit - dark)[usable].mean()) for dark, lit in light_dn)
    found = f"half the exposure gives {100 * half / whole:.0f} % of the light"
    if not 0.4 < half / whole < 0.65:
        remedy = "a camera that applies exposures late needs skip=1 in its URI"
        return Check(check=check, verdict="fault", found=found, remedy=remedy)
    return Check(check=check, verdict="ok", found=found)


def _image(camera: CameraDriver, mask: int) -> Image:
    return camera.trigger(mask).image
