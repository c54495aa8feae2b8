"""A textured surface under a blinking lamp with three laser lines, and a clock that only the devices advance."""

import numpy as np
from fake_camera import FakeCamera

from ringpose.capture.lasers.driver import LaserDriver
from ringpose.types.image import Frame

HEIGHT, WIDTH = 120, 160

EXPOSURE_S = 0.002

FRAME_S = 0.013
"""From one trigger to the next, at least."""


class BlinkingScene(FakeCamera, LaserDriver):
    """Camera and lasers in one; 8-bit images of 5 DN without light, lines of `line_dn`, a lamp of up to `lamp_dn`.

    The lamp is on from `phase_s` on for `on_s`, then off for `off_s`, and lights the `patch` of the image. Lasers
    of the mask `welded` are always on, those of `sticking` from their first lighting on, those of `dead` never.
    """

    count = 3
    settle_s = 0.05
    image_width, image_height = WIDTH, HEIGHT

    def __init__(
        self, rng, lamp_dn=60.0, on_s=0.45, off_s=0.45, phase_s=0.0, line_dn=120.0, speed_px_s=0.0, patch=np.s_[:, :]
    ):
        self.rng, self.on_s, self.off_s, self.phase_s = rng, on_s, off_s, phase_s
        self.line_dn, self.speed_px_s = line_dn, speed_px_s
        self.welded = self.sticking = self.dead = 0
        self.now_s, self.taken, self._mask = 100.0, 0, 0
        self.surface = np.kron(rng.uniform(0.5, 1.0, (HEIGHT // 5, WIDTH // 5)), np.ones((5, 5)))
        self.lamp = np.zeros((HEIGHT, WIDTH))
        self.lamp[patch] = lamp_dn

    def is_on(self, time_s):
        """Whether the lamp is on at a time."""
        return (time_s - self.phase_s) % (self.on_s + self.off_s) < self.on_s

    def set_mask(self, lasers):
        self.now_s += 0.002
        self._mask = (lasers | self.welded) & ~self.dead
        self.welded |= self._mask & self.sticking

    def read_mask(self):
        return None

    def wait(self, duration_s):
        self.now_s += duration_s

    def trigger(self, lasers, exposure_s=None):
        began_s, self.taken = self.now_s, self.taken + 1
        self.now_s += EXPOSURE_S + FRAME_S
        times_s = began_s + EXPOSURE_S * (np.arange(20) + 0.5) / 20
        surface = np.roll(self.surface, round(self.speed_px_s * (began_s - 100.0)), axis=1)
        light = 5.0 + surface * (10.0 + self.lamp * np.mean(self.is_on(times_s)))
        for laser in range(3):
            if self._mask >> laser & 1:
                light[25 + 30 * laser : 28 + 30 * laser, 10:150] += self.line_dn
        noisy = light + self.rng.standard_normal(light.shape) * np.sqrt(0.5 + 0.02 * light)
        image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return Frame(image=image, lasers=lasers, stamp_s=began_s, exposure_s=EXPOSURE_S)
