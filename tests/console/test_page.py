"""The page of the console over its socket: what is refused, and that it goes on after an exception."""

import re
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


def no_space(_):
    raise InputOutputError("shots", "no space left on device")


@contextmanager
def connected_client(folder, record=no_space):
    """A client that has seen the first measurement of a small scene's page; recording fails as on a full disk."""
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


def test_what_is_shown_is_recorded_as_soon_as_recording_is_switched_on(tmp_path):
    recorded = []
    with connected_client(tmp_path, lambda picture: recorded.append(picture.shot.name)) as client:
        assert recorded == []
        client.set("record shots with their truth", value=True)

        client.wait_for(lambda: "recorded console&#95;" in client.texts)

    assert len(recorded) == 1


def test_truth_estimate_and_sigma_are_a_table(steady_client):
    client = steady_client
    client.wait_for(lambda: "<td>centre x (mm)</td>" in client.html)

    rows = dict(re.findall(r"<tr><td>([^<]+)</td>(.*?)</tr>", client.html))
    assert list(rows) == [
        *(f"centre {axis} (mm)" for axis in "xyz"), "pitch (deg)", "yaw (deg)", "inner radius (mm)", "outer radius (mm)"
    ]  # fmt: skip


def test_the_legend_names_rings_and_lasers(steady_client):
    client = steady_client
    client.wait_for(lambda: "&#9632;" in client.html)

    assert all(f"</b> {word}" in client.html for word in ("estimate", "track", "grasp point", "laser left"))


def test_each_control_has_a_tooltip_with_its_unit(steady_client):
    hints = {each["label"]: each["hint"] for each in steady_client.elements.values() if each.get("hint")}

    assert "in metres. Range: -1.5 to 1.5." in hints["centre x (m)"]
    assert "degrees a second" in hints["tumble (deg/s)"]
    assert "watts a square metre" in hints["sun (W/m2)"]
    assert {"view of the scene", "motion", "speed", "sequence", "laser left", "play", "reset view"} <= hints.keys()
