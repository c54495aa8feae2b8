"""The image server, as clients see it that are written from its manual page alone."""

import asyncio
import hashlib
import hmac
import json
import random
import socket
import struct
import threading
import time
import urllib.error
import urllib.request
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from quick_views import quick_view
from served_scene import small_scene

from ringpose.errors import DataError, DeviceError, UsageError
from ringpose.files.records import plain
from ringpose.files.records.truths import truth_record
from ringpose.geometry.ring import rotation_by
from ringpose.simulate.pipeline import render_ring_view
from ringpose.simulate.placement import ring_views
from ringpose.simulate.serve import image_camera, image_clients, images
from ringpose.simulate.serve.image_camera import RenderedShot
from ringpose.simulate.serve.images import ImageServer, ImageSetup
from ringpose.types.target import FreeMotion


class ImageClient:
    """A connection; `frame()` and `answer()` read messages of one kind and keep those of the other."""

    def __init__(self, port, *, secret=None, receive_buffer=None, timeout_s=120.0, hello=True):
        self.socket = socket.socket()
        if receive_buffer is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.settimeout(timeout_s)
        self.socket.connect(("127.0.0.1", port))
        self.greeting = None
        if hello:
            self.send(type="hello", protocol="ringpose/images/1")
            self.greeting, _ = self.message()
            if self.greeting["type"] == "challenge":
                text = b"ringpose images client:" + self.greeting["nonce"].encode()
                self.send(type="proof", proof=hmac.new(secret, text, hashlib.sha256).hexdigest())
                self.greeting, _ = self.message()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, **header):
        text = json.dumps(header).encode()
        self.socket.sendall(b"RPI1" + struct.pack(">II", len(text), 0) + text)

    def ask(self, **header):
        """Send a request and return its answer; frames that come before it are skipped."""
        self.send(**header)
        while True:
            answer, _ = self.message()
            if answer["type"] != "frame":
                return answer

    def message(self):
        magic, header_bytes, payload_bytes = struct.unpack(">4sII", self._read(12))
        assert magic == b"RPI1"
        return json.loads(self._read(header_bytes)), self._read(payload_bytes)

    def frame(self):
        header, payload = self.message()
        assert header["type"] == "frame", header
        image = np.frombuffer(payload, f"<u{header['pixel_bytes']}").reshape(header["height"], header["width"])
        return header, image

    def frames(self, count, **subscription):
        self.send(type="subscribe", frames=count, **subscription)
        return [self.frame() for _ in range(count)]

    def ends(self):
        """Whether the server closes the connection without another message."""
        try:
            return self.socket.recv(1) == b""
        except ConnectionResetError:
            return True

    def _read(self, size):
        data = b""
        while len(data) < size:
            part = self.socket.recv(min(size - len(data), 1 << 20))
            if not part:
                raise EOFError(data)
            data += part
        return data


SECRET = b"a secret of the test"


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return small_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture
def serve(scene, monkeypatch):
    monkeypatch.setattr(image_camera, "render_ring_view", quick_view)
    servers = []

    def started(served=scene, report=None, on_truth=None, **setup):
        server = ImageServer(
            served, ImageSetup(**{"rate_hz": 50.0} | setup), lambda t: plain(truth_record(t)), on_truth, report
        )
        server.__enter__()
        servers.append(server)
        return server

    yield started
    for server in servers:
        server.__exit__(None, None, None)


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def test_the_greeting_states_clock_rate_camera_and_sequence(serve, scene):
    with ImageClient(serve(clock="lockstep", rate_hz=20.0).port) as client:
        greeting = client.greeting

    assert greeting["protocol"] == "ringpose/images/1"
    assert (greeting["clock"], greeting["rate_hz"]) == ("lockstep", 20.0)
    assert (greeting["image_width"], greeting["image_height"]) == (200, 150)
    assert greeting["sequence"] == list(scene.sequence)


