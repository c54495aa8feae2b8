"""Shots of a simulated camera (`DrawnCamera`) with lasers that relays switch: a virtual board, or contacts alone."""

import numpy as np
import pytest
from drawn_camera import ContactLasers, DrawnCamera
from guarded_lasers import BOARDS, PATIENT, LinkedRelays, lasers_at

from ringpose.capture.lasers.driver import LasersWentOff
from ringpose.capture.pipeline import Procedure, captured_shots
from ringpose.errors import DeviceError, LaserSafetyError
from ringpose.simulate.serve.relays import RelayFaults
from ringpose.types.session import parsed_sequence

IN_TURN = "off,1,2,3,off"


def procedure(sequence=IN_TURN, settle_s=0.005, must_see=True):
    return Procedure(steps=parsed_sequence(sequence), settle_s=settle_s, must_see=must_see)


@pytest.fixture
def shots_of(drawn_devices):
    """Takes shots with lasers that have injected faults; returns the shots and the camera."""

    def taken(how, faults=None, names=("a",), longest_on_s=None, **camera_options):
        camera, lasers = drawn_devices(faults, **camera_options)
        lasers.longest_on_s = longest_on_s
        with camera, lasers:
            return list(captured_shots(camera, lasers, how, names)), camera

    return taken


@pytest.mark.parametrize(
    ("scheme", "count"), [*((scheme, 3) for scheme in BOARDS), ("lcus", 1), ("lcus", 2), ("lcus", 5), ("lcus", 8)]
)
def test_commanded_reported_and_seen_masks_agree(rng, tmp_path, scheme, count):
    codec, text = BOARDS[scheme]
    with LinkedRelays(tmp_path, codec, relays=range(count)) as relays:
        uri = text.format(port=relays.port, channels=relays.channels) + PATIENT
        camera = DrawnCamera(relays.contacts, rng)
        sequence = ",".join(["off", *(str(number + 1) for number in range(count)), "all", "off"])
        with camera, lasers_at(uri) as lasers:
            (shot,) = captured_shots(camera, lasers, procedure(sequence), ["a"])

    masks = [0, *(1 << number for number in range(count)), (1 << count) - 1, 0]
    assert shot.lasers.tolist() == masks
    assert shot.read_lasers.tolist() == masks
    assert shot.seen_lasers.tolist() == masks


@pytest.mark.parametrize("sequence", ["off,all", "off,1,2,3,1+2,all,off", "off,1+2", "off,2"])
def test_several_lasers_at_once_are_seen(shots_of, sequence):
    (shot,), _ = shots_of(procedure(sequence))

    assert shot.seen_lasers.tolist() == shot.lasers.tolist()


@pytest.mark.parametrize("sequence", ["all", "1,2,3"])
def test_without_a_dark_frame_no_lasers_are_reported_as_seen(shots_of, sequence):
    (shot,), _ = shots_of(procedure(sequence))

    assert shot.seen_lasers is None


def test_relays_that_follow_late_are_waited_for(shots_of):
    late = RelayFaults(operate_s=0.008, release_s=0.008)

    shots, camera = shots_of(procedure(settle_s=0.0), late, names="abc")

    assert [shot.seen_lasers.tolist() for shot in shots] == [[0, 1, 2, 4, 0]] * 3
    assert 3 * 5 < camera.taken < 3 * 5 + 15


def test_a_laser_that_is_hidden_now_and_then_does_not_make_the_capture_slower(drawn_devices):
    settles_s = []
    camera, lasers = drawn_devices()
    with camera, lasers:
        for number, shot in enumerate(captured_shots(camera, lasers, procedure(settle_s=0.01), "abcde")):
            settles_s.append(shot.meta["settle_s"])
            camera.hidden = {camera.taken + 2} if number % 2 == 0 else set()

    assert settles_s == [0.01, 0.02, 0.01, 0.02, 0.01]


def test_lasers_are_waited_for_no_longer_than_the_watchdog_allows(shots_of):
    (shot,), _ = shots_of(procedure("off,1", settle_s=0.13), RelayFaults(late_s={0: 0.23}), longest_on_s=0.5)

    assert shot.meta["settle_s"] == pytest.approx(0.25)  # half is left for a busy machine


