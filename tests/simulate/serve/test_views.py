"""Exposures of the virtual camera: lasers that are on for part of an exposure, and the sequence of views."""

import math
from concurrent.futures import Executor, Future
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from served_scene import small_scene

from ringpose.simulate.pipeline import render_ring_view
from ringpose.simulate.placement import ring_views
from ringpose.simulate.renderer import RenderedView
from ringpose.simulate.serve.relays import RelayContacts, RelayFaults
from ringpose.simulate.serve.views import MovingViews, SceneExposures
from ringpose.types.options import AdvancePolicy
from ringpose.types.scene import Beacon, Light, RingView, Sensor

BLACK_DN = Sensor().black_level_dn


@pytest.fixture
def exposures(tmp_path):
    """Makes exposures of the first view of a small scene with changes."""
    with ExitStack() as stack:

        def made(contacts: RelayContacts, warm_up_s: float = 0.0, **changes) -> SceneExposures:
            scene = replace(small_scene(tmp_path), **changes)
            near = ring_views(scene)[:1]
            views = MovingViews(near, lambda k: render_ring_view(scene, near[k], k), AdvancePolicy.NEVER, 0.0)
            stack.callback(views.close)
            return SceneExposures(views, scene.sensor, contacts, warm_up_s)

        yield made


@pytest.mark.parametrize(
    ("on_s", "off_s", "share"),
    [(0.0, 99.0, 1.0), (2.0, 99.0, 0.0), (1.005, 99.0, 0.5), (0.0, 1.0025, 0.25), (1.0, 1.0, 0.0)],
    ids=["on", "too late", "half", "a quarter", "never"],
)
def test_a_laser_contributes_for_the_time_that_it_is_on(exposures, on_s, off_s, share):
    contacts = RelayContacts(3)
    contacts.command(1, True, on_s)
    contacts.command(1, False, off_s)

    seen = exposures(contacts)
    shares = seen.laser_shares(1.0, 0.01)

    np.testing.assert_allclose(shares, [0.0, share, 0.0], atol=1e-9)


def test_a_laser_warms_up_exponentially(exposures):
    contacts = RelayContacts(3)
    contacts.command(0, True, 1.0)

    seen = exposures(contacts, warm_up_s=0.03)
    share = seen.laser_shares(1.0, 0.03)[0]

    assert share == pytest.approx(math.exp(-1.0), rel=0.01)  # the mean of 1 - exp(-t / T) over the first T


def test_grey_values_follow_exposure_and_gain(exposures):
    seen = exposures(RelayContacts(3))
    short, longer, amplified = (
        float(seen.image(0.0, exposure_s, gain_db, 12)[0].mean()) - 16 * BLACK_DN
        for exposure_s, gain_db in ((0.002, 0.0), (0.008, 0.0), (0.002, 6.0206))
    )

    assert longer / short == pytest.approx(4.0, rel=0.05)
    assert amplified / short == pytest.approx(2.0, rel=0.05)


def test_a_beacon_adds_light_to_exposures_while_it_is_on(exposures):
    light = Light(name="dim", ambient_w_m2=0.3, beacon=Beacon(ambient_w_m2=8.0, on_s=0.45, off_s=0.45, phase_s=2.0))

    seen = exposures(RelayContacts(3), lights={"dim": light})
    on, off = (seen.image(began_s, 0.0004, 0.0, 12)[0].mean() - 16 * BLACK_DN for began_s in (2.1, 2.5))

    assert on / off == pytest.approx(8.3 / 0.3, rel=0.1)


def test_twelve_bits_hold_sixteen_times_the_grey_value(exposures):
    seen = exposures(RelayContacts(3, RelayFaults(welded=frozenset({1}))))
    coarse, fine = (seen.image(0.0, 0.005, 0.0, bits)[0] for bits in (8, 12))

    assert (coarse.dtype, fine.dtype) == (np.uint8, np.uint16)
    assert fine.mean() / coarse.mean() == pytest.approx(16.0, rel=0.01)


def stage(number: int) -> RenderedView:
    layer = np.full((1, 1), number, dtype=np.float32)
    return RenderedView(sensor=Sensor(), ambient=layer, laser=layer[None], generator=np.random.default_rng(0))


class AtOnce(Executor):
    """Runs what is submitted before it returns: the next view is ready at once."""

    def submit(self, run, /, *words):
        done = Future()
        done.set_result(run(*words))
        return done


def shown(move, after_s: float, looks_s) -> list[str]:
    named = [RingView(name=name, center_m=np.zeros(3), normal=np.array([0.0, 0.0, -1.0])) for name in "abc"]
    views = MovingViews(named, stage, move, after_s)
    names = [views.at(at_s)[0] for at_s in looks_s]
    views.close()
    return names


@pytest.mark.parametrize(
    ("move", "after_s", "looks_s", "names"),
    [
        (AdvancePolicy.PAUSE, 0.3, [0.0, 0.2, 0.4, 0.8, 0.9, 1.5, 9.0], "aaabbcc"),
        (AdvancePolicy.TIME, 0.3, [0.0, 0.2, 0.4, 0.5, 0.8], "aabbc"),
        (AdvancePolicy.NEVER, 0.0, [0.0, 5.0], "aa"),
    ],
)
def test_the_next_view_is_shown_after_a_pause_or_a_time_or_never(monkeypatch, move, after_s, looks_s, names):
    monkeypatch.setattr("ringpose.simulate.serve.views.ThreadPoolExecutor", lambda **_: AtOnce())
    assert "".join(shown(move, after_s, looks_s)) == names
