"""The page of the console over its socket: what is refused, and that it goes on after an exception."""

from contextlib import contextmanager

import pytest
from served_scene import small_scene

pytest.importorskip("viser")

from page_client import PageClient

from ringpose.cli.simulate.console import trajectory_in
from ringpose.console.engine import Engine
from ringpose.console.page import ConsolePage
from ringpose.errors import InputOutputError
from ringpose.files.rigs import rig_in


@contextmanager
def connected_client(folder):
    """A client that has seen the first measurement of a small scene's page; recording fails as on a full disk."""

    def record(_):
        raise InputOutputError("shots", "no space left on device")

    with (
        ConsolePage(small_scene(folder), "127.0.0.1", None, 160, trajectory_in, rig_in, record) as page,
        PageClient(page.port) as connected,
    ):
        connected.look()
        connected.wait_for(lambda: "errors: " in connected.texts)
        yield connected


@pytest.fixture
def client(tmp_path):
    """A client of a page of its own."""
    with connected_client(tmp_path) as connected:
        yield connected


@pytest.fixture(scope="module")
def steady_client(tmp_path_factory):
    """A client of tests that leave the state of the page as it was."""
    with connected_client(tmp_path_factory.mktemp("page")) as connected:
        yield connected


@pytest.mark.parametrize(
    ("label", "value", "word"),
    [
        ("pixel pitch (%)", 0, "50 to 200"),
        ("exposure (ms)", -1, "0&#46;05 to 50"),
        ("time (s)", 1e308, "1e&#43;308 is out of range"),
        ("time (s)", float("nan"), "nan is out of range"),
        ("image width (px)", "0", "must be one of 160"),
        ("speed", "<b>", "must be one of"),
        ("sequence", "<b>", "&#60;b&#62;"),
    ],
)
def test_a_value_that_is_not_taken_is_named_below_its_field_until_another_is(steady_client, label, value, word):
    client = steady_client
    before = client.elements[client.of(label)]["value"]

    client.set(label, value)
    client.wait_for(lambda: word in client.texts)

    assert "stays" in client.texts
    client.set(label, before)
    client.wait_for(lambda: word not in client.texts)


def test_a_control_changes_the_state_and_the_measurement_before_is_marked_as_outdated(client):
    client.set("yaw (deg)", 3.0)

    client.wait_for(lambda: "**outdated**: controls were changed" in client.texts)
    client.wait_for(lambda: "**outdated**" not in client.texts and "state 2" in client.texts)


def test_an_exception_in_one_scene_is_shown_and_the_next_one_is_measured(client, monkeypatch, capsys):
    measured = Engine.measured

    def failing(engine, state):
        if state.number == 2:
            raise ZeroDivisionError("a <b> bug")
        return measured(engine, state)

    monkeypatch.setattr(Engine, "measured", failing)
    client.set("yaw (deg)", 3.0)
    client.wait_for(lambda: "internal error" in client.texts)
    assert "ZeroDivisionError&#58; a &#60;b&#62; bug" in client.texts
    client.wait_for(lambda: "**none** &#40;state 2" in client.texts or "**none** (state 2" in client.texts)

    client.set("yaw (deg)", 0.0)
    client.wait_for(lambda: "state 3" in client.texts and "internal error" not in client.texts)
    assert "ZeroDivisionError: a <b> bug" in capsys.readouterr().err


def test_recording_that_fails_is_switched_off_with_its_reason(client):
    client.set("record shots with their truth", value=True)
    client.set("yaw (deg)", 3.0)

    client.wait_for(lambda: "recording is switched off" in client.texts)

    assert client.elements[client.of("record shots with their truth")]["value"] is False
    assert "no space left on device" in client.texts
