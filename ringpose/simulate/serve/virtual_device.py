"""A virtual camera and relay board that show a scene, and their URIs."""

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
from ringpose.simulate.serve.views import SceneExposures, board_moving_views, ring_moving_views
from ringpose.types.options import AdvancePolicy, Relay, ServedTarget
from ringpose.types.scene import BoardSet, Scene
from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec
from ringpose.wire.numato import NumatoCodec
from ringpose.wire.relay_codec import RelayCodec

_CODECS: Mapping[Relay, Callable[[], RelayCodec]] = {
    Relay.LCUS: LcusCodec,
    Relay.NUMATO: NumatoCodec,
    Relay.MODBUS: ModbusCodec,
    Relay.ASCII: lambda: AsciiCodec(on="R{n} ON", off="R{n} OFF", read="R?"),
}

_ASCII_PARAMETERS = "&on=R{n}%20ON&off=R{n}%20OFF&read=R?"
"""Parameters of the laser URI that describe the protocol of `_CODECS[Relay.ASCII]`."""


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
    """The virtual devices; a context manager that serves inside its block.

    `log` is called with the log record of each frame.
    """

    def __init__(self, scene: Scene, setup: Setup, log: Callable[[Mapping[str, Any]], None] | None = None) -> None:
        self._scene = scene
        self._setup = setup
        self._log = log
        self._frames = 0
        self._lasers = range(len(scene.rig.lasers.names))
        self._relays: ServedRelays | None = None
        self._contacts = RelayContacts(len(self._lasers), setup.faults.contacts)
        if setup.relay is not Relay.NONE:
            self._relays = ServedRelays(_CODECS[setup.relay](), self._lasers, setup.faults.contacts)
            self._contacts = self._relays.contacts
        self._stack = ExitStack()

    def __enter__(self) -> "VirtualDevice":
        scene, setup = self._scene, self._setup
        boards = self._boards()
        if boards is None:
            exposure_s = view_exposure_s(scene, illuminated_ring(scene, ring_views(scene)[0]))
            views = ring_moving_views(scene, setup.move, setup.after_s)
        else:
            exposure_s = boards.exposure_s
            views = board_moving_views(scene, boards, setup.move, setup.after_s)
        identity = Identity(
            address=setup.address,
            width=scene.rig.camera.image_width,
            height=scene.rig.camera.image_height,
            bits=scene.sensor.bits,
            exposure_s=exposure_s,
            serial=f"RP{setup.address.rsplit('.', 1)[-1]}",
        )
        with ExitStack() as stack:
            exposures = stack.enter_context(SceneExposures(views, scene.sensor, self._contacts, setup.warm_up_s))
            if self._relays is not None:
                stack.enter_context(self._relays)
            lines_changed = self._lines_changed if self._relays is None else None
            self.camera = stack.enter_context(
                ServedCamera(identity, exposures, setup.faults.camera, lines_changed, self._log_frame)
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
        if self._relays is None:
            lasers = "line:" + ",".join(f"Line{laser + 1}" for laser in self._lasers)
        else:
            extra = _ASCII_PARAMETERS if self._setup.relay is Relay.ASCII else ""
            lasers = f"{self._setup.relay}:{self._relays.port}?ch={self._relays.channels}{extra}"
        return {"camera": f"aravis://{self._setup.address}", "lasers": lasers}

    def _boards(self) -> BoardSet | None:
        """The boards to show; None for the ring."""
        show, scene = self._setup.show, self._scene
        if show is ServedTarget.RING:
            return None
        boards = scene.camera_boards if show is ServedTarget.CAMERA_BOARD else scene.plane_boards
        if boards is None:
            raise DataError("the scene", f"has no {show}", "give it one under boards")
        return boards

    def _lines_changed(self, high: int, now_s: float) -> None:
        for laser in self._lasers:
            self._contacts.command(laser, bool(high >> laser & 1), now_s)

    def _log_frame(self, record: Mapping[str, Any]) -> None:
        self._frames += 1
        if self._relays is not None and self._frames == self._setup.faults.unplug_after:
            self._relays.unplug()
        if self._log is not None:
            self._log(record)
