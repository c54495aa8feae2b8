"""The Aravis driver on a served camera: what it gets, what it tries again, what it says when it cannot."""

import socket
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from served_scene import small_scene

from ringpose.capture.cameras import aravis, network
from ringpose.capture.cameras.aravis import AravisCamera
from ringpose.capture.uri import DeviceUri
from ringpose.errors import DeviceError, UsageError
from ringpose.simulate.serve.choices import Move
from ringpose.simulate.serve.device import CameraFaults, ServedCamera
from ringpose.simulate.serve.faults import parsed_faults
from ringpose.simulate.serve.registers import Identity
from ringpose.simulate.serve.stand_in import Setup, StandIn
from ringpose.wire.gvsp import StreamedFrame

pytestmark = pytest.mark.usefixtures("_aravis")


@pytest.fixture
def serve(tmp_path, loopback_address):
    """Start a stand-in with faults."""
    started = []

    def started_stand_in(*faults: str, **setup) -> StandIn:
        scene = small_scene(tmp_path)
        whole = Setup(address=loopback_address, move=Move.NEVER, faults=parsed_faults(faults, 3), **setup)
        started.append(StandIn(scene, whole).__enter__())
        return started[-1]

    yield started_stand_in
    for each in started:
        each.__exit__(None, None, None)


@pytest.fixture
def camera(loopback_address):
    """A driver with parameters, by the camera's address."""

    def driver(place: str = loopback_address, **parameters: str) -> AravisCamera:
        return AravisCamera(
            DeviceUri(text=f"aravis:{place}", option="--camera", scheme="aravis", place=place, parameters=parameters)
        )

    return driver


def test_a_camera_says_what_it_is(serve, camera):
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

    class Drawn:
        def image(self, began_s, exposure_s, gain_db, bits):
            sent.append(rng.integers(0, 1 << bits, (37, 53)).astype(np.uint8 if bits == 8 else np.uint16))
            return sent[-1], {}

    identity = Identity(address=loopback_address, width=53, height=37, bits=bits, exposure_s=0.001)
    with ServedCamera(identity, Drawn(), CameraFaults(loss=0.02)), (opened := camera(packet=packet)):
        frames = [opened.trigger(0) for _ in range(8)]

    np.testing.assert_array_equal([frame.image for frame in frames], [sent[frame.frame_id - 1] for frame in frames])


def test_a_frame_comes_after_its_exposure(serve, camera):
    serve()

    with (opened := camera()):
        opened.arm(0.2)
        before_s, began_s = time.time(), time.perf_counter()
        frame = opened.trigger(0b101)
        took_s = time.perf_counter() - began_s

    assert took_s > 0.2
    assert before_s <= frame.stamp_s < before_s + 0.15
    assert (frame.exposure_s, frame.lasers, frame.attempts, frame.gain_db) == (0.2, 0b101, 1, 0.0)


def test_frames_come_one_by_one_with_their_numbers_and_stamps(serve, camera):
    serve()

    with (opened := camera()):
        opened.arm(None)
        frames = [opened.trigger(0) for _ in range(5)]

    numbers = [frame.frame_id for frame in frames]
    assert numbers == list(range(numbers[0], numbers[0] + 5))
    clocks = np.array([[frame.stamp_s, frame.device_stamp_s] for frame in frames])
    np.testing.assert_allclose(np.diff(clocks[:, 0]), np.diff(clocks[:, 1]), atol=0.05)
    assert opened.dropped == 0


def test_an_output_line_lights_its_laser(serve, camera):
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
    stand_in = serve()

    with (opened := camera(format="Mono12", gain="6.0206")):
        short, longer = (opened.trigger(0, exposure_s) for exposure_s in (0.002, 0.008))

    black_dn = 16 * stand_in._scene.sensor.black_level_dn
    assert short.image.dtype == np.uint16
    assert opened.uri.parameters["gain"] == "6.0206"
    assert (longer.image.mean() - black_dn) / (short.image.mean() - black_dn) == pytest.approx(4.0, rel=0.05)
    assert longer.gain_db == pytest.approx(6.0206)


def test_lost_packets_are_sent_again(serve, camera):
    stand_in = serve("loss=0.02")

    with (opened := camera()):
        frames = [opened.trigger(0) for _ in range(60)]

    assert stand_in.camera.stream.lost_packets > 10
    assert sum(frame.attempts for frame in frames) == 60


def test_a_frame_that_stays_broken_is_taken_again(serve, camera):
    serve("loss=0.01", "no-resend")

    with (opened := camera()):
        frames = [opened.trigger(0) for _ in range(25)]

    assert max(frame.attempts for frame in frames) > 1
    assert {frame.image.shape for frame in frames} == {(150, 200)}


