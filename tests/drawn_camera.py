"""A simulated camera that draws a stripe for each laser that was on during the exposure, and lasers without a board."""

import time

import numpy as np
from drawn_scene import exposed, noise
from fake_camera import FakeCamera

from ringpose.capture.lasers.driver import LaserDriver
from ringpose.errors import DeviceError
from ringpose.types.image import Frame

HEIGHT, WIDTH = 130, 200


class DrawnCamera(FakeCamera):
    """Ambient 10 DN, stripes of `brightness_dn` at 5 ms; `lost` numbers the frames at which it fails.

    Frames from number `slow_from` on take two seconds more to arrive, as on a busy machine.
    In the frames that `hidden` numbers something stands before the lasers. Once it is `away` it has to be opened anew.
    """

    image_width, image_height = WIDTH, HEIGHT

    def __init__(self, contacts, rng, brightness_dn=150.0, lost=(), reopens=True, slow_from=None):
        self.contacts, self.rng, self.brightness_dn = contacts, rng, brightness_dn
        self.lost, self.reopens, self.hidden, self.away = set(lost), reopens, set(), False
        self.slow_from = np.inf if slow_from is None else slow_from
        self.taken, self.opened, self.triggered_s = 0, 0, []
        self._exposure_s = 0.005

    def open(self):
        self.opened += 1
        if self.opened > 1 and not self.reopens:
            raise DeviceError("camera", "is gone")
        self.away = False

    def arm(self, exposure_s):
        if self.away:
            raise DeviceError("camera", "went away")
        self._exposure_s = exposure_s or 0.005

    def trigger(self, lasers, exposure_s=None):
        self.taken += 1
        if self.taken in self.lost:
            raise DeviceError("camera", "went away")
        exposed_s = exposure_s or self._exposure_s
        began_s, stamp_s = time.monotonic(), time.time()
        self.triggered_s.append(began_s)
        time.sleep(exposed_s)
        shares = self.contacts.shares(began_s, began_s + exposed_s)
        light = np.full((HEIGHT, WIDTH), 10.0, dtype=np.float32)
        for laser, share in enumerate(() if self.taken in self.hidden else shares):
            light[10 + 15 * laser : 13 + 15 * laser, 20:180] += self.brightness_dn * share
        grey = 2.0 + light * exposed_s / 0.005
        image = exposed(grey + noise(grey.shape, self.rng) * np.sqrt(0.5 + 0.05 * grey))
        time.sleep(2.0 if self.taken >= self.slow_from else 0.0)
        return Frame(image=image, lasers=lasers, stamp_s=stamp_s, exposure_s=exposed_s)


class ContactLasers(LaserDriver):
    """Lasers switched by relay contacts in the time of a clock; `on_mask` is what was commanded, as a board reports."""

    count, longest_on_s = 3, None

    def __init__(self, contacts, clock, reports=True):
        self.contacts, self.clock, self.reports, self.on_mask = contacts, clock, reports, 0

    def set_mask(self, lasers):
        for laser in range(self.count):
            if (lasers ^ self.on_mask) >> laser & 1:
                self.contacts.command(laser, bool(lasers >> laser & 1), self.clock.monotonic())
        self.on_mask = lasers

    def read_mask(self):
        return self.on_mask if self.reports else None

    def close(self):
        pass
