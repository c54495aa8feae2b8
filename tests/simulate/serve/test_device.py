"""The virtual camera at its sockets: robustness against arbitrary datagrams, and the limits of an acquisition."""

import select
import socket
import struct
import time
from types import SimpleNamespace

import numpy as np
import pytest
from other_client import HEADER, Port

from ringpose.simulate.serve import device
from ringpose.simulate.serve import genicam as features
from ringpose.simulate.serve.device import CameraFaults, ServedCamera
from ringpose.simulate.serve.genicam import Identity
from ringpose.wire import gige_registers as bootstrap


class Counted:
    """Image k has the grey value k in every pixel."""

    number = 0

    def image(self, began_s, exposure_s, gain_db, bits):
        self.number += 1
        return np.full((2, 4), self.number, np.uint8 if bits == 8 else np.uint16), {}


@pytest.fixture
def identity(loopback_address):
    return Identity(address=loopback_address, width=4, height=2, bits=8, exposure_s=0.001)


@pytest.fixture
def port(loopback_address):
    made = Port(loopback_address)
    yield made
    made.close()


def write(port: Port, address: int, value: int | float) -> None:
    port.write(address, struct.pack(">I" if isinstance(value, int) else ">d", value))


def start(port: Port, *, triggered: bool) -> None:
    address, number = port.stream.getsockname()
    write(port, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)
    write(port, bootstrap.STREAM_ADDRESS, int.from_bytes(socket.inet_aton(address), "big"))
    write(port, bootstrap.STREAM_PORT, number)
    write(port, features.TRIGGER_MODE, int(triggered))
    write(port, features.ACQUISITION_START, 1)


@pytest.fixture
def _slow(monkeypatch):
    """The camera accepts exposures and periods of 1000 s, which do not end by themselves in a test."""
    for feature, name, bounds in (
        (features.EXPOSURE_TIME, "EXPOSURE_BOUNDS_US", (10.0, 1e9)),
        (features.FRAME_RATE, "FRAME_RATE_BOUNDS_HZ", (0.001, 200.0)),
    ):
        monkeypatch.setattr(features, name, bounds)
        monkeypatch.setitem(features.BOUNDED, feature, bounds)


def test_no_datagram_whatsoever_stops_the_camera(identity, port, rng):
    commands = [0x02, 0x40, 0x80, 0x82, 0x84, 0x86, 0xFFFF]
    addresses = [*range(features.WIDTH, features.USER_OUTPUT_VALUE + 32, 4), *range(0xA00, 0xD20, 4)]

    with ServedCamera(identity, Counted().image):
        write(port, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)
        port.control.setblocking(False)
        for k in range(1500):
            payload = struct.pack(">I", int(rng.choice(addresses))) + rng.bytes(4 * int(rng.integers(0, 9)))
            port.control.send(rng.bytes(int(rng.integers(0, 40))))
            port.control.send(HEADER.pack(0x42, 0, int(rng.choice(commands)), len(payload), k) + payload)
        time.sleep(0.1)
        port.control.settimeout(60.0)
        write(port, features.PIXEL_FORMAT, 0x01080001)
        write(port, features.EXPOSURE_TIME, 100.0)
        write(port, bootstrap.STREAM_PACKET_SIZE, 1400)
        write(port, features.ACQUISITION_STOP, 1)
        start(port, triggered=True)
        write(port, features.TRIGGER_SOFTWARE, 1)

        assert port.frame().shape == (2, 4)


@pytest.mark.usefixtures("_slow")
def test_a_frame_of_a_stopped_acquisition_is_not_sent_in_the_next_one(identity, port):
    seen = Counted()

    with ServedCamera(identity, seen.image):
        start(port, triggered=True)
        write(port, features.EXPOSURE_TIME, 1e9)
        write(port, features.TRIGGER_SOFTWARE, 1)
        time.sleep(0.05)
        write(port, features.ACQUISITION_STOP, 1)
        write(port, features.EXPOSURE_TIME, 300_000.0)
        write(port, features.ACQUISITION_START, 1)
        began_s = time.monotonic()
        write(port, features.TRIGGER_SOFTWARE, 1)
        port.frame()
        took_s = time.monotonic() - began_s

    assert took_s > 0.29
    assert seen.number == 1


@pytest.mark.usefixtures("_slow")
def test_a_camera_with_a_low_frame_rate_stops_at_once(identity, port):
    with ServedCamera(identity, Counted().image) as camera:
        write(port, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)
        write(port, features.FRAME_RATE, 0.001)
        write(port, features.EXPOSURE_TIME, 1e9)
        start(port, triggered=False)
        time.sleep(0.05)
        began_s = time.monotonic()
        camera.__exit__(None, None, None)
        took_s = time.monotonic() - began_s

    assert took_s < 500.0  # half a frame's period


def test_a_dead_camera_wakes_once_for_each_datagram(identity, port, monkeypatch):
    """A datagram that stayed in its socket would let the camera run without a pause."""
    waits = []

    def counted(sockets, *others):
        ready = select.select(sockets, *others)
        waits.append(sum(each.getsockname()[0] == identity.address for each in ready[0]))
        return ready

    monkeypatch.setattr(device, "select", SimpleNamespace(select=counted))
    with ServedCamera(identity, Counted().image, CameraFaults(dies_after=0)):
        for number in range(1, 4):
            port.control.send(HEADER.pack(0x42, 1, 0x02, 0, number))
            while sum(waits) < number:
                time.sleep(0.01)
        count = len(waits)
        while len(waits) < count + 5:
            time.sleep(0.01)

    assert sum(waits) == 3