def test_a_camera_that_loses_every_frame_is_an_error_that_says_what_may_help(serve, camera, monkeypatch, tmp_path):
    serve("loss=0.9", "no-resend")
    (tmp_path / "rmem_max").write_text("212992\n")
    monkeypatch.setattr(network, "_RMEM_MAX", tmp_path / "rmem_max")

    with (opened := camera(timeout="0.3")), pytest.raises(DeviceError, match="3 times in a row") as raised:
        opened.trigger(0)

    assert "sysctl -w net.core.rmem_max=8388608" in str(raised.value)


def test_a_camera_that_dies_is_noticed(serve, camera):
    serve("dead-camera=2")

    with (opened := camera(timeout="0.3")):
        opened.trigger(0)
        opened.trigger(0)
        with pytest.raises(DeviceError, match=r"does not answer any more; check its cable"):
            opened.trigger(0)


def test_a_camera_is_opened_again_after_its_loss(serve, camera):
    serve()
    opened = camera()
    with opened:
        opened.trigger(0)

    with opened:
        frame = opened.trigger(0)

    assert frame.attempts == 1


def test_a_camera_in_other_hands_says_so(serve, camera):
    serve()

    with camera(), pytest.raises(DeviceError, match="is controlled by another program; close that one"):
        camera().open()


def test_a_camera_that_another_has_taken_meanwhile_says_so(serve, camera):
    stand_in = serve()

    with (opened := camera()):
        stand_in.camera._control._client = ("127.0.0.1", 1)
        with pytest.raises(DeviceError, match="is controlled by another program; close that one"):
            opened.set("Gain", 1.0)


def test_a_camera_that_is_not_there_says_so(camera):
    with pytest.raises(DeviceError, match=r"no such camera: .*; see ringpose capture --list"):
        camera().open()


def test_a_network_that_is_not_there_says_so(camera, monkeypatch):
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
def test_an_impossible_exposure_is_refused_with_its_bounds(serve, camera, exposure_s):
    serve()

    with (opened := camera()), pytest.raises(DeviceError, match=r"ExposureTime cannot be .*; it takes 10 to 1e\+06"):
        opened.arm(exposure_s)


def test_a_format_that_the_camera_lacks_is_refused_with_those_it_has(serve, camera):
    serve()

    with pytest.raises(DeviceError, match="PixelFormat cannot be Mono16; it takes Mono12, Mono8"):
        camera(format="Mono16").open()


def test_a_misspelt_parameter_is_wrong_usage(camera):
    with pytest.raises(UsageError, match='no parameter "fromat"; did you mean format'):
        camera(fromat="Mono8")


def test_an_unknown_format_is_wrong_usage(camera):
    with pytest.raises(UsageError, match='format "RGB8" is not known; say one of Mono8'):
        camera(format="RGB8")


@pytest.mark.parametrize("size", ["100", "20000"])
def test_an_impossible_packet_size_is_refused_with_its_bounds(serve, camera, size):
    serve()

    with pytest.raises(DeviceError, match=f"GevSCPSPacketSize cannot be {size}; it takes 576 to 16260"):
        camera(packet=size).open()


def test_packets_have_the_size_that_is_asked_for(serve, camera):
    stand_in = serve()

    with camera(packet="3000"):
        assert stand_in.camera.registers[0x0D04] == 3000


def test_pixels_that_are_not_grey_are_refused(serve, camera, monkeypatch):
    serve()
    monkeypatch.setattr(AravisCamera, "_format", lambda self: "BayerRG8")

    with pytest.raises(DeviceError, match=r"sends pixels in the format BayerRG8; ask for \?format=Mono8"):
        camera().open()


def test_a_frame_that_claims_to_be_larger_than_it_is_is_not_read(serve, camera, monkeypatch):
    serve()
    claimed = StreamedFrame._leader_payload
    monkeypatch.setattr(
        StreamedFrame,
        "_leader_payload",
        lambda frame: claimed(replace(frame, leader=replace(frame.leader, width=40000, height=40000))),
    )

    with (opened := camera(timeout="0.5")), pytest.raises(DeviceError, match="a frame was smaller than it said"):
        opened.trigger(0)


def test_frames_thrown_away_after_a_change_of_exposure(serve, camera):
    serve()

    with (opened := camera(skip="1")):
        first = opened.trigger(0, 0.005)
        changed = opened.trigger(0, 0.002)
        same = opened.trigger(0, 0.002)

    assert [changed.frame_id - first.frame_id, same.frame_id - changed.frame_id] == [2, 1]


def test_a_killed_client_frees_the_camera_by_its_heartbeat(serve, camera, loopback_address):
    """A client that takes control and is never heard again."""
    stand_in = serve()
    stand_in.camera.registers[0x0938] = 500
    silent = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    silent.settimeout(2.0)
    silent.sendto(bytes.fromhex("420100820008000100000a0000000002"), (loopback_address, 3956))
    assert silent.recv(64)[:2] == b"\0\0"
    silent.close()
    with pytest.raises(DeviceError, match="controlled by another program"):
        camera().open()

    threading.Event().wait(0.8)

    with (opened := camera()):
        assert opened.trigger(0).attempts == 1
