"""The Aravis driver with a virtual camera: frames, settings and repeated triggers."""

import socket
import time
from dataclasses import replace

import numpy as np
import pytest
from guarded_lasers import wait_for

from ringpose.capture.cameras.aravis import AravisCamera
from ringpose.errors import DeviceError
from ringpose.simulate.serve.device import CameraFaults, ServedCamera
from ringpose.simulate.serve.genicam import Identity
from ringpose.types.scene import Sensor
from ringpose.wire.gige_registers import HEARTBEAT_TIMEOUT
from ringpose.wire.gvsp import StreamedFrame

pytestmark = pytest.mark.usefixtures("_aravis")


def test_the_description_has_name_size_and_saturation(serve, camera):
    serve()

    with (opened := camera()):
        description = opened.describe()

        assert description.name.startswith("ringpose-Stand-in-RP")
        assert (description.image_width, description.image_height, description.saturation_dn) == (200, 150, 255)
        assert opened.bounds("ExposureTime") == (10.0, 1e6)
        assert opened.bounds("NoSuchFeature") is None


@pytest.mark.parametrize(("bits", "packet"), [(8, "1400"), (12, "1400"), (12, "9000")])
def test_every_pixel_comes_as_it_was_sent(camera, loopback_address, rng, bits, packet):
    sent = []

    def drawn(began_s, exposure_s, gain_db, bits):
        sent.append(rng.integers(0, 1 << bits, (37, 53)).astype(np.uint8 if bits == 8 else np.uint16))
        return sent[-1], {}

    identity = Identity(address=loopback_address, width=53, height=37, bits=bits, exposure_s=0.001)
    with ServedCamera(identity, drawn, CameraFaults(loss=0.02)), (opened := camera(packet=packet)):
        frames = [opened.trigger(0) for _ in range(8)]

    np.testing.assert_array_equal([frame.image for frame in frames], [sent[frame.frame_id - 1] for frame in frames])


def test_a_frame_arrives_after_its_exposure(serve, camera):
    serve()

    with (opened := camera()):
        opened.arm(0.2)
        before_s = time.time()
        frame = opened.trigger(0b101)
        after_s = time.time()

    assert after_s - before_s > 0.2
    assert before_s <= frame.stamp_s <= after_s - 0.1  # amid the trigger, which is answered before the exposure ends
    assert (frame.exposure_s, frame.lasers, frame.attempts, frame.gain_db) == (0.2, 0b101, 1, 0.0)


def test_each_trigger_gives_one_frame_with_number_and_stamps(serve, camera):
    serve()

    with (opened := camera()):
        opened.arm(None)
        times_s, frames = [time.time()], []
        for _ in range(5):
            frames.append(opened.trigger(0))
            times_s.append(time.time())

    numbers = [frame.frame_id for frame in frames]
    assert numbers == list(range(numbers[0], numbers[0] + 5))
    stamps_s, device_s = np.array([[frame.stamp_s, frame.device_stamp_s] for frame in frames]).T
    assert np.all((times_s[:-1] <= stamps_s) & (stamps_s <= times_s[1:]))
    assert np.max(times_s[:-1] - device_s) <= np.min(times_s[1:] - device_s)  # the clocks differ by a constant
    assert opened.dropped == 0


def test_an_output_line_switches_its_laser(serve, camera):
    serve()

    with (opened := camera()):
        opened.arm(0.005)
        dark = opened.trigger(0).image.astype(int)
        opened.set_output("Line2", True)
        lit = opened.trigger(2).image.astype(int)
        is_high = [opened.output(f"Line{number}") for number in (1, 2, 3)]

    assert (lit - dark).max() > 60
    assert is_high == [False, True, False]


def test_exposure_and_gain_change_the_image(serve, camera):
    serve()

    with (opened := camera(format="Mono12", gain="6.0206")):
        short, longer = (opened.trigger(0, exposure_s) for exposure_s in (0.002, 0.008))

    black_dn = 16 * Sensor().black_level_dn
    assert short.image.dtype == np.uint16
    assert opened.uri.parameters["gain"] == "6.0206"
    assert (longer.image.mean() - black_dn) / (short.image.mean() - black_dn) == pytest.approx(4.0, rel=0.05)
    assert longer.gain_db == pytest.approx(6.0206)


def test_lost_packets_are_sent_again(serve, camera):
    device = serve("loss=0.02")

    with (opened := camera()):
        frames = [opened.trigger(0) for _ in range(60)]

    lost = device.camera.stream.lost_packets
    assert lost > 10
    assert sum(frame.attempts - 1 for frame in frames) < lost / 4  # most frames are completed, not taken again


def test_an_incomplete_frame_is_triggered_again(serve, camera):
    serve("loss=0.01", "no-resend")

    with (opened := camera()):
        frames = [opened.trigger(0) for _ in range(25)]

    assert max(frame.attempts for frame in frames) > 1
    assert {frame.image.shape for frame in frames} == {(150, 200)}


def test_packets_have_the_requested_size(serve, camera):
    device = serve()

    with camera(packet="3000"):
        assert device.camera.registers[0x0D04] == 3000


def test_a_colour_pixel_format_is_rejected(serve, camera, monkeypatch):
    serve()
    monkeypatch.setattr(AravisCamera, "_format", lambda self: "BayerRG8")

    with pytest.raises(DeviceError, match=r"sends pixels in the format BayerRG8; use \?format=Mono8"):
        camera().open()


def test_a_frame_with_too_few_bytes_is_not_read(serve, camera, monkeypatch):
    serve()
    claimed = StreamedFrame._leader_payload
    monkeypatch.setattr(
        StreamedFrame,
        "_leader_payload",
        lambda frame: claimed(replace(frame, leader=replace(frame.leader, width=40000, height=40000))),
    )

    with (opened := camera(timeout="0.5")), pytest.raises(DeviceError, match="a frame was smaller than declared"):
        opened.trigger(0)


def test_frames_after_a_change_of_exposure_are_discarded(serve, camera):
    serve()

    with (opened := camera(skip="1")):
        first = opened.trigger(0, 0.005)
        changed = opened.trigger(0, 0.002)
        same = opened.trigger(0, 0.002)

    assert [changed.frame_id - first.frame_id, same.frame_id - changed.frame_id] == [2, 1]


def test_a_camera_is_free_after_the_heartbeat_timeout_of_a_killed_client(serve, camera, loopback_address):
    """A client that gets control and then sends no heartbeat."""
    device = serve()
    device.camera.registers[HEARTBEAT_TIMEOUT] = 600_000
    silent = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    silent.settimeout(60.0)
    silent.sendto(bytes.fromhex("420100820008000100000a0000000002"), (loopback_address, 3956))
    assert silent.recv(64)[:2] == b"\0\0"
    silent.close()
    with pytest.raises(DeviceError, match="controlled by another program"):
        camera().open()

    device.camera.registers[HEARTBEAT_TIMEOUT] = 500
    wait_for(lambda: device.camera._control.client is None)

    with camera() as opened:
        assert opened.trigger(0).image.shape == (150, 200)