def test_a_client_receives_whole_shots_with_the_masks_of_the_sequence(serve, scene):
    with ImageClient(serve().port) as client:
        frames = client.frames(3 * len(scene.sequence), whole_shots=True)

    headers = [header for header, _ in frames]
    assert [header["lasers"] for header in headers] == 3 * list(scene.sequence)
    assert [header["step"] for header in headers] == 3 * list(range(len(scene.sequence)))
    assert len({header["shot"] for header in headers}) == 3
    assert np.all(np.diff([header["frame_id"] for header in headers]) == 1)
    by_mask = {header["lasers"]: int(image.max()) for header, image in frames}
    assert by_mask[7] > by_mask[0] + 50


def test_frames_are_the_same_for_all_clients_and_carry_the_truth_of_their_shot(serve, scene):
    with ImageClient(port := serve(clock="lockstep").port) as first, ImageClient(port) as second:
        first.send(type="subscribe", frames=4, whole_shots=True)
        second.send(type="subscribe", frames=4, whole_shots=True)
        pairs = [(first.frame(), second.frame()) for _ in range(4)]

    for (one, image), (other, same) in pairs:
        assert one == other
        np.testing.assert_array_equal(image, same)
    views = ring_views(scene)
    for number, (header, _) in enumerate(pairs[k][0] for k in (0, 2)):
        np.testing.assert_allclose(header["truth"]["center_m"], views[number].center_m, atol=1e-12)
        assert header["truth"]["shot"] == header["shot"]


def test_images_of_twelve_bits_are_not_rounded(serve, scene):
    sensor = replace(scene.sensor, bits=12, overall_system_gain_dn_per_e=0.33, black_level_dn=32.0)
    with ImageClient(serve(replace(scene, sensor=sensor)).port) as client:
        (header, image), *_ = client.frames(1)

    assert header["pixel_bytes"] == 2
    assert client.greeting["saturation_dn"] == 4095
    assert len(np.unique(image % 16)) == 16


def test_lockstep_time_advances_by_the_rate_and_only_while_every_subscriber_waits(serve, scene):
    with ImageClient(port := serve(clock="lockstep", rate_hz=40.0).port) as first, ImageClient(port) as second:
        second.send(type="subscribe", frames=1)
        first.send(type="subscribe", frames=3)
        before = [first.frame()[0]["stamp_s"]]
        second.frame()
        first.socket.settimeout(0.3)
        with pytest.raises(TimeoutError):  # the second client is busy
            first.frame()
        first.socket.settimeout(120.0)
        second.send(type="unsubscribe")
        before += [first.frame()[0]["stamp_s"] for _ in range(2)]

    np.testing.assert_allclose(before, scene.start_s + np.arange(3) / 40.0, atol=1e-6)


def test_a_client_that_leaves_does_not_hold_up_lockstep(serve):
    port = serve(clock="lockstep").port
    with ImageClient(port) as first:
        with ImageClient(port) as second:
            second.send(type="subscribe", frames=1)
            first.frames(1)
        assert len(first.frames(5)) == 5


def test_wall_clock_stamps_are_the_time_of_day_at_the_rate(serve, monkeypatch):
    """The time of day is that of the last reading of the loop's clock: a busy machine may pause between two."""
    epoch_s = time.time() - time.monotonic()
    readings_s = [time.monotonic()]

    def monotonic(_):
        readings_s[:] = [time.monotonic()]
        return readings_s[0]

    monkeypatch.setattr(asyncio.BaseEventLoop, "time", monotonic)
    monkeypatch.setattr(images, "time", SimpleNamespace(time=lambda: epoch_s + readings_s[0]))
    began_s = epoch_s + time.monotonic()
    with ImageClient(serve(rate_hz=50.0).port) as client:
        stamps = np.array([header["stamp_s"] for header, _ in client.frames(20)])

    assert began_s < stamps[0] < stamps[-1] < epoch_s + time.monotonic()
    slots = (stamps - stamps[0]) * 50.0
    np.testing.assert_allclose(slots, np.round(slots), atol=0.001)
    assert np.all(np.diff(np.round(slots)) >= 1)


