"""The views of a scene that the virtual camera shows in turn, and its exposures of them."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from ringpose.optics.sensor import digitised
from ringpose.simulate.renderer import RenderedView
from ringpose.simulate.serve.relays import RelayContacts
from ringpose.types.arrays import Array, Float64, UInt
from ringpose.types.options import AdvancePolicy
from ringpose.types.scene import NamedBoardPose, RingView, Sensor

_SLICES = 8
"""Time steps of an exposure in which a laser is warming up."""


class MovingViews:
    """The views in turn; the next one is rendered in the background and shown when it is due and ready."""

    def __init__(
        self,
        views: Sequence[RingView | NamedBoardPose],
        render: Callable[[int], RenderedView],
        move: AdvancePolicy,
        after_s: float,
    ) -> None:
        self._views = views
        self._render = render
        self._move = move
        self._after_s = after_s
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="views")
        self._number = 0
        self._current: RenderedView = render(0)
        self._next: Future[RenderedView] | None = None
        self._shown_s: float | None = None
        """Time of the first exposure of the current view."""
        self._exposed_s: float | None = None
        """Time of the last exposure."""
        self._prepare()

    def at(self, now_s: float) -> tuple[str, RenderedView]:
        """Name and rendered image of the view that an exposure beginning now (monotonic clock) shows."""
        since_s = self._exposed_s if self._move is AdvancePolicy.PAUSE else self._shown_s
        due = since_s is not None and now_s - since_s >= self._after_s
        if due and self._next is not None and self._next.done():
            self._number, self._current = self._number + 1, self._next.result()
            self._shown_s = now_s
            self._prepare()
        self._shown_s = now_s if self._shown_s is None else self._shown_s
        self._exposed_s = now_s
        return self._views[self._number].name, self._current

    def close(self) -> None:
        """Stop rendering."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    def _prepare(self) -> None:
        has_next = self._number + 1 < len(self._views) and self._move is not AdvancePolicy.NEVER
        self._next = self._worker.submit(self._render, self._number + 1) if has_next else None


class SceneExposures:
    """Exposures of the views of a scene, with each laser on for its actual time.

    `warm_up_s` is the time constant of the power of a laser that has been switched on.
    """

    def __init__(self, views: MovingViews, sensor: Sensor, contacts: RelayContacts, warm_up_s: float = 0.0) -> None:
        self._views = views
        self._sensor = sensor
        self._contacts = contacts
        self._warm_up_s = max(warm_up_s, 1e-9)
        self._generator = np.random.default_rng(1)

    def image(
        self, began_s: float, exposure_s: float, gain_db: float, bits: Literal[8, 12]
    ) -> tuple[UInt[Array, "row column"], Mapping[str, Any]]:
        """See `ExposedImage`; the record contains the view and the share of the exposure in which each laser was on."""
        name, rendered = self._views.at(began_s)
        shares = self.laser_shares(began_s, exposure_s).tolist()
        factor = 2.0 ** (bits - self._sensor.bits)
        gain = self._sensor.overall_system_gain_dn_per_e * factor * 10 ** (gain_db / 20)
        black_dn = self._sensor.black_level_dn * factor
        sensor = replace(self._sensor, bits=bits, overall_system_gain_dn_per_e=gain, black_level_dn=black_dn)
        image = digitised(rendered.electrons_with(shares, exposure_s, began_s), sensor, self._generator)
        return image, {"view": name, "laser_shares": shares}

    def laser_shares(self, began_s: float, exposure_s: float) -> Float64[Array, "laser"]:
        """Energy of each laser during an exposure, as a share of that at full power."""
        edges_s = np.linspace(began_s, began_s + exposure_s, _SLICES + 1)
        slices = [
            np.array(self._contacts.shares(begin_s, end_s)) * self._power((begin_s + end_s) / 2)
            for begin_s, end_s in pairwise(edges_s.tolist())
        ]
        mean: Float64[Array, "laser"] = np.mean(slices, axis=0)
        return mean

    def _power(self, time_s: float) -> Float64[Array, "laser"]:
        """Power of each laser at a time as a share of full power; 1 for a laser that is off."""
        since_s = self._contacts.on_since_s(time_s)
        age_s = np.array([np.inf if since is None else time_s - since for since in since_s])
        power: Float64[Array, "laser"] = -np.expm1(-age_s / self._warm_up_s)
        return power
