"""How long the lasers take to settle: time from a command until the images no longer change."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.laser_check import LitPixels, lit_pixels
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.shot_check import require_off
from ringpose.errors import DeviceError

MAX_SETTLE_S = 0.3
"""Longer than any relay or laser takes."""

STEADY_SHARE = 0.95
"""Share of its full light from which a laser counts as on; at one minus this share it counts as off."""

SETTLE_MARGIN = 1.25
"""Factor on the measured time, because contacts do not always close equally fast."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserResponse:
    """What the images show of a laser that is switched on alone and off again."""

    laser: int
    pixels: LitPixels | None
    """None if it is not seen."""
    settle_s: float
    """Time from a command, on or off, until frames no longer change."""


def laser_responses(camera: CameraDriver, lasers: LaserDriver, exposure_s: float | None) -> Iterator[LaserResponse]:
    """The response of each laser in turn; all lasers are off in between and at the end.

    Raises `LaserSafetyError` before the next laser is switched on if one does not go off.
    """
    saturation_dn = camera.describe().saturation_dn
    lasers.set_mask(0)
    lasers.wait(MAX_SETTLE_S)
    dark = camera.trigger(0, exposure_s).image
    for laser in range(lasers.count):
        lasers.set_mask(1 << laser)
        lasers.wait(MAX_SETTLE_S)
        pixels = lit_pixels(camera.trigger(1 << laser, exposure_s).image, [dark], saturation_dn)
        settle_s = 0.0
        if pixels is not None:
            settle_s = max(_steady_after_s(camera, lasers, mask, pixels, exposure_s) for mask in (0, 1 << laser))
        dark = require_off(camera, lasers, laser, pixels, MAX_SETTLE_S, exposure_s)
        yield LaserResponse(laser=laser, pixels=pixels, settle_s=settle_s)


def measured_settle_s(camera: CameraDriver, lasers: LaserDriver, exposure_s: float | None) -> float:
    """Time from a command until frames no longer change, the longest of all visible lasers, with a margin."""
    responses = list(laser_responses(camera, lasers, exposure_s))
    if all(response.pixels is None for response in responses):
        raise DeviceError("--settle auto", "no laser shows in the image", "give a time, such as --settle 0.05")
    return SETTLE_MARGIN * max(response.settle_s for response in responses)


def _steady_after_s(
    camera: CameraDriver, lasers: LaserDriver, mask: int, pixels: LitPixels, exposure_s: float | None
) -> float:
    """Time from switching to `mask` until the trigger of the first frame after which all frames are steady."""
    lasers.set_mask(mask)
    began_s = time.monotonic()
    steady_s = triggered_s = 0.0
    was_steady = False
    while triggered_s < MAX_SETTLE_S:
        triggered_s = time.monotonic() - began_s
        share = pixels.share_of_light(camera.trigger(mask, exposure_s).image)
        is_steady = share >= STEADY_SHARE if mask else share <= 1 - STEADY_SHARE
        steady_s = steady_s if was_steady and is_steady else triggered_s
        was_steady = is_steady
    return steady_s
