"""Connected cameras and serial ports, by persistent names; no device is opened and nothing is sent to a port."""

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ringpose.capture.cameras.aravis_library import PACKAGE, library
from ringpose.capture.cameras.pylon import pypylon

_VIDEO = Path("/sys/class/video4linux")

_BY_ID = Path("/dev/serial/by-id")


def cameras() -> Iterator[dict[str, Any]]:
    """Cameras found by the installed drivers, each with its URI."""
    yield from _aravis_cameras()
    yield from _pylon_cameras()
    for device in sorted(_VIDEO.glob("video*")):
        model = (device / "name").read_text().strip() if (device / "name").exists() else ""
        yield {"kind": "camera", "uri": f"v4l2:/dev/{device.name}", "model": model}


def remarks() -> tuple[str, ...]:
    """What was not searched for, and why."""
    if library() is None:
        return (f"aravis: no search for cameras: libaravis is not installed; apt install {PACKAGE}",)
    return ()


def serial_ports() -> Iterator[dict[str, Any]]:
    """Serial ports of USB devices; the connected board cannot be detected without sending to it."""
    from serial.tools import list_ports

    links = sorted(_BY_ID.iterdir()) if _BY_ID.is_dir() else []
    names = {str(link.resolve()): str(link) for link in links}  # do not depend on the order of plugging in
    for port in sorted(list_ports.comports()):
        if port.vid is not None:
            yield {
                "kind": "serial_port",
                "port": names.get(port.device, port.device),
                "device": port.device,
                "usb": f"{port.vid:04x}:{port.pid:04x}",
                "product": port.product,
                "serial": port.serial_number,
            }


def _aravis_cameras() -> Iterator[dict[str, Any]]:
    aravis = library()
    if aravis is None:
        return
    aravis.arv_update_device_list()
    for number in range(aravis.arv_get_n_devices()):
        properties = {
            "uri": f"aravis:{_text(aravis.arv_get_device_id(number))}",
            "address": _text(aravis.arv_get_device_address(number)),
            "vendor": _text(aravis.arv_get_device_vendor(number)),
            "model": _text(aravis.arv_get_device_model(number)),
            "serial": _text(aravis.arv_get_device_serial_nbr(number)),
            "protocol": _text(aravis.arv_get_device_protocol(number)),
        }
        yield {"kind": "camera", **{key: value for key, value in properties.items() if value}}


def _pylon_cameras() -> Iterator[dict[str, Any]]:
    if importlib.util.find_spec("pypylon") is None:
        return
    pylon = pypylon()
    for info in pylon.TlFactory.GetInstance().EnumerateDevices():
        serial, model = info.GetSerialNumber(), info.GetModelName()
        yield {"kind": "camera", "uri": f"pylon:{serial}", "vendor": "Basler", "model": model, "serial": serial}


def _text(value: bytes | None) -> str:
    return (value or b"").decode(errors="replace")
