"""`ringpose capture --list` and `ringpose capture --test`: what is there, and whether it works."""

from typing import TYPE_CHECKING

import typer

from ringpose.errors import NO_POSE, UsageError

if TYPE_CHECKING:
    from ringpose.cli.acquisition import CaptureRequest
    from ringpose.cli.batch import Batch


def list_devices(wanted: bool) -> bool:
    """One record a camera and a serial port on stdout; ends the command."""
    if not wanted:
        return wanted

    from ringpose.capture import device_discovery as inventory
    from ringpose.cli import messages
    from ringpose.files import records

    for line in inventory.remarks():
        messages.say(line)
    for found in (*inventory.cameras(), *inventory.serial_ports()):
        records.write(found)
    raise typer.Exit


def check_devices(wanted: "CaptureRequest", batch: "Batch") -> None:
    """One record a finding on stdout, the verdict last; ends the command."""
    from contextlib import ExitStack
    from dataclasses import asdict

    from ringpose.capture.cameras.driver import CameraDriver
    from ringpose.capture.lasers.driver import LaserDriver
    from ringpose.capture.self_test import dry_run
    from ringpose.cli.acquisition import source_of
    from ringpose.files import records

    devices = source_of(wanted, batch).devices
    if len(devices) != 2:
        raise UsageError("--test", "what is recorded cannot be tested", "give --camera and --lasers of devices")
    verdicts = []
    with ExitStack() as stack:
        for device in devices:
            stack.enter_context(device)
        camera, lasers = devices
        if not isinstance(camera, CameraDriver) or not isinstance(lasers, LaserDriver):
            raise TypeError("devices are a camera and its lasers")
        for finding in dry_run(camera, lasers, wanted.exposure_s):
            verdicts.append(finding.verdict)
            records.write({key: value for key, value in asdict(finding).items() if value})
    worst = next(verdict for verdict in ("fault", "warning", "ok") if verdict in verdicts)
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in ("ok", "warning", "fault"))
    records.write({"check": "verdict", "verdict": worst, "found": counts})
    raise typer.Exit(NO_POSE if worst == "fault" else 0)