def test_every_image_shows_the_lasers_of_its_mask_and_no_other(shots_of):
    late = RelayFaults(operate_s=0.01, release_s=0.01, late_s={1: 0.02})

    shots, _ = shots_of(procedure(settle_s=0.0), late, names="abc")

    stripes = np.array([shot.images[:, [11, 26, 41], 100] > 80 for shot in shots])
    truth = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]], dtype=bool)
    assert np.array_equal(stripes, np.broadcast_to(truth, stripes.shape))


def test_a_laser_that_stays_dark_is_an_error_after_three_attempts(shots_of):
    with pytest.raises(DeviceError, match="laser 2 was commanded but not seen, 3 times; does it shine"):
        shots_of(procedure(), RelayFaults(dead=frozenset({1})))


def test_a_laser_that_stays_dark_may_be_allowed_to(shots_of):
    (shot,), _ = shots_of(procedure(must_see=False), RelayFaults(dead=frozenset({1})))

    assert shot.seen_lasers.tolist() == [0, 1, 0, 4, 0]


@pytest.mark.parametrize("must_see", [True, False])
def test_a_welded_contact_is_a_safety_fault_though_the_board_reports_it_open(shots_of, must_see):
    with pytest.raises(LaserSafetyError, match=r"laser 2 was .*while all are off; cut the power"):
        shots_of(procedure(must_see=must_see), RelayFaults(stuck=frozenset({1})))


def test_a_contact_that_welds_in_an_attempt_that_is_cut_off_is_a_safety_fault(shots_of):
    """The third frame is lost, in which the laser would have been seen for the first time."""
    with pytest.raises(LaserSafetyError, match=r"laser 2 was .*while all are off"):
        shots_of(procedure(must_see=False), RelayFaults(stuck=frozenset({1})), lost=(3,))


def test_a_contact_that_welds_between_two_shots_is_a_safety_fault(drawn_devices):
    camera, lasers = drawn_devices()
    with camera, lasers:
        shots = captured_shots(camera, lasers, procedure(), ["a", "b"])
        next(shots)
        lasers.contacts.faults = RelayFaults(stuck=frozenset({2}))
        lasers.contacts.command(2, True, 0.0)

        with pytest.raises(LaserSafetyError, match="laser 3 was seen while all are off"):
            next(shots)


def test_a_laser_that_burns_from_the_beginning_is_a_safety_fault(shots_of):
    with pytest.raises(LaserSafetyError, match="laser 1 was not seen to go on or off, and a stripe shows"):
        shots_of(procedure(), RelayFaults(welded=frozenset({0})))


class WatchedLasers(ContactLasers):
    """Lasers with a watchdog that switches off, in virtual time, when no command has come for a second."""

    longest_on_s = 1.0

    def set_mask(self, lasers):
        if lasers:
            self._check()
        super().set_mask(lasers)
        self.commanded_s = self.clock.monotonic()

    def read_mask(self):
        self._check()
        self.commanded_s = self.clock.monotonic()
        return super().read_mask()

    def _check(self):
        if self.on_mask and self.clock.monotonic() > self.commanded_s + 1.0:
            super().set_mask(0)
            raise LasersWentOff("board", "the watchdog switched the lasers off: no command came for 1 s")


@pytest.fixture
def watched_devices(drawn_devices):
    """Creates a camera whose frames take as long as on a busy machine from number `slow_from` on, and its lasers."""

    def created(slow_from, **faults):
        camera, lasers = drawn_devices(RelayFaults(**faults), slow_from=slow_from)
        return camera, WatchedLasers(camera.contacts, lasers.clock)

    return created


WENT_OFF = r"the watchdog switched the lasers off: no command came for 1 s"


@pytest.mark.parametrize("sequence", [IN_TURN, "off,all,1,2,3,off"])
def test_a_dark_laser_is_named_though_later_attempts_are_too_slow(watched_devices, sequence):
    frames = sequence.count(",") + 1
    camera, lasers = watched_devices(slow_from=frames + 1, dead=frozenset({1}))

    with (
        camera,
        lasers,
        pytest.raises(DeviceError, match=rf"laser 2 was commanded but not seen, once; .*\(then: board: {WENT_OFF}\)"),
    ):
        list(captured_shots(camera, lasers, procedure(sequence), ["a"]))