def test_frames_that_cannot_be_rendered_in_time_are_dropped_and_counted(serve, monkeypatch):
    server = serve(rate_hz=100.0)
    exposed, slow_s = RenderedShot.frame, 0.05 * images.WORKERS
    monkeypatch.setattr(RenderedShot, "frame", lambda *words: (time.sleep(slow_s), exposed(*words))[1])
    with ImageClient(server.port) as client:
        headers = [header for header, _ in client.frames(8)]

    assert headers[-1]["dropped"] - headers[0]["dropped"] >= 7 * 3
    assert np.all(np.diff([header["frame_id"] for header in headers]) == 1)


def test_nothing_is_rendered_while_nobody_watches(serve, scene, monkeypatch):
    rendered = []
    exposed = RenderedShot.frame
    monkeypatch.setattr(RenderedShot, "frame", lambda *words: (rendered.append(1), exposed(*words))[1])
    with ImageClient(serve(rate_hz=100.0).port) as client:
        time.sleep(0.1)
        assert not rendered
        client.frames(1)
    time.sleep(0.1)
    assert (
        len(rendered) <= images.WORKERS + len(scene.sequence) - 1
    )  # those begun before the first was sent, and its shot


def receive(port, headers, count, pause=None, receive_buffer=None):
    """Receive the headers of frames up to the number `count` from the first; pause after ten of them."""
    with ImageClient(port, receive_buffer=receive_buffer, timeout_s=120.0) as client:
        client.send(type="subscribe")
        while not headers or headers[-1]["frame_id"] < headers[0]["frame_id"] + count - 1:
            headers.append(client.frame()[0])
            if pause is not None and len(headers) == 10:
                pause()


@pytest.mark.parametrize(
    ("rate_hz", "count", "queued", "stops_s", "others"),
    [(15.0, 75, 30, 0.0, 60), pytest.param(20.0, 1000, 60, 10.0, 400, marks=pytest.mark.slow)],
)
def test_a_client_that_stops_reading_is_skipped_and_others_lose_nothing(
    serve, monkeypatch, rate_hz, count, queued, stops_s, others
):
    """One of three clients stops until the others have most frames, in the slow case for at least 10 s."""
    monkeypatch.setattr(image_clients, "MAX_QUEUED", queued)  # a busy machine may stop the other clients for seconds
    port, steady, stopping = serve(rate_hz=rate_hz).port, ([], []), []
    threads = [threading.Thread(target=receive, args=(port, headers, count)) for headers in steady]
    for thread in threads:
        thread.start()

    def pause():
        time.sleep(stops_s)
        while min(map(len, steady)) < others:
            time.sleep(0.01)

    receive(port, stopping, count, pause, receive_buffer=4096)
    for thread in threads:
        thread.join()

    for headers in steady:
        assert len(headers) == count
        assert np.all(np.diff([header["frame_id"] for header in headers]) == 1)
    missed = [header["missed"] for header in stopping]
    assert sum(missed) > 0
    np.testing.assert_array_equal(missed[1:], np.diff([header["frame_id"] for header in stopping]) - 1)


def test_settings_change_from_the_frame_that_the_answer_names(serve):
    with ImageClient(serve().port) as client:
        client.send(type="subscribe")
        from_frame = client.ask(type="lasers", mask=5)["from_frame"]
        masks = {}
        while not masks or max(masks) < from_frame + 4:
            header, _ = client.frame()
            masks[header["frame_id"]] = header["lasers"]
        assert all(mask == 5 for number, mask in masks.items() if number >= from_frame)
        from_frame = client.ask(type="exposure", exposure_s=0.002)["from_frame"]
        while (header := client.frame()[0])["frame_id"] < from_frame:
            pass
        assert header["exposure_s"] == 0.002


