"""Shots while ambient light changes: lost shots are repeated, and the checks of the lasers remain effective."""

import numpy as np
import pytest
from fake_camera import FakeCamera

from ringpose.capture.ambient import lost_attempts_dn
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.pipeline import Procedure, captured_shots
from ringpose.errors import DeviceError, LaserSafetyError
from ringpose.types.image import Frame
from ringpose.types.session import parsed_sequence

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


IN_TURN = "off,1,2,3,off"


def lost_in(scene, lost):
    """Takes shots of which those that are lost are yielded, into a list."""
    procedure = Procedure(steps=parsed_sequence(IN_TURN), settle_s=0.05, must_see=True, yields_lost=True)
    for shot in captured_shots(scene, scene, procedure, map(str, range(20))):
        lost.append(shot)


def shots_of(scene, count=3, sequence=IN_TURN, settle_s=0.05, must_see=True):
    procedure = Procedure(steps=parsed_sequence(sequence), settle_s=settle_s, must_see=must_see)
    return list(captured_shots(scene, scene, procedure, map(str, range(count))))


def lost_of(shots):
    return sum(len(lost_attempts_dn(shot.meta)) for shot in shots)


@pytest.mark.parametrize("half_period_s", [0.45, 1.0])
@pytest.mark.parametrize("eighth", [0, 3, 6])
def test_a_beacon_costs_shots_but_spoils_none(rng, half_period_s, eighth):
    phase_s = eighth / 4 * half_period_s
    scene = BlinkingScene(rng, on_s=half_period_s, off_s=half_period_s, phase_s=phase_s)

    shots = shots_of(scene, count=2)

    assert [shot.name for shot in shots] == ["0", "1"]
    for shot in shots:
        assert shot.seen_lasers.tolist() == [0, 1, 2, 4, 0]
        assert len({bool(scene.is_on(stamp_s)) for stamp_s in shot.stamp_s}) == 1
        assert shot.meta["settle_s"] == 0.05


@pytest.mark.parametrize(("on_s", "off_s"), [(0.05, 0.95), (0.01, 0.4)])
def test_a_flash_within_a_shot_is_recognised_though_its_dark_frames_agree(rng, on_s, off_s):
    scene = BlinkingScene(rng, on_s=on_s, off_s=off_s, phase_s=100.115)

    shots = shots_of(scene, count=2)

    assert lost_of(shots) >= 1
    for shot in shots:
        assert shot.seen_lasers.tolist() == [0, 1, 2, 4, 0]
        assert not any(scene.is_on(stamp_s) for stamp_s in shot.stamp_s)


@pytest.mark.parametrize("phase_s", [100.06, 100.2])
def test_a_lamp_on_a_twentieth_of_the_image_is_not_taken_for_lasers(rng, phase_s):
    scene = BlinkingScene(rng, line_dn=30.0, on_s=0.15, off_s=0.85, phase_s=phase_s, patch=np.s_[56:84, 20:60])

    shots = shots_of(scene, count=2)

    for shot in shots:
        assert shot.seen_lasers.tolist() == [0, 1, 2, 4, 0]
        assert shot.meta["settle_s"] == 0.05


def test_lost_shots_are_noted_with_the_change_in_grey_values(rng):
    scene = BlinkingScene(rng, lamp_dn=60.0, on_s=1.0, off_s=1.0, phase_s=100.15)

    (shot,) = shots_of(scene, count=1)

    (change_dn,) = lost_attempts_dn(shot.meta)
    assert change_dn == pytest.approx(60.0 * 0.75, rel=0.15)  # the surface returns 0.5 to 1


def test_a_small_change_spoils_nothing_and_is_noted(rng):
    scene = BlinkingScene(rng, lamp_dn=12.0, on_s=1.0, off_s=1.0, phase_s=100.15)

    (shot,) = shots_of(scene, count=1)

    assert shot.seen_lasers.tolist() == [0, 1, 2, 4, 0]
    assert lost_of([shot]) == 0
    assert shot.meta["ambient_change_dn"] == pytest.approx(12.0 * 0.75, rel=0.2)


@pytest.mark.parametrize(("share", "is_lost"), [(0.15, False), (0.5, True), (0.85, True)])
def test_a_lamp_that_goes_on_within_the_last_exposure_is_noted_or_costs_the_shot(rng, share, is_lost):
    (steady,) = shots_of(BlinkingScene(rng, on_s=1e-9, off_s=1e9), count=1)
    on_s = float(steady.stamp_s[-1] + (1.0 - share) * steady.exposure_s[-1])

    (shot,) = shots_of(BlinkingScene(rng, on_s=1.0, off_s=1e9, phase_s=on_s), count=1)

    assert lost_of([shot]) == is_lost
    assert ("ambient_change_dn" in shot.meta) != is_lost


def test_one_dark_frame_is_enough_to_recognise_a_change_behind_it(rng):
    scene = BlinkingScene(rng, on_s=1.0, off_s=1.0, phase_s=100.06)

    (shot,) = shots_of(scene, count=1, sequence="off,all")

    assert lost_of([shot]) == 1
    assert shot.seen_lasers.tolist() == [0, 7]


