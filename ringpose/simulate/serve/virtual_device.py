"""A virtual camera and relay board that show a scene, and their URIs."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

from ringpose.errors import DataError
from ringpose.simulate.exposure import view_exposure_s
from ringpose.simulate.pipeline import illuminated_ring, render_board_view, render_ring_view
from ringpose.simulate.placement import board_poses, ring_views
from ringpose.simulate.serve.device import ServedCamera
from ringpose.simulate.serve.faults import InjectedFaults
from ringpose.simulate.serve.genicam import Identity
from ringpose.simulate.serve.relays import RelayContacts, ServedRelays
from ringpose.simulate.serve.views import MovingViews, SceneExposures
from ringpose.types.options import AdvancePolicy, Relay, ServedTarget
from ringpose.types.scene import Scene
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VirtualDevice:
    """Virtual devices that are being served."""

    camera: ServedCamera
    uris: Mapping[str, str]
    """The values of --camera and --lasers for their clients."""


@contextmanager
def virtual_device(
    scene: Scene, setup: Setup, log: Callable[[Mapping[str, Any]], None] | None = None
) -> Iterator[VirtualDevice]:
    """Serve a virtual camera, and a relay board if one is set up, within the context.

    `log` is called with the log record of each frame.
    """
    lasers = range(len(scene.rig.lasers.names))
    with ExitStack() as stack:
        views, exposure_s = _shown(scene, setup)
        stack.callback(views.close)
        relays: ServedRelays | None = None
        contacts = RelayContacts(len(lasers), setup.faults.contacts)
        uri = "line:" + ",".join(f"Line{laser + 1}" for laser in lasers)
        if setup.relay is not Relay.NONE:
            relays = stack.enter_context(ServedRelays(_CODECS[setup.relay](), lasers, setup.faults.contacts))
            contacts = relays.contacts
            extra = _ASCII_PARAMETERS if setup.relay is Relay.ASCII else ""
            uri = f"{setup.relay}:{relays.port}?ch={relays.channels}{extra}"

        def switch_by_lines(high: int, now_s: float) -> None:
            for laser in lasers:
                contacts.command(laser, bool(high >> laser & 1), now_s)

        def log_frame(record: Mapping[str, Any]) -> None:
            if relays is not None and record["frame_id"] == setup.faults.unplug_after:
                relays.unplug()
            if log is not None:
                log(record)

        camera = scene.rig.camera
        identity = Identity(
            address=setup.address,
            width=camera.image_width,
            height=camera.image_height,
            bits=scene.sensor.bits,
            exposure_s=exposure_s,
            serial=f"RP{setup.address.rsplit('.', 1)[-1]}",
        )
        exposures = SceneExposures(views, scene.sensor, contacts, setup.warm_up_s)
        lines_changed = switch_by_lines if relays is None else None
        served = ServedCamera(identity, exposures.image, setup.faults.camera, lines_changed, log_frame)
        uris = {"camera": f"aravis://{setup.address}", "lasers": uri}
        yield VirtualDevice(camera=stack.enter_context(served), uris=uris)


def _shown(scene: Scene, setup: Setup) -> tuple[MovingViews, float]:
    """The views of the ring or of a calibration board, and the camera's initial exposure."""
    if setup.show is ServedTarget.RING:
        views = ring_views(scene)
        exposure_s = view_exposure_s(scene, illuminated_ring(scene, views[0]))
        return MovingViews(views, lambda k: render_ring_view(scene, views[k], k), setup.move, setup.after_s), exposure_s
    boards = scene.camera_boards if setup.show is ServedTarget.CAMERA_BOARD else scene.plane_boards
    if boards is None:
        raise DataError("the scene", f"has no {setup.show}", "give it one under boards")
    poses = board_poses(scene, boards)
    return MovingViews(
        poses, lambda k: render_board_view(scene, boards, poses[k], k), setup.move, setup.after_s
    ), boards.exposure_s
