"""Discovery of connected devices by persistent names."""

import serial.tools.list_ports

from ringpose.capture import device_discovery as inventory


class Port:
    """A serial port as listed by pyserial."""

    def __init__(self, device: str, vid: int | None, product: str) -> None:
        self.device, self.vid, self.pid = device, vid, 0x7523
        self.product, self.serial_number = product, None

    def __lt__(self, other: "Port") -> bool:
        return self.device < other.device


def test_serial_ports_have_persistent_names(tmp_path, monkeypatch):
    device = tmp_path / "ttyUSB1"
    device.touch()
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    (by_id / "usb-1a86_USB_Serial-if00").symlink_to(device)
    ports = [Port(str(device), 0x1A86, "USB Serial"), Port("/dev/ttyS0", None, "n/a")]
    monkeypatch.setattr(serial.tools.list_ports, "comports", lambda: ports)
    monkeypatch.setattr(inventory, "_BY_ID", by_id)

    (found,) = inventory.serial_ports()

    assert found.port == str(by_id / "usb-1a86_USB_Serial-if00")
    assert (found.device, found.usb, found.product) == (str(device), "1a86:7523", "USB Serial")


def test_video_devices_are_cameras(tmp_path, monkeypatch):
    (tmp_path / "video0").mkdir()
    (tmp_path / "video0" / "name").write_text("Webcam\n")
    monkeypatch.setattr(inventory, "_VIDEO", tmp_path)
    monkeypatch.setattr(inventory, "library", lambda: None)

    assert inventory.FoundCamera(uri="v4l2:/dev/video0", model="Webcam") in list(inventory.cameras())


def test_a_missing_library_is_reported(monkeypatch):
    monkeypatch.setattr(inventory, "library", lambda: None)

    assert "apt install libaravis-0.8-0" in inventory.remarks()[0]