def test_light_that_changes_in_every_shot_ends_the_capture_and_is_named(rng):
    scene = BlinkingScene(rng, on_s=0.2, off_s=0.2)

    with pytest.raises(DeviceError, match=r"ambient light: changed .* 10 shots.*off,all") as caught:
        shots_of(scene)

    assert "settle" not in str(caught.value)
    assert not isinstance(caught.value, LaserSafetyError)


def test_a_live_shot_that_is_lost_is_yielded_and_states_it(rng):
    scene, shots = BlinkingScene(rng, on_s=1.0, off_s=1.0, phase_s=100.15), []

    lost_in(scene, shots)

    assert [shot.name for shot in shots] == [str(number) for number in range(20)]
    assert 0 < sum(shot.is_lost for shot in shots) < 20
    for shot in shots:
        assert shot.is_lost == (len({bool(scene.is_on(stamp_s)) for stamp_s in shot.stamp_s}) > 1)
    assert lost_of(shots) == 0


def test_ten_live_shots_lost_in_a_row_end_the_measurement(rng):
    shots = []

    with pytest.raises(DeviceError, match=r"ambient light: changed .* 10 shots"):
        lost_in(BlinkingScene(rng, on_s=0.2, off_s=0.2), shots)

    assert len(shots) == 9
    assert all(shot.is_lost and shot.ambient_changed for shot in shots)


def test_a_surface_that_moves_in_steady_light_loses_no_shot(rng):
    shots = shots_of(BlinkingScene(rng, on_s=1e9, speed_px_s=20.0), count=3)

    assert lost_of(shots) == 0
    assert not any("ambient_change_dn" in shot.meta for shot in shots)


@pytest.mark.parametrize(
    ("fault", "laser", "must_see"),
    [("welded", 0, True), ("welded", 1, True), ("sticking", 1, True), ("sticking", 0, False), ("sticking", 2, False)],
)
@pytest.mark.parametrize(
    ("half_period_s", "phase_s"),
    [
        (0.45, 100.1),
        *(pytest.param(*times, marks=pytest.mark.slow) for times in ((0.45, 100.3), (1, 100.2), (0.2, 100))),
    ],
)
def test_a_beacon_does_not_excuse_a_laser_that_burns(rng, fault, laser, must_see, half_period_s, phase_s):
    scene = BlinkingScene(rng, on_s=half_period_s, off_s=half_period_s, phase_s=phase_s)
    setattr(scene, fault, 1 << laser)

    with pytest.raises(LaserSafetyError, match=f"laser {laser + 1} was .* while all are off"):
        shots_of(scene, must_see=must_see)


@pytest.mark.parametrize("phase_s", [100.0, pytest.param(100.2, marks=pytest.mark.slow), 100.3])
def test_a_beacon_that_outshines_a_laser_does_not_excuse_it(rng, phase_s):
    scene = BlinkingScene(rng, lamp_dn=600.0, on_s=0.2, off_s=0.2, phase_s=phase_s)
    scene.sticking = 1

    with pytest.raises(LaserSafetyError, match=r"laser 1 was .* while all are off"):
        shots_of(scene)


@pytest.mark.parametrize("must_see", [True, False])
def test_a_laser_that_sticks_later_is_found_by_its_places(rng, must_see):
    scene = BlinkingScene(rng, on_s=0.2, off_s=1e9, phase_s=100.45)  # changes in the second shot, and then once more
    procedure = Procedure(steps=parsed_sequence(IN_TURN), settle_s=0.05, must_see=must_see)
    shots = captured_shots(scene, scene, procedure, ["a", "b"])
    assert next(shots).seen_lasers.tolist() == [0, 1, 2, 4, 0]
    scene.welded = 2

    with pytest.raises(LaserSafetyError, match="laser 2 was seen while all are off"):
        next(shots)


def test_a_laser_that_stays_dark_is_named_beside_the_light(rng):
    scene = BlinkingScene(rng, on_s=0.2, off_s=0.2)
    scene.dead = 2

    with pytest.raises(DeviceError, match=r"ambient light: .*laser 2 was not seen") as caught:
        shots_of(scene)

    assert not isinstance(caught.value, LaserSafetyError)


def test_a_late_laser_beside_steady_light_is_still_late(rng):
    class Late(BlinkingScene):
        """Lasers that go off 0.1 s after the command."""

        off_at_s, before = 0.0, 0

        def set_mask(self, lasers):
            self.before, self.off_at_s = self._mask, self.now_s + 0.1
            super().set_mask(lasers)

        def trigger(self, lasers, exposure_s=None):
            commanded = self._mask
            if self.now_s < self.off_at_s:
                self._mask |= self.before
            frame = super().trigger(lasers, exposure_s)
            self._mask = commanded
            return frame

    (shot,) = shots_of(Late(rng, on_s=1e9), count=1)

    assert shot.meta["settle_s"] > 0.09
    assert lost_of([shot]) == 0
    np.testing.assert_array_equal(shot.seen_lasers, shot.lasers)
