"""`ringpose capture`: devices or recordings -> a session folder; the names of the shots go to stdout."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli import messages
from ringpose.cli.app import DEVICES, OUTPUT, ImageChannel, Quiet, Verbose, app, file_option, finite, with_option_groups
from ringpose.cli.batch import Batch, with_progress
from ringpose.cli.options.devices import ShotOptions
from ringpose.errors import NO_POSE, UsageError

if TYPE_CHECKING:
    from ringpose.capture.source import Source
    from ringpose.files.images.sessions import SessionWriter


def _list_devices(is_requested: bool) -> bool:
    """Write one record for each camera and serial port to stdout; ends the command."""
    if not is_requested:
        return is_requested

    from ringpose.capture import device_discovery
    from ringpose.files import records
    from ringpose.files.records.codec import definition_of

    for line in device_discovery.remarks():
        messages.echo(line)
    for device in device_discovery.cameras():
        records.write(definition_of(device_discovery.FoundCamera).write(device))
    for port in device_discovery.serial_ports():
        records.write(definition_of(device_discovery.SerialPort).write(port))
    raise typer.Exit


CameraUri = Annotated[
    str,
    typer.Option(
        "--camera",
        metavar="URI",
        help="files:FOLDER, files:-, sim:SCENE.yaml, aravis:ADDRESS, ... (manual).",
        rich_help_panel=DEVICES,
    ),
]
OptionalRig = Annotated[
    Path | None,
    file_option(
        "--rig",
        meaning="The rig of the lasers, not required: checks and names them, directs --exposure auto.",
    ),
]
SessionFolder = Annotated[
    Path | None,
    typer.Option(
        "--output", "-o", metavar="FOLDER", help="The session; session-<UTC time> if not given.", rich_help_panel=OUTPUT
    ),
]
ReplaceSession = Annotated[
    bool, typer.Option("--force", help="Replace a session that exists already.", rich_help_panel=OUTPUT)
]
ListDevices = Annotated[
    bool, typer.Option("--list", help="List cameras and serial ports, and exit.", callback=_list_devices, is_eager=True)
]
TestDevices = Annotated[bool, typer.Option("--test", help="Try camera, exposures and lasers instead of taking shots.")]
Rate = Annotated[
    float | None,
    typer.Option(
        "--rate", metavar="HZ", min=1e-3, callback=finite, help="Shots a second, at most.", rich_help_panel=DEVICES
    ),
]
HeldStill = Annotated[
    bool, typer.Option("--still", help="State in each shot that the target is held still while it is taken.")
]
Append = Annotated[
    bool, typer.Option("--append", help="Go on with a session that exists already.", rich_help_panel=OUTPUT)
]


@app.command()
@with_option_groups
def capture(
    *,
    camera: CameraUri,
    shots: ShotOptions,
    rate: Rate = None,
    rig: OptionalRig = None,
    still: HeldStill = False,
    output: SessionFolder = None,
    force: ReplaceSession = False,
    append: Append = False,
    channel: ImageChannel = None,
    test: TestDevices = False,
    show: ListDevices = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Take shots into a session folder: one frame for each step of the sequence; all lasers are off at the end."""
    from ringpose.cli.acquisition import source_of
    from ringpose.files.images.sessions import Existing, SessionWriter, folder_of_now
    from ringpose.files.rigs import read_rig

    request = shots.request(camera, None if rig is None else read_rig(rig), rate_hz=rate, channel=channel)
    if force and append:
        raise UsageError("", "--force and --append contradict each other", "give one of them")
    batch = Batch()
    source = source_of(request, batch)
    if test:
        _check_devices(source, request.fixed_exposure_s)
    folder = output or folder_of_now()
    if str(folder) == "-":
        raise UsageError("--output", "a session is a folder, not a stream", "name a folder")
    if folder.resolve() in source.folders:
        raise UsageError("--output", f"{folder} is where the shots are read from", "choose another folder")
    existing: Existing = "append" if append else "replace" if force else "refuse"
    _take(source, SessionWriter(folder, source.capture, existing), batch, still, verbose, quiet)
    batch.finish()


def _check_devices(source: "Source", exposure_s: float | None) -> None:
    """Write one record for each check to stdout, the overall verdict last; ends the command."""
    from ringpose.capture.self_test import DeviceCheck, run_self_test, summary
    from ringpose.files import records
    from ringpose.files.records.codec import definition_of

    if not source.devices:
        raise UsageError("--test", "what is recorded cannot be tested", "give --camera and --lasers of devices")
    record, checks = definition_of(DeviceCheck).write, []
    camera, lasers = source.devices
    with camera, lasers:
        for check in run_self_test(camera, lasers, exposure_s):
            checks.append(check)
            records.write(record(check))
    overall = summary(checks)
    records.write(record(overall))
    raise typer.Exit(NO_POSE if overall.verdict == "fault" else 0)


def _take(source: "Source", writer: "SessionWriter", batch: Batch, still: bool, verbose: bool, quiet: bool) -> None:
    """Write each shot when it is taken, and its name to stdout when its file is complete."""
    from ringpose.capture.ambient import lost_attempts_dn
    from ringpose.files import records

    with batch, ExitStack() as stack:
        stack.enter_context(writer)
        for device in source.devices:
            stack.enter_context(device)
        writer.name_camera(source.camera_name())
        lost_dn: list[float] = []
        stack.callback(_report_lost, lost_dn)
        for shot in with_progress(source.shots(writer.read_from, writer.names), "shots", quiet):
            lost_now_dn = lost_attempts_dn(shot.meta) if source.devices else []
            lost_dn += lost_now_dn
            if still:
                shot = replace(shot, meta={**shot.meta, "still": True})  # noqa: PLW2901  # the same shot, complete
            with batch.guarded():
                records.write_name(writer.add(shot))
                if verbose:
                    again = f", {len(lost_now_dn)} attempts lost: ambient light changed" if lost_now_dn else ""
                    messages.echo(f"{shot.name}: {len(shot.lasers)} frames{again}")


def _report_lost(lost_dn: list[float]) -> None:
    """Report the number of shots that were repeated because ambient light changed."""
    if lost_dn:
        shots = "1 shot was" if len(lost_dn) == 1 else f"{len(lost_dn)} shots were"
        size = f"by up to {max(map(abs, lost_dn)):.0f} dn"
        messages.echo(f"ambient light: {shots} lost and repeated: it changed within them {size}")
