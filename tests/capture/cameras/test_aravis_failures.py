"""Errors of the Aravis driver: a lost camera, a camera controlled by another client, invalid settings."""

import socket

import pytest

from ringpose.capture.cameras import aravis
from ringpose.capture.cameras import aravis as network
from ringpose.errors import DeviceError, UsageError

pytestmark = pytest.mark.usefixtures("_aravis")


def test_losing_every_frame_is_an_error_with_a_remedy(serve, camera, monkeypatch, tmp_path):
    serve("loss=0.9", "no-resend")
    (tmp_path / "rmem_max").write_text("212992\n")
    monkeypatch.setattr(network, "_RMEM_MAX", tmp_path / "rmem_max")

    with (opened := camera(timeout="0.3")), pytest.raises(DeviceError, match="3 times in a row") as raised:
        opened.trigger(0)

    assert "sysctl -w net.core.rmem_max=8388608" in str(raised.value)


def test_a_camera_that_stops_answering_is_an_error(serve, camera):
    serve("dead-camera=2")

    with (opened := camera(timeout="2")):
        opened.trigger(0)
        opened.trigger(0)
        with pytest.raises(DeviceError, match=r"does not answer any more; check its cable"):
            opened.trigger(0)


def test_a_closed_camera_can_be_opened_again(serve, camera):
    serve()
    opened = camera()
    with opened:
        opened.trigger(0)

    with opened:
        frame = opened.trigger(0)

    assert frame.attempts == 1


def test_a_camera_controlled_by_another_client_is_an_error(serve, camera):
    serve()

    with camera(), pytest.raises(DeviceError, match="is controlled by another program; close that one"):
        camera().open()


def test_losing_control_to_another_client_is_an_error(serve, camera):
    device = serve()

    with (opened := camera()):
        device.camera._control.client = ("127.0.0.1", 1)
        with pytest.raises(DeviceError, match="is controlled by another program; close that one"):
            opened.set("Gain", 1.0)


def test_a_missing_camera_is_an_error(camera):
    with pytest.raises(DeviceError, match=r"no such camera: .*; see ringpose capture --list"):
        camera().open()


def test_a_missing_route_is_an_error(camera, monkeypatch):
    class Unroutable(socket.socket):
        def connect(self, address):
            raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(network.socket, "socket", Unroutable)

    with pytest.raises(DeviceError, match=r"there is no route to 10\.9\.8\.7; give this computer an address"):
        camera("10.9.8.7").open()


def test_a_missing_library_is_named_with_its_package(camera, monkeypatch):
    monkeypatch.setattr(aravis, "library", lambda: None)

    with pytest.raises(DeviceError, match=r"needs the library Aravis.*apt install libaravis-0\.8-0"):
        camera().open()


@pytest.mark.parametrize("exposure_s", [5000.0, 1e-6])
def test_an_exposure_out_of_bounds_is_rejected(serve, camera, exposure_s):
    serve()

    with (opened := camera()), pytest.raises(DeviceError, match=r"ExposureTime cannot be .*; it takes 10 to 1e\+06"):
        opened.arm(exposure_s)


def test_an_unavailable_pixel_format_is_rejected(serve, camera):
    serve()

    with pytest.raises(DeviceError, match="PixelFormat cannot be Mono16; it takes Mono12, Mono8"):
        camera(format="Mono16").open()


def test_a_misspelt_parameter_is_a_usage_error(camera):
    with pytest.raises(UsageError, match='no parameter "fromat"; did you mean format'):
        camera(fromat="Mono8")


def test_an_unknown_format_is_a_usage_error(camera):
    with pytest.raises(UsageError, match='format "RGB8" is not known; use one of Mono8'):
        camera(format="RGB8")


@pytest.mark.parametrize("size", ["100", "20000"])
def test_a_packet_size_out_of_bounds_is_rejected(serve, camera, size):
    serve()

    with pytest.raises(DeviceError, match=f"GevSCPSPacketSize cannot be {size}; it takes 576 to 16260"):
        camera(packet=size).open()
