"""The client of the image server: shots from frames, reconnection, and servers that break the protocol."""

import json
import socket
import struct
import threading
from contextlib import ExitStack, suppress

import numpy as np
import pytest
from quick_views import quick_view
from served_scene import small_scene

from ringpose.capture.cameras.simulated import SimulatedLasers
from ringpose.capture.cameras.tcp import TcpCamera
from ringpose.capture.pipeline import Procedure, captured_shots
from ringpose.capture.uri import CAMERAS, device_uri
from ringpose.errors import DeviceError, UsageError
from ringpose.files.records import plain
from ringpose.files.records.truths import truth_record
from ringpose.simulate.serve import image_camera
from ringpose.simulate.serve.images import ImageServer, ImageSetup
from ringpose.types.session import parsed_sequence


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return small_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(autouse=True)
def _quick_views(monkeypatch):
    monkeypatch.setattr(image_camera, "render_ring_view", quick_view)


def server_of(scene, **setup):
    return ImageServer(scene, ImageSetup(**{"rate_hz": 100.0} | setup), lambda truth: plain(truth_record(truth)))


def camera_at(port, parameters="", **options):
    return TcpCamera(device_uri(f"tcp://127.0.0.1:{port}{parameters}", "--camera", CAMERAS), **options)


def shots_of(camera, count, sequence="off,all", **options):
    lasers = SimulatedLasers(3)
    procedure = Procedure(steps=parsed_sequence(sequence), **options)
    with camera, lasers:
        yield from captured_shots(camera, lasers, procedure, map(str, range(count)))


def first_frame(camera):
    with camera:
        camera.arm(None)
        return camera.trigger(1)


@pytest.mark.parametrize("clock", ["wall", "lockstep"])
def test_shots_are_those_of_the_server(scene, clock):
    with server_of(scene, clock=clock) as server:
        camera = camera_at(server.port)
        shots = list(shots_of(camera, 3))

    assert len({shot.name for shot in shots}) == 3
    for shot in shots:
        assert shot.lasers.tolist() == [0, 7]
        assert np.diff(shot.frame_id).tolist() == [1]
        assert shot.images[1].max() > shot.images[0].max() + 50
        assert shot.meta["saturation_dn"] == 255


def test_in_lockstep_no_shot_is_lost_however_slow_the_client(scene):
    with server_of(scene, clock="lockstep") as server:
        numbers = []
        for shot in shots_of(camera_at(server.port), 4):
            threading.Event().wait(0.05)
            numbers += shot.frame_id.tolist()

    assert numbers == list(range(1, 9))


def test_the_exposure_that_is_asked_for_is_taken(scene):
    with server_of(scene) as server:
        shots = list(shots_of(camera_at(server.port), 1, exposure_s=0.002))

    assert shots[0].exposure_s.tolist() == [0.002, 0.002]


def test_an_exposure_beyond_the_cameras_bounds_is_wrong_usage(scene):
    with server_of(scene) as server, pytest.raises(UsageError, match="exposure"):
        list(shots_of(camera_at(server.port), 1, exposure_s=0.05))


def test_lasers_that_no_frame_of_the_server_has_are_wrong_usage(scene):
    with server_of(scene) as server, pytest.raises(UsageError, match="off,all"):
        list(shots_of(camera_at(server.port), 1, sequence="off,1"))


def test_a_lost_server_is_reported_at_once_and_the_client_resumes_when_it_is_back(scene):
    messages = []
    with server_of(scene) as first, ExitStack() as later:

        def restart(message):
            messages.append(message)
            later.enter_context(server_of(scene, port=first.port))

        shots = shots_of(camera_at(first.port), 4, report=restart)
        before = [next(shots) for _ in range(2)]
        first.__exit__(None, None, None)
        after = list(shots)

    assert len(before) == len(after) == 2
    assert all(shot.lasers.tolist() == [0, 7] for shot in after)
    assert len(messages) == 1
    assert "lost" in messages[0]