def test_a_pose_is_shown_from_the_next_shot_and_a_trajectory_one_pose_a_shot(serve, scene):
    poses = [{"center_m": [0.58, 0.0, 0.5 + 0.01 * k], "normal": [0.0, 0.0, -2.0]} for k in range(2)]
    with ImageClient(serve(clock="lockstep").port) as client:
        client.frames(1)
        assert client.ask(type="pose", center_m=[0.57, 0.01, 0.6], normal=[0, 0, -1])["from_frame"] == 3
        headers = [header for header, _ in client.frames(5)]
        assert np.abs(np.array(headers[0]["truth"]["center_m"]) - [0.57, 0.01, 0.6]).max() > 1e-3
        shown = [header["truth"]["center_m"] for header in headers[1:]]
        np.testing.assert_allclose(shown, 4 * [[0.57, 0.01, 0.6]], atol=1e-12)
        client.ask(type="trajectory", poses=poses)
        centers = [header["truth"]["center_m"] for header, _ in client.frames(6)][::2]
        np.testing.assert_allclose(centers, [poses[each]["center_m"] for each in (0, 1, 0)], atol=1e-12)
        client.ask(type="trajectory")
        (header, _), *_ = client.frames(2)
        np.testing.assert_allclose(header["truth"]["center_m"], ring_views(scene)[0].center_m, atol=1e-12)


def test_time_continues_where_it_is_set_and_stands_while_paused(serve, scene):
    views = [view.center_m.tolist() for view in ring_views(scene)]
    with ImageClient(serve(clock="lockstep", rate_hz=50.0).port) as client:
        client.ask(type="time", time_s=2 * 2 / 50.0 + 1e-6, paused=True)
        paused = [header["truth"]["center_m"] for header, _ in client.frames(4)]
        client.ask(type="time", time_s=1 * 2 / 50.0 + 1e-6)
        running = [header["truth"]["center_m"] for header, _ in client.frames(4)]

    np.testing.assert_allclose(paused, 4 * [views[2]], atol=1e-12)
    np.testing.assert_allclose(running, [views[1], views[1], views[2], views[2]], atol=1e-12)


def test_a_shot_shows_one_view_although_the_time_is_set_meanwhile(serve):
    with ImageClient(serve(clock="lockstep").port) as client:
        (first, _), *_ = client.frames(1)
        assert client.ask(type="time", time_s=2 * 2 / 50.0 + 1e-6)["from_frame"] == 3
        (second, _), (third, _) = client.frames(2)

    assert (first["step"], second["step"], third["step"]) == (0, 1, 0)
    assert first["truth"] == second["truth"]
    assert third["truth"]["center_m"] != first["truth"]["center_m"]


DRIFT_M_S = np.array([0.2, 0.0, 0.0])
DRIFT = FreeMotion(
    inertia_kg_m2=np.eye(3),
    center_of_mass_m=np.zeros(3),
    angular_velocity_rad_s=np.zeros(3),
    velocity_m_s=DRIFT_M_S,
)


@pytest.fixture
def drifting(scene):
    """The scene with a target that drifts without turning, for 1 s."""
    return replace(scene, motion=DRIFT, shots=11, period_s=0.1, approaches=scene.approaches[:1])


def rendered_at(scene, truth_frame, mask):
    """Electrons of a still target at a pose of the truth, rendered with these lasers."""
    view = replace(
        ring_views(replace(scene, motion=None, shots=1))[0],
        center_m=np.array(truth_frame["center_m"]),
        normal=np.array(truth_frame["normal"]),
    )
    return render_ring_view(replace(scene, motion=None), view, 0).electrons(mask, 0.005)


def test_every_frame_of_a_moving_target_is_rendered_at_its_own_stamp(serve, drifting):
    server = serve(drifting, clock="lockstep", rate_hz=10.0)
    with ImageClient(server.port) as client:
        frames = client.frames(4, whole_shots=True)

    start_m = np.array(frames[0][0]["truth"]["frames"][0]["center_m"])
    for header, _ in frames:
        own = header["truth"]["frames"][header["step"]]
        assert own["stamp_s"] == pytest.approx(header["stamp_s"] + header["exposure_s"] / 2, abs=1e-6)
        since_s = own["stamp_s"] - frames[0][0]["truth"]["frames"][0]["stamp_s"]
        np.testing.assert_allclose(np.array(own["center_m"]) - start_m, since_s * DRIFT_M_S, atol=1e-6)

    _, image = frames[3]
    poses = [frames[step][0]["truth"]["frames"][step % 2] for step in range(4)]
    alike = [np.corrcoef(rendered_at(drifting, pose, 7).ravel(), image.ravel())[0, 1] for pose in poses]
    assert alike[3] > max(alike[:3]) + 0.02


