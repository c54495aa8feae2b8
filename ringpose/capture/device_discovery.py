"""Connected cameras and serial ports, by persistent names; no device is opened and nothing is sent to a port."""

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from ringpose.capture.cameras.aravis_library import PACKAGE, library
from ringpose.capture.cameras.pylon import pypylon
from ringpose.types.record import Key, Presence

_VIDEO = Path("/sys/class/video4linux")

_BY_ID = Path("/dev/serial/by-id")


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCamera:
    """A camera that a driver has found; what a driver does not report is empty."""

    kind: Annotated[Literal["camera"], Key("Kind of the device.")] = "camera"
    uri: Annotated[str, Key("What to give to `--camera`.")]
    address: Annotated[str, Key("Its address.", presence=Presence.IF_KNOWN)] = ""
    vendor: Annotated[str, Key("Its manufacturer.", presence=Presence.IF_KNOWN)] = ""
    model: Annotated[str, Key("Its model.", presence=Presence.IF_KNOWN)] = ""
    serial: Annotated[str, Key("Its serial number.", presence=Presence.IF_KNOWN)] = ""
    protocol: Annotated[str, Key("Its protocol.", presence=Presence.IF_KNOWN)] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialPort:
    """A serial port of a USB device."""

    kind: Annotated[Literal["serial_port"], Key("Kind of the device.")] = "serial_port"
    port: Annotated[str, Key("Its name, which does not depend on the order of plugging in.")]
    device: Annotated[str, Key("Its device file.")]
    usb: Annotated[str, Key("USB numbers of vendor and product, in hexadecimal.")]
    product: Annotated[str | None, Key("What the device calls itself; null if it does not.")]
    serial: Annotated[str | None, Key("Its serial number; null if it has none.")]


def cameras() -> Iterator[FoundCamera]:
    """Cameras found by the installed drivers, each with its URI."""
    yield from _aravis_cameras()
    yield from _pylon_cameras()
    for device in sorted(_VIDEO.glob("video*")):
        model = (device / "name").read_text().strip() if (device / "name").exists() else ""
        yield FoundCamera(uri=f"v4l2:/dev/{device.name}", model=model)


def remarks() -> tuple[str, ...]:
    """What was not searched for, and why."""
    if library() is None:
        return (f"aravis: no search for cameras: libaravis is not installed; apt install {PACKAGE}",)
    return ()


def serial_ports() -> Iterator[SerialPort]:
    """Serial ports of USB devices; the connected board cannot be detected without sending to it."""
    from serial.tools import list_ports

    links = sorted(_BY_ID.iterdir()) if _BY_ID.is_dir() else []
    names = {str(link.resolve()): str(link) for link in links}  # do not depend on the order of plugging in
    for port in sorted(list_ports.comports()):
        if port.vid is not None:
            yield SerialPort(
                port=names.get(port.device, port.device),
                device=port.device,
                usb=f"{port.vid:04x}:{port.pid:04x}",
                product=port.product,
                serial=port.serial_number,
            )


def _aravis_cameras() -> Iterator[FoundCamera]:
    aravis = library()
    if aravis is None:
        return
    aravis.arv_update_device_list()
    for number in range(aravis.arv_get_n_devices()):
        yield FoundCamera(
            uri=f"aravis:{_text(aravis.arv_get_device_id(number))}",
            address=_text(aravis.arv_get_device_address(number)),
            vendor=_text(aravis.arv_get_device_vendor(number)),
            model=_text(aravis.arv_get_device_model(number)),
            serial=_text(aravis.arv_get_device_serial_nbr(number)),
            protocol=_text(aravis.arv_get_device_protocol(number)),
        )


def _pylon_cameras() -> Iterator[FoundCamera]:
    if importlib.util.find_spec("pypylon") is None:
        return
    pylon = pypylon()
    for info in pylon.TlFactory.GetInstance().EnumerateDevices():
        serial, model = info.GetSerialNumber(), info.GetModelName()
        yield FoundCamera(uri=f"pylon:{serial}", vendor="Basler", model=model, serial=serial)


def _text(value: bytes | None) -> str:
    return (value or b"").decode(errors="replace")