def test_a_server_that_stays_away_ends_the_capture_after_the_last_attempt(scene, monkeypatch):
    monkeypatch.setattr("ringpose.capture.pipeline.RECONNECT_PAUSES_S", (0.0, 0.01))
    messages = []
    with server_of(scene) as server:
        shots = shots_of(camera_at(server.port), 2, report=messages.append)
        next(shots)
    with pytest.raises(DeviceError, match="cannot be connected"):
        next(shots)

    assert len(messages) == 1


def test_no_server_is_a_device_error_at_once():
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]

    with pytest.raises(DeviceError, match="cannot be connected"):
        camera_at(port).open()


@pytest.mark.parametrize(("secret", "finding"), [(None, "secret"), (b"another secret", "secret is wrong")])
def test_a_client_without_the_secret_is_told_so(scene, secret, finding):
    with server_of(scene, secret=b"the secret of a test") as server:
        with pytest.raises(DeviceError, match=finding):
            first_frame(camera_at(server.port, secret=secret))
        with camera_at(server.port, secret=b"the secret of a test"):
            pass


def packed(header, payload=b""):
    text = json.dumps(header).encode()
    return b"RPI1" + struct.pack(">II", len(text), len(payload)) + text + payload


GREETING = {
    "type": "greeting",
    "protocol": "ringpose/images/1",
    "clock": "wall",
    "rate_hz": 5.0,
    "camera_name": "c",
    "image_width": 3,
    "image_height": 2,
    "saturation_dn": 255,
    "lasers": ["left"],
    "sequence": [1],
    "min_exposure_s": 0.0,
    "max_exposure_s": 1.0,
}
FRAME = {
    "type": "frame",
    "frame_id": 1,
    "shot": "a",
    "step": 0,
    "lasers": 1,
    "stamp_s": 0.0,
    "exposure_s": 0.01,
    "width": 3,
    "height": 2,
    "pixel_bytes": 1,
    "dropped": 0,
    "missed": 0,
}


@pytest.mark.parametrize(
    "answer",
    [
        b"HTTP/1.1 200 OK\r\n\r\n",
        packed(GREETING | {"protocol": "ringpose/images/9"}),
        packed({"type": "error", "message": "go away"}),
        packed(GREETING) + packed(FRAME | {"width": 4}, bytes(8)),
        packed(GREETING) + packed(FRAME, bytes(5)),
        packed(GREETING) + packed(FRAME | {"shot": "a\nb"}, bytes(6)),
        packed(GREETING) + b"RPI1" + struct.pack(">II", 2, 1 << 30) + b"{}",
        packed(GREETING) + packed(FRAME, bytes(6))[:-3],
        packed(GREETING) + packed({"type": "error", "message": "too slow"}),
    ],
)
def test_a_server_that_breaks_the_protocol_is_a_device_error(answer):
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve():
            connection, _ = listening.accept()
            with connection, suppress(OSError):  # the client may have closed the connection already
                connection.sendall(answer)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(1000):
                    pass

        thread = threading.Thread(target=serve)
        thread.start()
        camera = camera_at(listening.getsockname()[1])
        with pytest.raises(DeviceError):
            first_frame(camera)
        thread.join()


def test_a_server_that_says_nothing_is_a_device_error(scene):
    with server_of(scene, clock="lockstep") as server:
        holding, waiting = camera_at(server.port), camera_at(server.port, "?timeout=2")
        with holding, waiting:
            holding.arm(None)
            for mask in holding.greeting.sequence:
                holding.trigger(mask)
            waiting.arm(None)  # the next shot begins when `holding` asks for it, too
            with pytest.raises(DeviceError, match="nothing for"):
                waiting.trigger(0)


@pytest.mark.parametrize("address", ["127.0.0.1", ":5000", "127.0.0.1:0", "127.0.0.1:x", "127.0.0.1:70000"])
def test_an_address_without_host_and_port_is_wrong_usage(address):
    with pytest.raises(UsageError, match="host and port"):
        TcpCamera(device_uri(f"tcp://{address}", "--camera", CAMERAS))
