"""`ringpose capture --list` and `ringpose capture --test`: list the devices, and test them."""

from typing import TYPE_CHECKING

import typer

from ringpose.errors import NO_POSE, UsageError

if TYPE_CHECKING:
    from ringpose.capture.source import CaptureRequest
    from ringpose.cli.batch import Batch


def list_devices(is_requested: bool) -> bool:
    """Write one record for each camera and serial port to stdout; ends the command."""
    if not is_requested:
        return is_requested

    from ringpose.capture import device_discovery
    from ringpose.cli import messages
    from ringpose.files import records

    for line in device_discovery.remarks():
        messages.echo(line)
    for found in (*device_discovery.cameras(), *device_discovery.serial_ports()):
        records.write(found)
    raise typer.Exit


def check_devices(request: "CaptureRequest", batch: "Batch") -> None:
    """Write one record for each check to stdout, the overall verdict last; ends the command."""
    from dataclasses import asdict

    from ringpose.capture.self_test import opened_devices, run_self_test, summary
    from ringpose.cli.acquisition import source_of
    from ringpose.files import records

    source = source_of(request, batch)
    if not source.devices:
        raise UsageError("--test", "what is recorded cannot be tested", "give --camera and --lasers of devices")
    checks = []
    with opened_devices(source) as (camera, lasers):
        for check in run_self_test(camera, lasers, request.fixed_exposure_s):
            checks.append(check)
            records.write({key: value for key, value in asdict(check).items() if value})
    overall = summary(checks)
    records.write({key: value for key, value in asdict(overall).items() if value})
    raise typer.Exit(NO_POSE if overall.verdict == "fault" else 0)