def test_the_motion_is_that_of_the_stamps_also_between_shots_and_starts_again_at_its_end(serve, drifting):
    with ImageClient(serve(drifting, clock="lockstep", rate_hz=10.0).port) as client:
        truths = [header["truth"] for header, _ in client.frames(2 * 8)[::2]]

    stamps_s, x_m = (np.array([truth[key] for truth in truths]) for key in ("stamp_s", "center_m"))
    moved_m = np.diff(x_m[:, 0])
    continued = moved_m > 0
    np.testing.assert_allclose(moved_m[continued], np.diff(stamps_s)[continued] * DRIFT_M_S[0], atol=1e-6)
    assert continued.sum() == 6
    assert truths[0]["velocity_m_s"] == pytest.approx(DRIFT_M_S.tolist(), abs=1e-9)


def test_a_pose_with_velocities_moves_from_frame_to_frame_and_begins_anew_with_each_shot(serve, scene):
    velocity_m_s, rate_rad_s = np.array([0.1, 0.0, -0.05]), np.array([0.0, 0.02, 0.0])
    pose = {"center_m": [0.55, 0.02, 0.5], "normal": [0.0, 0.0, -1.0], "roll_rad": 0.3}
    with ImageClient(serve(clock="lockstep", rate_hz=10.0).port) as client:
        rates = {"velocity_m_s": velocity_m_s.tolist(), "angular_velocity_rad_s": rate_rad_s.tolist()}
        assert client.ask(type="pose", **pose, **rates)["from_frame"] == 1
        shots = [client.frames(len(scene.sequence)) for _ in range(2)]

    for frames in shots:
        truth, begin_s = frames[0][0]["truth"], frames[0][0]["stamp_s"]
        for frame in truth["frames"]:
            since_s = frame["stamp_s"] - begin_s
            np.testing.assert_allclose(frame["center_m"], pose["center_m"] + velocity_m_s * since_s, atol=1e-6)
            turned = rotation_by(rate_rad_s * since_s) @ pose["normal"]
            np.testing.assert_allclose(frame["normal"], turned, atol=1e-6)
        np.testing.assert_allclose(truth["velocity_m_s"], velocity_m_s, atol=1e-6)
    assert len({frame["stamp_s"] for frames in shots for frame in frames[0][0]["truth"]["frames"]}) > 2


def test_a_moving_target_stands_while_the_time_is_paused(serve, drifting):
    with ImageClient(serve(drifting, clock="lockstep", rate_hz=10.0).port) as client:
        first = client.frames(2)[0][0]["truth"]["frames"]
        client.ask(type="time", time_s=0.5, paused=True)
        truths = [header["truth"] for header, _ in client.frames(4)]

    centers_m = np.array([frame["center_m"] for truth in truths for frame in truth["frames"]])
    np.testing.assert_allclose(np.ptp(centers_m, axis=0), 0.0, atol=1e-9)
    middle_s = first[0]["stamp_s"] - drifting.start_s
    np.testing.assert_allclose(centers_m[0] - first[0]["center_m"], (0.5 - middle_s) * DRIFT_M_S, atol=1e-6)
    np.testing.assert_allclose(truths[0]["velocity_m_s"], 0.0, atol=1e-9)


def test_a_setting_of_a_moving_target_concerns_the_next_shot(serve, drifting):
    with ImageClient(serve(drifting, clock="lockstep", rate_hz=10.0).port) as client:
        client.frames(1)
        assert client.ask(type="exposure", exposure_s=0.002)["from_frame"] == 3
        assert [header["exposure_s"] for header, _ in client.frames(2)] == [0.005, 0.002]


@pytest.mark.parametrize(
    "request_header",
    [
        {"type": "lasers", "mask": 8},
        {"type": "exposure", "exposure_s": 1.0},
        {"type": "pose", "center_m": [0, 0, 1], "normal": [0, 0, -1], "light": "moon"},
        {"type": "pose", "center_m": [0.5, 0, 0.5], "normal": [8, 0, -1]},
    ],
)
def test_what_the_scene_cannot_do_is_refused_and_the_connection_stays(serve, request_header):
    with ImageClient(serve().port) as client:
        assert client.ask(**request_header)["type"] == "refused"
        assert len(client.frames(1)) == 1