@pytest.mark.parametrize("fault", ["stuck", "welded"])
@pytest.mark.parametrize("whole", [0, 1, 2])
def test_a_welded_contact_is_a_safety_fault_though_attempts_are_too_slow(watched_devices, fault, whole):
    """Without a whole attempt no check of a shot is made."""
    camera, lasers = watched_devices(slow_from=5 * whole + 1, **{fault: frozenset({0})})

    with camera, lasers, pytest.raises(LaserSafetyError, match=r"laser.* 1.* while all are off"):
        list(captured_shots(camera, lasers, procedure(), ["a"]))


def test_a_contact_that_welds_after_a_shot_is_a_safety_fault_though_attempts_are_too_slow(watched_devices):
    camera, lasers = watched_devices(slow_from=6)
    with camera, lasers:
        shots = captured_shots(camera, lasers, procedure(), ["a", "b"])
        next(shots)
        lasers.contacts.faults = RelayFaults(stuck=frozenset({0}))

        with pytest.raises(LaserSafetyError, match="laser 1 was seen while all are off"):
            next(shots)


def test_a_machine_that_is_too_slow_is_no_fault_of_the_lasers(watched_devices):
    camera, lasers = watched_devices(slow_from=1)

    with camera, lasers, pytest.raises(DeviceError, match=f"^board: {WENT_OFF}$"):
        list(captured_shots(camera, lasers, procedure(), ["a"]))


@pytest.mark.parametrize("lost", [(6, 7), (6,)])
def test_a_dark_laser_is_named_though_the_camera_is_lost_afterwards(drawn_devices, lost):
    camera, lasers = drawn_devices(RelayFaults(dead=frozenset({1})), lost=lost, reopens=len(lost) > 1)

    with (
        camera,
        lasers,
        pytest.raises(DeviceError, match=r"laser 2 was commanded but not seen, once; .*\(then: camera: "),
    ):
        list(captured_shots(camera, lasers, procedure(), ["a"]))


@pytest.mark.parametrize("frame", [2, 4, 7])
def test_a_camera_that_comes_back_loses_no_shot(shots_of, frame):
    shots, camera = shots_of(procedure(), names="ab", lost=[frame])

    assert [shot.name for shot in shots] == ["a", "b"]
    assert [shot.seen_lasers.tolist() for shot in shots] == [[0, 1, 2, 4, 0]] * 2
    assert camera.opened == 2


def test_a_camera_that_is_lost_between_two_shots_loses_none(drawn_devices):
    taken = []
    camera, lasers = drawn_devices()
    with camera, lasers:
        for shot in captured_shots(camera, lasers, procedure(), "ab"):
            taken.append(shot.name)
            camera.away = True

    assert (taken, camera.opened) == (["a", "b"], 2)


def test_a_camera_that_stays_away_ends_the_capture_with_the_lasers_off(drawn_devices):
    camera, lasers = drawn_devices(lost=[3], reopens=False)
    with camera, lasers:
        with pytest.raises(DeviceError, match="is gone"):
            list(captured_shots(camera, lasers, procedure(), ["a"]))

        assert lasers.contacts.mask_at(float("inf")) == 0


def test_two_exposures_of_a_laser_become_one_frame(shots_of):
    (shot,), camera = shots_of(procedure("off@2ms,off@8ms,1@2ms,1@8ms,2@2ms,2@8ms"), brightness_dn=120.0)

    assert camera.taken == 6
    assert shot.lasers.tolist() == [0, 1, 2]
    assert shot.seen_lasers.tolist() == [0, 1, 2]
    assert shot.images.dtype == np.uint16


def test_the_settling_time_is_measured_once(shots_of):
    shots, _ = shots_of(procedure(settle_s=None), RelayFaults(operate_s=0.015, release_s=0.03), names="ab")

    settle_s = shots[0].meta["settle_s"]
    assert settle_s > 0.03
    assert [shot.meta["settle_s"] for shot in shots] == [settle_s] * 2
    assert [shot.seen_lasers.tolist() for shot in shots] == [[0, 1, 2, 4, 0]] * 2


def test_what_does_not_show_cannot_be_measured(shots_of):
    with pytest.raises(DeviceError, match="no laser shows in the image"):
        shots_of(procedure(settle_s=None), RelayFaults(dead=frozenset({0, 1, 2})))
