"""How long lasers take to come on and to go off, measured with the camera that will look at them."""

import time

from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.seen import LitPlaces, places_lit
from ringpose.errors import DeviceError

LONGEST_S = 0.3
"""No relay and no laser takes longer."""

STEADY = 0.95
"""Share of its full light with which a laser counts as on; as off, when only the rest of it is left."""

MARGIN = 1.25
"""Contacts do not always close in the same time."""


def measured_settle_s(camera: CameraDriver, lasers: LaserDriver, exposure_s: float | None) -> float:
    """Time from a command after which a frame is as it stays, the longest of all lasers, with a margin.

    Every laser that shows is switched off and on again while frames are triggered; all are off in the end.
    """
    saturation_dn = camera.describe().saturation_dn
    lasers.set_mask(0)
    lasers.wait(LONGEST_S)
    dark = camera.trigger(0, exposure_s).image
    times_s = []
    for laser in range(lasers.count):
        lasers.set_mask(1 << laser)
        lasers.wait(LONGEST_S)
        places = places_lit(camera.trigger(1 << laser, exposure_s).image, [dark], saturation_dn)
        if places is not None:
            times_s += [_steady_after_s(camera, lasers, mask, places, exposure_s) for mask in (0, 1 << laser)]
        lasers.set_mask(0)
    if not times_s:
        raise DeviceError("--settle auto", "no laser shows in the image", "say how long, such as --settle 0.05")
    return MARGIN * max(times_s)


def _steady_after_s(
    camera: CameraDriver, lasers: LaserDriver, mask: int, places: LitPlaces, exposure_s: float | None
) -> float:
    """When the first of the frames was triggered from which on all are steady, after switching to `mask`."""
    lasers.set_mask(mask)
    began_s = time.monotonic()
    steady_s = triggered_s = 0.0
    was_steady = False
    while triggered_s < LONGEST_S:
        triggered_s = time.monotonic() - began_s
        share = places.share_of_light(camera.trigger(mask, exposure_s).image)
        is_steady = share >= STEADY if mask else share <= 1 - STEADY
        steady_s = steady_s if was_steady and is_steady else triggered_s
        was_steady = is_steady
    return steady_s
