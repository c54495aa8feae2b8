"""Checks of a shot before it is kept: lasers seen as commanded, constant ambient light, no laser on when off.

A check has one of three results: the shot is good; it has a problem that another attempt may remove (a `DeviceError`);
or a laser is on that should be off, which ends the capture at once (a `LaserSafetyError`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ringpose.capture import laser_check
from ringpose.capture.ambient import LOST_SHARE_OF_FULL, AmbientChange, ambient_change, same_ambient_light
from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.hdr import scaled_like
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.errors import DeviceError, LaserSafetyError
from ringpose.types.image import Frame, Shot

TRIES = 3
"""Attempts at one shot with a problem of camera or lasers before the capture ends with that problem."""

MAX_LOST = 10
"""Attempts at one shot that may be lost to changing ambient light before the capture ends."""

DARK_CHECK_S = 0.2
"""Wait after switching everything off before a laser that is still seen counts as a fault: enough for any relay."""

DARK_CHECKS = 4
"""Dark frames to search for a laser while ambient light changes, which may outshine it in some of them."""


class MissingLasers(DeviceError):
    """Lasers that were commanded but are not seen in any frame."""

    def __init__(self, lasers: int, times: int = 1) -> None:
        self.lasers = lasers
        often = f"{times} times" if times > 1 else "once"
        remedy = "does it shine, on the target? wait longer (--settle), or expose longer (--exposure)"
        super().__init__("lasers", f"{laser_list(lasers)} commanded but not seen, {often}", remedy)


class AmbientLightChanged(DeviceError):
    """Ambient light changed while a shot was taken; a longer settling time would not help."""

    def __init__(self, changes: Sequence[AmbientChange], missing: int = 0) -> None:
        self.changes = changes
        largest = max(changes, key=lambda change: abs(change.size_dn))
        size = f"by up to {abs(largest.size_dn):.0f} dn ({100 * largest.share_of_full:.0f} % of the full grey value)"
        shots = "the shot" if len(changes) == 1 else f"each of {len(changes)} shots in a row"
        finding = f"changed within {shots}, {size}"
        if missing and len(changes) >= TRIES:  # in fewer, the changes themselves may hide a laser that shines
            finding += f", and {laser_list(missing)} not seen in any of them"
        remedy = "shield the scene, or take shorter shots (--sequence off,all; lasers at line:)"
        if all(change.only_with_lasers for change in changes):
            remedy += "; if it is stray light of the lasers, expose shorter"
        super().__init__("ambient light", finding, remedy)


class ShotChecker:
    """Checks the shots of one capture; remembers which pixels each laser lit in the last shot that showed it."""

    def __init__(self, camera: CameraDriver, lasers: LaserDriver, *, must_see: bool) -> None:
        self._camera = camera
        self._lasers = lasers
        self._must_see = must_see
        self._pixels: dict[int, laser_check.LitPixels] = {}
        self._last_shot: Shot | None = None
        """The last shot that was checked; its scale is that of the pixels."""

    def checked(self, shot: Shot) -> tuple[Shot, DeviceError | None]:
        """The shot with the masks seen in its images, and the problem that another attempt may remove."""
        reported = 0 if shot.read_lasers is None else int(np.bitwise_or.reduce(shot.read_lasers & ~shot.lasers))
        if reported:
            self._check_reported_off()
            return shot, DeviceError("lasers", f"{laser_list(reported)} reported on in frames of others")
        self._last_shot = shot
        seen, pixels = laser_check.seen_lasers(shot)
        if seen is None:
            return shot, None
        extra = int(np.bitwise_or.reduce(seen & ~shot.lasers))
        missing = int(np.bitwise_or.reduce(shot.lasers & ~seen))
        is_wrong = bool(extra or (missing and self._must_see))
        change = ambient_change(shot)
        if change is not None and (is_wrong or change.share_of_full > LOST_SHARE_OF_FULL):
            return shot, AmbientLightChanged([change])
        # A laser that is always on makes no difference between frames: use where an earlier shot has seen it.
        remembered = {laser: self._pixels[laser] for laser in self._pixels if laser not in pixels}
        self._pixels |= pixels
        suspects = {laser: lit for laser, lit in (pixels | remembered).items() if (extra | missing) >> laser & 1}
        if suspects:
            _reject_lit(suspects, self._dark_image(shot))
        diffuse_dn = laser_check.diffuse_light_dn(shot, seen, pixels)
        if diffuse_dn:
            share = diffuse_dn / shot.usual_full_dn
            return shot, AmbientLightChanged([AmbientChange(size_dn=diffuse_dn, share_of_full=share)])
        kept_change = {} if change is None else {"ambient_change_dn": change.size_dn}
        checked = replace(shot, seen_lasers=seen, meta={**shot.meta, **kept_change})
        if extra:
            return checked, DeviceError("lasers", f"{laser_list(extra)} seen in frames of others", "raise --settle")
        if missing and self._must_see:
            return checked, MissingLasers(missing)
        return checked, None

    def never_seen(self, shot: Shot, lost_attempts: int) -> int:
        """The mask of the lasers of a lost shot that no shot has shown, after `lost_attempts` lost ones in a row.

        Raises a safety fault if a laser is on in frames in which it should be off, and remains on.
        """
        same_light = same_ambient_light(shot.images, shot.usual_full_dn)
        self._pixels, suspects = laser_check.lasers_out_of_sequence(shot, self._pixels, same_light)
        for _ in range(DARK_CHECKS if suspects else 0):
            _reject_lit(suspects, self._dark_image(shot))
        never_seen = self._not_remembered(int(np.bitwise_or.reduce(shot.lasers)))
        if never_seen and lost_attempts in (TRIES, MAX_LOST):
            # A stripe that is present in every frame, dark ones included, stays in the minimum over all of them.
            _reject_stripe(never_seen, np.minimum.reduce([*shot.images, self._dark_image(shot)]))
        return never_seen

    def unseen(self, shot: Shot) -> int:
        """The mask of the lasers that a checked shot commanded and that were seen neither in it nor before."""
        if shot.seen_lasers is None:
            return 0
        return self._not_remembered(int(np.bitwise_or.reduce(shot.lasers & ~shot.seen_lasers)))

    def reject_stripe_in_dark(self, missing: int) -> None:
        """Raise a safety fault if a stripe shows with all lasers off while the lasers of the mask are missing."""
        if missing:
            _reject_stripe(missing, _dark_frame(self._camera, self._lasers).image)

    def reject_lasers_in_dark(self, commanded: int) -> None:
        """Raise a safety fault if one of these lasers is on with all off, where shots broke off before their check.

        A laser that an earlier shot has shown is searched for where it was; any other may be a stripe that shows.
        """
        frame = _dark_frame(self._camera, self._lasers)
        known = {laser: pixels for laser, pixels in self._pixels.items() if commanded >> laser & 1}
        if known and self._last_shot is not None:
            _reject_lit(known, scaled_like(frame.image, frame.exposure_s, self._last_shot))
        unknown = self._not_remembered(commanded)
        if unknown:
            _reject_stripe(unknown, frame.image)

    def _not_remembered(self, mask: int) -> int:
        """The lasers of a mask of which no pixels are known, as no shot has shown them."""
        return mask & ~sum(1 << laser for laser in self._pixels)

    def _check_reported_off(self) -> None:
        """Raise a safety fault if the board still reports a laser on after all have been off for long enough."""
        self._lasers.set_mask(0)
        self._lasers.wait(DARK_CHECK_S)
        reported = self._lasers.read_mask()
        if reported:
            raise LaserSafetyError("lasers", f"{laser_list(reported)} reported on while all are off", "cut the power")

    def _dark_image(self, shot: Shot) -> laser_check.Image:
        """An image with all lasers off, on the grey-value scale of a shot."""
        frame = _dark_frame(self._camera, self._lasers)
        return scaled_like(frame.image, frame.exposure_s, shot)


def require_off(
    camera: CameraDriver,
    lasers: LaserDriver,
    laser: int,
    pixels: laser_check.LitPixels | None,
    wait_s: float,
    exposure_s: float | None = None,
) -> laser_check.Image:
    """An image with all lasers off, taken `wait_s` after they were switched off.

    Raises `LaserSafetyError` if it shows the laser that was on alone before, by the `pixels` that it lit; or, if that
    laser was not seen (None), if it shows any stripe, as the laser may be on all the time. Ambient light may change.
    """
    image = _dark_frame(camera, lasers, wait_s, exposure_s).image
    if pixels is None:
        _reject_stripe(1 << laser, image)
    else:
        _reject_lit({laser: pixels}, image, by_lamp=False)
    return image


def _dark_frame(
    camera: CameraDriver, lasers: LaserDriver, wait_s: float = DARK_CHECK_S, exposure_s: float | None = None
) -> Frame:
    """A frame after all lasers have been off for a while, to check that they are."""
    lasers.set_mask(0)
    lasers.wait(wait_s)
    try:
        return camera.trigger(0, exposure_s)
    except DeviceError as error:
        finding = f"may be on, and the camera that was to check them failed: {error}"
        raise LaserSafetyError("lasers", finding, "cut the power") from error


def laser_list(mask: int) -> str:
    """Subject and verb of a message, lasers counted from 1: `laser 2 was`, `lasers 1, 3 were`."""
    numbers = [str(laser + 1) for laser in range(mask.bit_length()) if mask >> laser & 1]
    return f"laser {numbers[0]} was" if len(numbers) == 1 else f"lasers {', '.join(numbers)} were"


def _reject_lit(
    pixels: Mapping[int, laser_check.LitPixels], dark_image: laser_check.Image, *, by_lamp: bool = True
) -> None:
    """Raise a safety fault if the dark image shows lasers by the pixels that they have lit (see `are_on_in`)."""
    mask = sum(1 << laser for laser, lit in pixels.items() if lit.are_on_in(dark_image, by_lamp=by_lamp))
    if mask:
        raise LaserSafetyError("lasers", f"{laser_list(mask)} seen while all are off", "cut the power")


def _reject_stripe(missing: int, dark_image: laser_check.Image) -> None:
    """Raise a safety fault if the dark image shows a stripe: one of the missing lasers may be on all the time."""
    if laser_check.shows_stripe(dark_image):
        finding = f"{laser_list(missing)} not seen to go on or off, and a stripe shows while all are off"
        raise LaserSafetyError("lasers", finding, "cut the power; a line that stays then is not a laser's")
