"""Exposures of the virtual camera: lasers that are on for part of an exposure, and the sequence of views."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from served_scene import small_scene

from ringpose.simulate.renderer import RenderedView
from ringpose.simulate.serve.relays import RelayContacts, RelayFaults
from ringpose.simulate.serve.views import MovingViews, SceneExposures, ring_moving_views
from ringpose.types.options import AdvancePolicy
from ringpose.types.scene import Beacon, Light, Sensor


@pytest.fixture
def scene(tmp_path):
    return small_scene(tmp_path)


def exposures(scene, contacts: RelayContacts, warm_up_s: float = 0.0) -> SceneExposures:
    return SceneExposures(ring_moving_views(scene, AdvancePolicy.NEVER, 0.0), scene.sensor, contacts, warm_up_s)


@pytest.mark.parametrize(
    ("on_s", "off_s", "share"),
    [(0.0, 99.0, 1.0), (2.0, 99.0, 0.0), (1.005, 99.0, 0.5), (0.0, 1.0025, 0.25), (1.0, 1.0, 0.0)],
    ids=["on", "too late", "half", "a quarter", "never"],
)
def test_a_laser_contributes_for_the_time_that_it_is_on(scene, on_s, off_s, share):
    contacts = RelayContacts(3)
    contacts.command(1, True, on_s)
    contacts.command(1, False, off_s)

    with exposures(scene, contacts) as seen:
        shares = seen.laser_shares(1.0, 0.01)

    np.testing.assert_allclose(shares, [0.0, share, 0.0], atol=1e-9)


def test_a_laser_warms_up_exponentially(scene):
    contacts = RelayContacts(3)
    contacts.command(0, True, 1.0)

    with exposures(scene, contacts, warm_up_s=0.03) as seen:
        share = seen.laser_shares(1.0, 0.03)[0]

    assert share == pytest.approx(math.exp(-1.0), rel=0.01)  # the mean of 1 - exp(-t / T) over the first T


def test_grey_values_follow_exposure_and_gain(scene):
    with exposures(scene, RelayContacts(3)) as seen:
        short, longer, amplified = (
            float(seen.image(0.0, exposure_s, gain_db, 12)[0].mean()) - 16 * scene.sensor.black_level_dn
            for exposure_s, gain_db in ((0.002, 0.0), (0.008, 0.0), (0.002, 6.0206))
        )

    assert longer / short == pytest.approx(4.0, rel=0.05)
    assert amplified / short == pytest.approx(2.0, rel=0.05)


def test_a_beacon_adds_light_to_exposures_while_it_is_on(scene):
    light = Light(name="dim", ambient_w_m2=0.3, beacon=Beacon(ambient_w_m2=8.0, on_s=0.45, off_s=0.45, phase_s=2.0))
    lit = replace(scene, lights={"dim": light})

    with exposures(lit, RelayContacts(3)) as seen:
        on, off = (seen.image(began_s, 0.0004, 0.0, 12)[0].mean() - 16 * 2.0 for began_s in (2.1, 2.5))

    assert on / off == pytest.approx(8.3 / 0.3, rel=0.1)


def test_twelve_bits_hold_sixteen_times_the_grey_value(scene):
    with exposures(scene, RelayContacts(3, RelayFaults(welded=frozenset({1})))) as seen:
        coarse, fine = (seen.image(0.0, 0.005, 0.0, bits)[0] for bits in (8, 12))

    assert (coarse.dtype, fine.dtype) == (np.uint8, np.uint16)
    assert fine.mean() / coarse.mean() == pytest.approx(16.0, rel=0.01)


def stage(number: int) -> RenderedView:
    layer = np.full((1, 1), number, dtype=np.float32)
    return RenderedView(sensor=Sensor(), ambient=layer, laser=layer[None], generator=np.random.default_rng(0))


def shown(move, after_s: float, looks_s) -> list[str]:
    views = MovingViews(["a", "b", "c"], stage, move, after_s)
    names = []
    for at_s in looks_s:
        time.sleep(0.02)  # the next view is ready at once
        names.append(views.at(at_s)[0])
    views.close()
    return names


def test_the_next_view_is_shown_after_a_pause():
    assert shown(AdvancePolicy.PAUSE, 0.3, [0.0, 0.2, 0.4, 0.8, 0.9, 1.5, 9.0]) == ["a", "a", "a", "b", "b", "c", "c"]


def test_the_next_view_is_shown_after_a_time():
    assert shown(AdvancePolicy.TIME, 0.3, [0.0, 0.2, 0.4, 0.5, 0.8]) == ["a", "a", "b", "b", "c"]


def test_the_view_never_changes_if_requested():
    assert shown(AdvancePolicy.NEVER, 0.0, [0.0, 5.0]) == ["a", "a"]