BAD_INPUT = {
    "text": b"hello, are you there?\r\n\r\n",
    "wrong magic": b"RPI9" + struct.pack(">II", 2, 0) + b"{}",
    "header too long": b"RPI1" + struct.pack(">II", 1 << 31, 0),
    "payload": b"RPI1" + struct.pack(">II", 2, 5) + b"{}",
    "no JSON": b"RPI1" + struct.pack(">II", 4, 0) + b"{abc",
    "no hello": b"RPI1" + struct.pack(">II", 2, 0) + b"{}",
    "HTTP without end": b"GET /" + b"a" * 100_000,
    "HTTP without address": b"GET http://[ HTTP/1.1\r\n\r\n",
}


@pytest.mark.parametrize("data", BAD_INPUT.values(), ids=BAD_INPUT)
def test_malformed_input_closes_that_connection_with_one_message(serve, data):
    messages = []
    server = serve(report=messages.append)
    with ImageClient(server.port, hello=False) as bad:
        with suppress(OSError):
            bad.socket.sendall(data)
        with suppress(ConnectionResetError):
            answer, _ = bad.message()
            assert answer["type"] == "error"
            assert bad.ends()
    with ImageClient(server.port) as good:
        assert len(good.frames(1)) == 1

    assert len(messages) == server.rejected == 1


def test_truncated_input_closes_the_connection_with_one_message(serve):
    messages = []
    with ImageClient(serve(report=messages.append).port) as client:
        client.socket.sendall(b"RPI1" + struct.pack(">II", 100, 0) + b"{")
        client.socket.shutdown(socket.SHUT_WR)
        assert client.message()[0]["type"] == "error"
        assert client.ends()

    assert len(messages) == 1


@pytest.mark.parametrize("begun", [b"", b"RPI1" + bytes(1), b"GET / HTTP/1.1\r\n"])
def test_input_that_stalls_closes_the_connection_with_one_message(serve, monkeypatch, begun):
    monkeypatch.setattr(images, "HANDSHAKE_S", 0.1)
    monkeypatch.setattr(image_clients, "MESSAGE_S", 0.1)
    messages = []
    with ImageClient(serve(report=messages.append).port, hello=False) as client:
        client.socket.sendall(begun)
        assert client.message()[0]["type"] == "error"
        assert client.ends()

    assert len(messages) == 1


def test_one_client_too_many_is_turned_away(serve, monkeypatch):
    monkeypatch.setattr(images, "MAX_CLIENTS", 1)
    port = serve().port
    with ImageClient(port) as first, ImageClient(port, hello=False) as second:
        assert second.message()[0]["type"] == "error"
        assert len(first.frames(1)) == 1


def test_connections_beyond_the_limit_are_closed_at_once(serve, monkeypatch):
    monkeypatch.setattr(images, "MAX_CONNECTIONS", 2)
    port = serve().port
    with ImageClient(port) as first, ImageClient(port, hello=False), ImageClient(port, hello=False) as third:
        assert third.ends()
        assert len(first.frames(1)) == 1


def fuzz(port, count, seed):
    """Connections with headers of which a few bytes are changed, or that are random altogether."""
    generator = random.Random(seed)
    good = [
        {"type": "hello", "protocol": "ringpose/images/1"},
        {"type": "subscribe", "frames": 1},
        {"type": "pose", "center_m": [0.5, 0.0, 0.5], "normal": [0, 0, -1]},
        {"type": "trajectory", "poses": [{"center_m": [0, 0, 1], "normal": [0, 0, -1]}] * 20},
    ]
    for number in range(count):
        texts = [json.dumps(header).encode() for header in good]
        data = bytearray(b"".join(b"RPI1" + struct.pack(">II", len(text), 0) + text for text in texts))
        start = generator.choice([0, 4, 12, 60])
        for _ in range(generator.choice([1, 3, 20])):
            data[generator.randrange(start, len(data))] = generator.randrange(256)
        if number % 5 == 0:
            data = bytearray(generator.randbytes(generator.randrange(1, 200)))
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 5.0) as client:
            client.sendall(data[: generator.randrange(1, len(data) + 1)])
            client.shutdown(socket.SHUT_WR)
            while client.recv(1 << 16):
                pass


