"""`ringpose simulate serve`: a virtual camera and relay board that show a scene."""

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.options import finite
from ringpose.types.options import AdvancePolicy, Relay, ServedTarget

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from contextlib import AbstractContextManager
    from queue import SimpleQueue
    from typing import Any


SceneOption = Annotated[Path, typer.Option("--scene", metavar="SCENE", help="The scene (scene.yaml).")]
Address = Annotated[str, typer.Option("--camera", metavar="ADDRESS", help="Address of the camera: 127.x.y.z.")]
RelayOption = Annotated[
    Relay,
    typer.Option("--relay", help="The relay board; none: the camera's output lines switch the lasers."),
]
ShowOption = Annotated[ServedTarget, typer.Option("--show", help="The target in the scene.")]
MoveOption = Annotated[
    AdvancePolicy,
    typer.Option("--move", help="When the next view is shown: in a pause between frames, after a time, or never."),
]
After = Annotated[
    float, typer.Option("--after", metavar="S", min=0.0, callback=finite, help="Length of that pause, or that time.")
]
WarmUp = Annotated[
    float,
    typer.Option(
        "--warm-up", metavar="S", min=0.0, callback=finite, help="Time in which a laser reaches 63 % of its power."
    ),
]
FaultTexts = Annotated[
    list[str] | None, typer.Option("--fault", metavar="FAULT", help="Injected fault; may be given several times.")
]
Log = Annotated[
    Path | None, typer.Option("--log", metavar="FILE", help="One line per frame: its view and the lasers that were on.")
]
Overwrite = Annotated[bool, typer.Option("--force", help="Replace a log that exists already.")]


def serve(
    scene: SceneOption,
    camera: Address = "127.0.0.1",
    relay: RelayOption = Relay.NONE,
    show: ShowOption = ServedTarget.RING,
    move: MoveOption = AdvancePolicy.PAUSE,
    after: After = 1.0,
    warm_up: WarmUp = 0.0,
    fault: FaultTexts = None,
    log: Log = None,
    force: Overwrite = False,
) -> None:
    """Serve a virtual camera and relay board that show a scene, until a signal ends it."""
    from ringpose.files import records
    from ringpose.files.scenes import read_scene
    from ringpose.simulate.serve.faults import parsed_faults
    from ringpose.simulate.serve.virtual_device import Setup, VirtualDevice

    read = read_scene(scene)
    setup = Setup(
        address=_loopback(camera),
        relay=relay,
        show=show,
        move=move,
        after_s=after,
        warm_up_s=warm_up,
        faults=parsed_faults(fault or (), len(read.rig.lasers.names)),
    )
    with _noted(log, force) as noted, _failures_of_threads() as failures, VirtualDevice(read, setup, noted) as served:
        records.write(served.uris)
        raise failures.get()


@contextmanager
def _failures_of_threads() -> "Iterator[SimpleQueue[BaseException]]":
    """Exceptions that end a serving thread, after which a device no longer answers."""
    import threading
    from queue import SimpleQueue

    failures: SimpleQueue[BaseException] = SimpleQueue()
    usual = threading.excepthook
    threading.excepthook = lambda ended: failures.put(ended.exc_value or RuntimeError("a thread ended"))
    try:
        yield failures
    finally:
        threading.excepthook = usual


def _loopback(address: str) -> str:
    """The address; UsageError unless it is a loopback address, which other machines cannot reach."""
    import ipaddress

    from ringpose.errors import UsageError

    try:
        if ipaddress.IPv4Address(address).is_loopback:
            return address
    except ValueError:
        pass
    raise UsageError("--camera", f'"{address}" is no loopback address', "say one such as 127.0.0.1")


def _noted(log: Path | None, force: bool) -> "AbstractContextManager[Callable[[Mapping[str, Any]], None] | None]":
    from contextlib import nullcontext

    from ringpose.files import atomic, records

    if log is None:
        return nullcontext()

    @contextmanager
    def opened() -> "Iterator[Callable[[Mapping[str, Any]], None]]":
        with atomic.replacing(log, force):
            pass
        with log.open("ab", buffering=0) as stream:

            def noted(note: "Mapping[str, Any]") -> None:
                try:
                    stream.write(records.line_of(note).encode())
                except OSError as error:
                    raise atomic.output_error(log, error) from error

            yield noted

    return opened()
