"""`ringpose simulate serve`: a virtual camera and relay board that show a scene, or its images over TCP."""

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import Verbose, finite
from ringpose.types.options import AdvancePolicy, Clock, Relay, ServedTarget

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from queue import SimpleQueue
    from typing import Any

    from ringpose.types.scene import Scene
    from ringpose.types.truth import Truth

OF_IMAGES = "With --images"

SceneArgument = Annotated[Path | None, typer.Argument(metavar="[SCENE]", help="The scene (scene.yaml).")]
SceneOption = Annotated[Path | None, typer.Option("--scene", metavar="SCENE", help="The same as SCENE.")]
Address = Annotated[str | None, typer.Option("--camera", metavar="ADDRESS", help="Address of the camera: 127.x.y.z.")]
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
Images = Annotated[
    str | None,
    typer.Option("--images", metavar="URI", help="Serve images instead: tcp://HOST:PORT; port 0 is any free one."),
]
ClockOption = Annotated[
    Clock,
    typer.Option(
        "--clock", help="The time of day, or simulated time that waits for the clients.", rich_help_panel=OF_IMAGES
    ),
]
RateOption = Annotated[
    float | None,
    typer.Option(
        "--rate",
        metavar="HZ",
        min=1e-3,
        max=1e4,
        callback=finite,
        help="Frames a second; default: 5.",
        rich_help_panel=OF_IMAGES,
    ),
]
SecretFile = Annotated[
    Path | None,
    typer.Option(
        "--secret-file",
        readable=False,
        metavar="FILE",
        help="A secret that clients must have.",
        rich_help_panel=OF_IMAGES,
    ),
]
TruthFile = Annotated[
    Path | None,
    typer.Option(
        "--truth",
        readable=False,
        metavar="FILE",
        help="Write the truth of each served shot.",
        rich_help_panel=OF_IMAGES,
    ),
]
ImageWidth = Annotated[
    int | None,
    typer.Option(
        "--width", metavar="PX", min=16, max=65535, help="Smaller images of the same view.", rich_help_panel=OF_IMAGES
    ),
]
Overwrite = Annotated[bool, typer.Option("--force", help="Replace a log that exists already.")]

AFTER_S = 1.0
"""Pause between frames after which the next view is shown, if --after is not given."""

RATE_HZ = 5.0
"""Frames that are served a second, if --rate is not given."""


def serve(
    scene: SceneArgument = None,
    scene_option: SceneOption = None,
    images: Images = None,
    clock: ClockOption = Clock.WALL,
    rate: RateOption = None,
    secret_file: SecretFile = None,
    truth: TruthFile = None,
    width: ImageWidth = None,
    camera: Address = None,
    relay: RelayOption = Relay.NONE,
    show: ShowOption = ServedTarget.RING,
    move: MoveOption = AdvancePolicy.PAUSE,
    after: After = AFTER_S,
    warm_up: WarmUp = 0.0,
    fault: FaultTexts = None,
    log: Log = None,
    force: Overwrite = False,
    verbose: Verbose = False,
) -> None:
    """Serve a virtual camera and relay board that show a scene, or its images over TCP, until a signal ends it."""
    from ringpose.errors import UsageError
    from ringpose.files import records
    from ringpose.files.scenes.scene import read_scene
    from ringpose.simulate.serve.faults import parsed_faults
    from ringpose.simulate.serve.virtual_device import Setup, virtual_device

    if (scene is None) == (scene_option is None):
        raise UsageError("SCENE", "is missing" if scene is None else "is given twice", "name one scene file")
    read = read_scene(next(each for each in (scene, scene_option) if each is not None))
    if images is not None:
        of_device = (camera, relay, show, move, after, warm_up, fault or None, log)
        if of_device != (None, Relay.NONE, ServedTarget.RING, AdvancePolicy.PAUSE, AFTER_S, 0.0, None, None):
            names = "--camera, --relay, --show, --move, --after, --warm-up, --fault and --log"
            raise UsageError("--images", f"excludes {names}, which are of the network camera", "leave them out")
        if width is not None:
            from ringpose.simulate.serve.preview import preview

            read = preview(read, width)
        serve_images(read, images, clock, rate or RATE_HZ, secret_file, truth, force=force, verbose=verbose)
        return
    if clock is not Clock.WALL or not all(option is None for option in (rate, secret_file, truth, width)):
        finding = "are of use with --images only"
        raise UsageError("--clock, --rate, --secret-file, --truth, --width", finding, "add --images URI")
    setup = Setup(
        address=_loopback("127.0.0.1" if camera is None else camera),
        relay=relay,
        show=show,
        move=move,
        after_s=after,
        warm_up_s=warm_up,
        faults=parsed_faults(fault or (), len(read.rig.lasers.names)),
    )
    with (
        _writer(log, force) as on_frame,
        _failures_of_threads() as failures,
        virtual_device(read, setup, on_frame) as served,
    ):
        records.write(served.uris)
        raise failures.get()


def serve_images(
    scene: "Scene",
    uri: str,
    clock: Clock,
    rate_hz: float,
    secret_file: Path | None,
    truth: Path | None,
    *,
    force: bool,
    verbose: bool,
) -> None:
    """Serve images until a signal ends it."""
    from ringpose.cli import messages
    from ringpose.errors import UsageError
    from ringpose.files import records
    from ringpose.files.io import read_secret
    from ringpose.files.records.truths import truth_record
    from ringpose.simulate.serve.image_clients import is_loopback
    from ringpose.simulate.serve.images import ImageServer, ImageSetup

    host, port = host_and_port(uri)
    if secret_file is None and not is_loopback(host):
        finding = f"{host} can be reached from other machines, and there is no shared secret"
        raise UsageError("--images", finding, "add --secret-file FILE, or use 127.0.0.1")
    setup = ImageSetup(
        host=host,
        port=port,
        clock="wall" if clock is Clock.WALL else "lockstep",
        rate_hz=rate_hz,
        secret=None if secret_file is None else read_secret(secret_file),
    )

    def record_of(truth: "Truth") -> "dict[str, Any]":
        plain: dict[str, Any] = records.plain(truth_record(truth))
        return plain

    report = messages.echo if verbose else None
    with (
        _writer(truth, force) as on_truth,
        _failures_of_threads() as failures,
        ImageServer(scene, setup, record_of, on_truth, report) as server,
    ):
        records.write(server.uris)
        raise failures.get()


def host_and_port(uri: str) -> "tuple[str, int]":
    """The parts of `tcp://HOST:PORT`."""
    from urllib.parse import urlsplit

    from ringpose.errors import UsageError

    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not uri.startswith("tcp://") or not host or port is None or uri.partition("://")[2] != parts.netloc:
        raise UsageError("--images", f'"{uri}" is not an address', "write it as tcp://127.0.0.1:5005")
    return host, port


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
    raise UsageError("--camera", f'"{address}" is not a loopback address', "give one such as 127.0.0.1")


@contextmanager
def _writer(path: Path | None, force: bool) -> "Iterator[Callable[[Mapping[str, Any]], None] | None]":
    """A function that appends a record to a new file at once; None without a file."""
    from ringpose.files import atomic, records

    if path is None:
        yield None
        return
    with atomic.replacing(path, force):
        pass
    with path.open("ab", buffering=0) as stream:

        def write(record: "Mapping[str, Any]") -> None:
            try:
                stream.write(records.line_of(record).encode())
            except OSError as error:
                raise atomic.output_error(path, error) from error

        yield write