@pytest.mark.parametrize("count", [150, pytest.param(10_000, marks=pytest.mark.slow)])
def test_fuzzed_headers_leave_the_server_alive_and_its_memory_flat(serve, monkeypatch, count):
    monkeypatch.setattr(image_camera, "KEPT_BYTES", 1)  # views that are kept would hide a leak
    server = serve(rate_hz=100.0)
    with ImageClient(server.port) as client:  # what the first frames import and keep is not a leak
        client.frames(8)
    fuzz(server.port, count // 2, seed=1)
    before = resident_bytes()

    fuzz(server.port, count, seed=2)

    assert resident_bytes() - before < 10e6
    assert server.rejected > count // 2
    with ImageClient(server.port) as client:
        assert len(client.frames(2)) == 2


def test_a_client_with_the_secret_is_admitted_and_others_are_not(serve):
    port = serve(secret=SECRET).port
    with ImageClient(port, secret=SECRET) as client:
        assert client.greeting["type"] == "greeting"
        assert len(client.frames(1)) == 1
    with ImageClient(port, secret=b"another secret, wrong") as client:
        assert client.greeting["type"] == "error"
    with ImageClient(port, hello=False) as client:
        client.send(type="hello", protocol="ringpose/images/1")
        assert client.message()[0]["type"] == "challenge"
        client.send(type="subscribe", frames=1)
        assert client.message()[0]["type"] == "error"


def test_browsers_receive_pictures_of_the_frames_with_all_lasers(serve):
    server = serve()
    with urllib.request.urlopen(server.uris["stream"], timeout=120) as stream:
        assert stream.headers["Content-Type"].startswith("multipart/x-mixed-replace")
        lines = [stream.readline() for _ in range(4)]
        length = int(lines[2].split(b":")[1])
        picture = cv2.imdecode(np.frombuffer(stream.read(length), np.uint8), cv2.IMREAD_GRAYSCALE)

    assert picture.shape == (150, 200)
    assert picture.max() > 100


def status_of(url, **headers):
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=120) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def test_browsers_need_the_token_of_a_server_with_a_secret(serve):
    server = serve(secret=SECRET)
    page = server.uris["stream"].replace("/stream.mjpg", "/")

    statuses = [status_of(url) for url in (page.partition("?")[0], page.partition("=")[0] + "=0", page)]

    assert statuses == [403, 403, 200]
    assert SECRET.decode() not in server.uris["stream"]


def test_a_page_from_elsewhere_cannot_read_the_stream_under_its_own_name(serve):
    server = serve()
    address = f"http://127.0.0.1:{server.port}/"

    assert status_of(address, Host="example.org") == 403
    assert status_of(address, Host=f"localhost:{server.port}") == 200
    assert status_of(f"{address}other") == 404


def test_each_truth_is_reported_once(serve):
    truths = []
    with ImageClient(serve(clock="lockstep", on_truth=truths.append).port) as client:
        shots = [header["shot"] for header, _ in client.frames(6)]

    assert [truth["shot"] for truth in truths[:3]] == list(dict.fromkeys(shots))


def test_a_port_in_use_is_a_device_error(serve):
    port = serve().port

    with pytest.raises(DeviceError, match="in use"):
        serve(port=port)


@pytest.mark.parametrize(
    ("changes", "rate_hz", "error", "finding"),
    [
        ({}, 500.0, UsageError, "--rate.*leave no time"),
        ({"motion": DRIFT, "shots": 11, "period_s": 0.1}, 1.0, UsageError, "--rate.*motion"),
        ({"sequence": (0,) * 17}, 50.0, UsageError, "sequence"),
        ({"approaches": ()}, 50.0, DataError, "trajectory"),
    ],
)
def test_a_scene_that_cannot_be_served_at_a_rate_is_rejected(serve, scene, changes, rate_hz, error, finding):
    with pytest.raises(error, match=finding):
        serve(replace(scene, **changes), rate_hz=rate_hz)
