"""The pages of `simulate console` and `view` answer to browsers on this machine that show them, and to nothing else."""

import http.client
import json
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from recorded_shots import make_shot
from served_scene import small_scene

from ringpose.cli.main import main

pytest.importorskip("viser")

import viser
from page_client import PageClient
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from ringpose.console.display import line_text, plain
from ringpose.console.server import opened_server, refusal
from ringpose.errors import DeviceError, UsageError
from ringpose.files.images.shots import write_shot
from ringpose.types.pose import PoseLine


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with scene.yaml, rig.yaml and a.npz."""
    folder = tmp_path_factory.mktemp("pages")
    camera = small_scene(folder).rig.camera
    black = np.zeros((2, camera.image_height, camera.image_width), dtype=np.uint8)
    write_shot(folder / "a.npz", make_shot(black, (0, 7)))
    return folder


COMMANDS = {
    "console": ["simulate", "console", "scene.yaml"],
    "view": ["view", "a.npz", "--rig", "rig.yaml", "--quiet"],
}


@pytest.fixture(scope="module", params=COMMANDS)
def port(request, files):
    """Port of the page of a command, which writes nothing but its address to stdout."""
    words = [Path(sys.executable).parent / "ringpose", *COMMANDS[request.param]]
    with subprocess.Popen(words, cwd=files, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        address = json.loads(process.stdout.readline())["page"]
        yield int(address.rpartition(":")[2])
        process.terminate()
        output, errors = process.communicate(timeout=300)
        assert (process.returncode, output) == (143, "")
        assert "Traceback" not in errors


def status_of_page(port, host, origin):
    """The HTTP status of the page for a request that names this host and origin."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.putrequest("GET", "/", skip_host=True)
    for name, value in (("Host", host), ("Origin", origin)):
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    response.read()
    connection.close()
    if response.status == 200:
        assert response.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    return response.status


def status_of_socket(port, host, origin):
    """The HTTP status of the handshake, 101 for an open socket that has sent the state of the page."""
    try:
        with PageClient(port, host, origin) as client:
            client.wait_for(lambda: client.elements)
    except InvalidStatus as refused:
        return refused.response.status_code
    return 101


@pytest.mark.parametrize(
    ("host", "origin", "is_answered"),
    [
        ("127.0.0.1:{port}", None, True),
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}", True),
        ("localhost:{port}", "http://localhost:{port}", True),
        ("localhost:9000", "http://localhost:9000", True),  # a forwarded port
        ("127.0.0.1:{port}", "http://evil.example", False),
        ("127.0.0.1:{port}", "http://127.0.0.1:3000", False),
        ("127.0.0.1:{port}", "http://localhost:{port}", False),
        ("127.0.0.1:{port}", "null", False),
        ("evil.example:{port}", "http://evil.example:{port}", False),  # DNS rebinding
        ("evil.example:{port}", None, False),
    ],
)
def test_page_and_socket_answer_to_their_own_host_and_origin_only(port, host, origin, is_answered):
    host, origin = (each and each.format(port=port) for each in (host, origin))

    assert status_of_page(port, host, origin) == (200 if is_answered else 403)
    assert status_of_socket(port, host, origin) == (101 if is_answered else 403)


@pytest.mark.parametrize(
    ("hosts", "origins", "is_answered"),
    [
        (["[::1]:8080"], ["http://[::1]:8080"], True),
        (["LOCALHOST"], ["https://localhost"], True),
        (["10.0.0.7:80"], ["http://10.0.0.7:80"], True),
        ([], [], False),
        ([""], [], False),
        (["localhost", "localhost"], [], False),
        (["localhost@evil.example"], [], False),
        (["localhost.evil.example"], [], False),
        (["localhost"], ["http://localhost@evil.example"], False),
        (["localhost"], ["http://localhost", "http://evil.example"], False),
        (["localhost"], ["file://localhost"], False),
        (["localhost"], [""], False),
    ],
)
def test_hosts_and_origins_that_only_look_like_ours_are_refused(hosts, origins, is_answered):
    assert (refusal(hosts, origins, "10.0.0.7") == "") == is_answered


