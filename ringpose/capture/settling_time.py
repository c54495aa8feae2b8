"""Settling time: how long lasers take to come on and to go off, measured with the camera that captures them."""

import time

from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.laser_check import LitPixels, lit_pixels
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.errors import DeviceError

MAX_DURATION_S = 0.3
"""Longer than any relay or laser takes."""

STEADY = 0.95
"""Share of its full light from which a laser counts as on; at one minus this share it counts as off."""

MARGIN = 1.25
"""Factor on the measured time, because contacts do not always close equally fast."""


def measured_settle_s(camera: CameraDriver, lasers: LaserDriver, exposure_s: float | None) -> float:
    """Time from a command until frames no longer change, the longest of all lasers, with a margin.

    Every visible laser is switched off and on again while frames are triggered; all lasers are off at the end.
    """
    saturation_dn = camera.describe().saturation_dn
    lasers.set_mask(0)
    lasers.wait(MAX_DURATION_S)
    dark = camera.trigger(0, exposure_s).image
    times_s = []
    for laser in range(lasers.count):
        lasers.set_mask(1 << laser)
        lasers.wait(MAX_DURATION_S)
        pixels = lit_pixels(camera.trigger(1 << laser, exposure_s).image, [dark], saturation_dn)
        if pixels is not None:
            times_s += [_steady_after_s(camera, lasers, mask, pixels, exposure_s) for mask in (0, 1 << laser)]
        lasers.set_mask(0)
    if not times_s:
        raise DeviceError("--settle auto", "no laser shows in the image", "give a time, such as --settle 0.05")
    return MARGIN * max(times_s)


def _steady_after_s(
    camera: CameraDriver, lasers: LaserDriver, mask: int, pixels: LitPixels, exposure_s: float | None
) -> float:
    """Time from switching to `mask` until the trigger of the first frame after which all frames are steady."""
    lasers.set_mask(mask)
    began_s = time.monotonic()
    steady_s = triggered_s = 0.0
    was_steady = False
    while triggered_s < MAX_DURATION_S:
        triggered_s = time.monotonic() - began_s
        share = pixels.share_of_light(camera.trigger(mask, exposure_s).image)
        is_steady = share >= STEADY if mask else share <= 1 - STEADY
        steady_s = steady_s if was_steady and is_steady else triggered_s
        was_steady = is_steady
    return steady_s
