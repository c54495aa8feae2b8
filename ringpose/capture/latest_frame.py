"""Acquisition in the background: the newest shot, stripes of frames while the next ones are exposed, and pacing."""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import TypeVar

from ringpose.detect.difference_images import LaserImage
from ringpose.types.arrays import Array
from ringpose.types.detection import Stripes
from ringpose.types.image import Frame, Shot
from ringpose.types.rig import Rig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveShot:
    """A shot with data about its acquisition: skipped shots, time of completion."""

    shot: Shot
    dropped: int
    """Number of shots since the previous one that were skipped."""
    taken_s: float
    """Time of its completion (`time.perf_counter`)."""


class NewestShots:
    """Takes shots in a thread while the `with` block lasts, and yields the newest one; at most one waits.

    Exceptions of that thread are raised where the shots are consumed. With `every`, each shot is taken when it is asked
    for, without a thread: for sources whose time stands still between shots.
    """

    def __init__(self, shots: Iterator[Shot], abort: Callable[[], None] | None = None, *, every: bool = False) -> None:
        self._shots = shots
        self._abort = abort
        self._every = every
        self._changed = threading.Condition()
        self._waiting: LiveShot | None = None
        self._dropped = 0
        self._ended = False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._take, name="shots", daemon=True)

    def __enter__(self) -> Iterator[LiveShot]:
        if self._every:
            return map(_live_shot, self._shots)
        self._thread.start()
        return self._live_shots()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the thread; `abort`, if given, interrupts the shot that is being taken."""
        if self._every:
            return
        with self._changed:
            was_taking, self._ended = not self._ended, True
        if was_taking and self._abort is not None:
            self._abort()
        self._thread.join()

    def _live_shots(self) -> Iterator[LiveShot]:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting is not None or self._ended)
                newest, self._waiting = self._waiting, None
            if newest is None:
                break
            yield newest
        if self._failure is not None:
            raise self._failure

    def _take(self) -> None:
        try:
            while not self._ended:
                shot = next(self._shots, None)
                if shot is None:
                    break
                with self._changed:
                    self._dropped = self._dropped + 1 if self._waiting is not None else 0
                    self._waiting = LiveShot(shot=shot, dropped=self._dropped, taken_s=time.perf_counter())
                    self._changed.notify()
        except BaseException as failure:  # raised again where the shots are consumed
            self._failure = failure
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify()


def _live_shot(shot: Shot) -> LiveShot:
    return LiveShot(shot=shot, dropped=0, taken_s=time.perf_counter())


MAX_SEARCHED = 8
"""Number of frames whose stripes are kept: one for each laser of a shot."""


class EarlyStripes:
    """Searches each frame of a switched shot for its stripe while the camera exposes the next ones, in a thread.

    The background is the last frame without lasers so far. `stripes_of` returns None for a frame that was not searched,
    and for a frame whose background in the complete shot is a later frame. Stripes along columns are those of the
    turned frame, as the detector needs them.
    """

    def __init__(self, rig: Rig | None = None) -> None:
        self._rig = rig if rig is not None and rig.stripes_along_columns else None
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="stripes")
        self._dark: Frame | None = None
        self._searches: dict[tuple[float, float | None, int], Future[Stripes]] = {}
        """Searches by the mid exposures of a frame and of its background, and the saturation value."""

    def add(self, frame: Frame, saturation_dn: int) -> None:
        """Start the search in a frame that has just arrived."""
        if not frame.lasers:
            self._dark = frame
        elif frame.lasers.bit_count() == 1:
            dark, dark_stamp_s = (None, None) if self._dark is None else (self._dark.image, self._dark.mid_exposure_s)
            search = self._thread.submit(_stripes_in, frame.image, dark, saturation_dn, self._rig)
            self._searches[frame.mid_exposure_s, dark_stamp_s, saturation_dn] = search
            if len(self._searches) > MAX_SEARCHED:
                del self._searches[next(iter(self._searches))]

    def stripes_of(self, image: LaserImage) -> Stripes | None:
        """The stripes found in a frame; None if not searched with the background that the complete shot has for it."""
        dark_stamp_s = None if image.dark is None else image.dark_stamp_s
        search = self._searches.get((image.stamp_s, dark_stamp_s, image.threshold_scale_dn))
        return None if search is None else search.result()


def _stripes_in(image: Array, dark: Array | None, saturation_dn: int, turned: Rig | None) -> Stripes:
    from ringpose.detect.stripes import find_stripes  # slow to import: not while a laser is on for the next frame

    if turned is not None:
        from ringpose.geometry.quarter_turn import to_rows

        turn = to_rows(turned.camera)
        image, dark = turn.image(image), None if dark is None else turn.image(dark)
    return find_stripes(image, dark, saturation_dn=saturation_dn)


Item = TypeVar("Item")


def paced(
    items: Iterable[Item],
    rate_hz: float | None,
    duration_s: float | None = None,
    wait: Callable[[float], None] | None = None,
) -> Iterator[Item]:
    """Yields item k not before k / rate_hz after the first one; a late item does not delay later ones.

    Without a rate, items are yielded without waiting. The last one comes at most `duration_s` after the first.
    """
    began_s: float | None = None
    for number, item in enumerate(items):
        now_s = time.monotonic()
        began_s = now_s if began_s is None else began_s
        due_s = now_s if rate_hz is None else max(now_s, began_s + number / rate_hz)
        if duration_s is not None and due_s > began_s + duration_s:
            return
        if due_s > now_s:
            (wait or time.sleep)(due_s - now_s)
        yield item