@pytest.fixture
def server():
    opened = opened_server("127.0.0.1", None)
    yield opened
    opened.stop()


def test_without_a_port_a_free_one_is_taken(server):
    other = opened_server("127.0.0.1", None)
    try:
        assert other.get_port() != server.get_port()
    finally:
        other.stop()


@pytest.mark.parametrize("command", COMMANDS)
def test_a_port_that_was_asked_for_and_is_in_use_is_status_69(files, command, monkeypatch, capsys):
    monkeypatch.chdir(files)
    with socket.create_server(("127.0.0.1", 0)) as used:
        port = used.getsockname()[1]

        assert main([*COMMANDS[command], "--port", str(port)]) == DeviceError.status

    output = capsys.readouterr()
    assert output.out == ""
    finding = "address already in use; end what uses it, or choose another --port"
    assert output.err == f"ringpose {COMMANDS[command][0]}: http://127.0.0.1:{port}: {finding}\n"


def test_what_viser_reports_goes_to_stderr(server, capsys):
    with pytest.raises(Exception, match="1002"):  # viser reports the other version  # noqa: SIM117
        with connect(f"ws://127.0.0.1:{server.get_port()}/", subprotocols=["viser-v0.0.0"]) as client:
            client.recv(60)

    output = capsys.readouterr()
    assert output.out == ""
    assert "Version mismatch" in output.err


def test_a_viser_that_opens_its_server_in_another_way_is_not_used(monkeypatch):
    class Other:
        def __init__(self, **_):
            self.is_stopped = False

        def stop(self):
            self.is_stopped = True

    made = []
    monkeypatch.setattr(viser, "ViserServer", lambda **options: made.append(Other(**options)) or made[-1])

    with pytest.raises(UsageError, match="cannot be protected"):
        opened_server("127.0.0.1", None)

    assert made[0].is_stopped


def test_messages_set_the_values_of_controls_and_nothing_else(server, capsys):
    """Messages that would put a text into a slider, replace its callbacks, or share the page with the world."""
    slider = server.gui.add_slider("slider", 0.0, 10.0, 0.1, 5.0)
    uuid = slider._impl.uuid
    updates = [{"value": "<b>"}, {"value": None}, {"update_cb": []}, {"value": 1.0, "removed": True}, {}, 7]

    with PageClient(server.get_port()) as client, PageClient(server.get_port()) as other:
        for each in updates:
            client.send("GuiUpdateMessage", uuid=uuid, updates=each)
        client.send("ShareUrlRequest")
        client.set("slider", 2)
        other.wait_for(lambda: uuid in other.elements and other.elements[uuid]["value"] == 2.0)

    assert (slider.value, slider._impl.removed) == (2.0, False)
    output = capsys.readouterr()
    assert output.err.count("a message to the page was refused") == len(updates)
    assert "Share" not in output.err


def test_text_of_files_is_neither_markup_nor_an_image_of_this_machine():
    text = "<img src=x onerror=alert(1)> ![a](/etc/hostname) *b* _c_ `d` {e}\n# f\ud800"

    shown = plain(text)

    assert not set(shown) & set("<>![]()*_`{}\n\ud800")
    assert shown.replace("&#60;", "<").startswith("<img src")


def test_a_reason_is_shown_as_it_is():
    line = PoseLine(shot="a", stamp_s=0.0, pose=None, reason="<script>alert(1)</script>")

    text = line_text(line, "shot <b>1</b>", {})

    assert "<" not in text
    assert "&#60;script&#62;alert&#40;1&#41;" in text


def test_an_outdated_measurement_is_not_ok_any_more():
    line = PoseLine(shot="a", stamp_s=0.0, pose=None, reason="dark")

    now, then = line_text(line, "state 1", {}), line_text(line, "state 1", {}, "the target has moved")

    assert now.startswith("**none** (state 1)")
    assert then.startswith("**outdated**: the target has moved  \nwas none (state 1)")
    assert "**none**" not in then
