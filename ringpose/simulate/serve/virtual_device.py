"""A virtual camera and relay board, and their URIs."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any

from ringpose.errors import DataError
from ringpose.simulate.exposure import view_exposure_s
from ringpose.simulate.pipeline import illuminated_ring
from ringpose.simulate.placement import ring_views
from ringpose.simulate.serve.device import ServedCamera
from ringpose.simulate.serve.faults import InjectedFaults
from ringpose.simulate.serve.genicam import Identity
from ringpose.simulate.serve.relays import RelayContacts, ServedRelays
from ringpose.simulate.serve.views import MovingViews, SceneExposures, board_moving_views, ring_moving_views
from ringpose.types.options import AdvancePolicy, Relay, ServedTarget
from ringpose.types.scene import BoardSet, Scene
from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec
from ringpose.wire.numato import NumatoCodec
from ringpose.wire.relay_codec import RelayCodec

_ON, _OFF, _READ = "R{n} ON", "R{n} OFF", "R?"

_CODECS: Mapping[Relay, Callable[[], RelayCodec]] = {
    Relay.LCUS: LcusCodec,
    Relay.NUMATO: NumatoCodec,
    Relay.MODBUS: ModbusCodec,
    Relay.ASCII: lambda: AsciiCodec(on=_ON, off=_OFF, read=_READ),
}

_ASCII_PARAMETERS = "&on=R{n}%20ON&off=R{n}%20OFF&read=R?"


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """Configuration of the virtual devices."""

    address: str = "127.0.0.1"
    relay: Relay = Relay.NONE
    show: ServedTarget = ServedTarget.RING
    move: AdvancePolicy = AdvancePolicy.PAUSE
    after_s: float = 1.0
    """Length of the pause, or of the time, after which the next view is shown."""
    warm_up_s: float = 0.0
    """Time constant of the warm-up of a laser."""
    faults: InjectedFaults = field(default_factory=InjectedFaults)


class VirtualDevice:
    """The virtual devices; a context manager that serves inside its block."""

    def __init__(self, scene: Scene, setup: Setup, noted: Callable[[Mapping[str, Any]], None] | None = None) -> None:
        self._scene = scene
        self._setup = setup
        self._noted = noted
        self._frames = 0
        self._lasers = len(scene.rig.lasers.names)
        self._relays = _relays(setup, self._lasers)
        self._contacts = (
            RelayContacts(self._lasers, setup.faults.contacts) if self._relays is None else self._relays.contacts
        )
        self._stack = ExitStack()

    def __enter__(self) -> "VirtualDevice":
        with ExitStack() as stack:
            exposures = stack.enter_context(self._exposures())
            if self._relays is not None:
                stack.enter_context(self._relays)
            lines = self._lines_changed if self._relays is None else None
            self.camera = stack.enter_context(
                ServedCamera(self._identity(), exposures, self._setup.faults.camera, lines, self._frame_noted)
            )
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    @property
    def uris(self) -> dict[str, str]:
        """The values of --camera and --lasers."""
        camera = f"aravis://{self._setup.address}"
        if self._relays is None:
            return {"camera": camera, "lasers": "line:" + ",".join(f"Line{k + 1}" for k in range(self._lasers))}
        extra = _ASCII_PARAMETERS if self._setup.relay is Relay.ASCII else ""
        return {
            "camera": camera,
            "lasers": f"{self._setup.relay}:{self._relays.port}?ch={self._relays.channels}{extra}",
        }

    def _exposures(self) -> SceneExposures:
        return SceneExposures(self._views(), self._scene.sensor, self._contacts, self._setup.warm_up_s)

    def _views(self) -> MovingViews:
        move, after_s = self._setup.move, self._setup.after_s
        boards = self._boards()
        if boards is None:
            return ring_moving_views(self._scene, move, after_s)
        return board_moving_views(self._scene, boards, move, after_s)

    def _boards(self) -> BoardSet | None:
        show, scene = self._setup.show, self._scene
        if show is ServedTarget.RING:
            return None
        boards = scene.camera_boards if show is ServedTarget.CAMERA_BOARD else scene.plane_boards
        if boards is None:
            raise DataError("the scene", f"has no {show}", "give it one under boards")
        return boards

    def _identity(self) -> Identity:
        scene, boards = self._scene, self._boards()
        first = (
            view_exposure_s(scene, illuminated_ring(scene, ring_views(scene)[0]))
            if boards is None
            else boards.exposure_s
        )
        camera = scene.rig.camera
        return Identity(
            address=self._setup.address,
            width=camera.image_width,
            height=camera.image_height,
            bits=scene.sensor.bits,
            exposure_s=first,
            serial=f"RP{self._setup.address.rsplit('.', 1)[-1]}",
        )

    def _lines_changed(self, high: int, now_s: float) -> None:
        for laser in range(self._lasers):
            self._contacts.command(laser, bool(high >> laser & 1), now_s)

    def _frame_noted(self, note: Mapping[str, Any]) -> None:
        self._frames += 1
        if self._relays is not None and self._frames == self._setup.faults.unplug_after:
            self._relays.unplug()
        if self._noted is not None:
            self._noted(note)


def _relays(setup: Setup, lasers: int) -> ServedRelays | None:
    if setup.relay is Relay.NONE:
        return None
    return ServedRelays(_CODECS[setup.relay](), tuple(range(lasers)), setup.faults.contacts)
