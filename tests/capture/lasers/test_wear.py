"""How often relays have switched, whatever becomes of the guard that counts."""

import json
from pathlib import Path

import pytest
from guarded_lasers import lasers_at

from ringpose.capture.lasers.wear import NOTED_EVERY, Wear, wear_file


@pytest.fixture(autouse=True)
def _own_state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def counted():
    return json.loads(wear_file("/dev/x").read_text())["operations"]


def test_a_long_run_is_noted_on_its_way():
    wear = Wear("/dev/x", (2, 0))

    for done in range(1, 3 * NOTED_EVERY):
        wear.note([done, 0])

    assert NOTED_EVERY < counted()["2"] < 3 * NOTED_EVERY


def test_nothing_is_counted_twice():
    wear = Wear("/dev/x", (2, 0))
    wear.note([NOTED_EVERY, 1])
    wear.note([NOTED_EVERY + 3, 2], at_least=1)

    assert counted() == {"2": NOTED_EVERY + 3, "0": 2}
    assert Wear("/dev/x", (0, 1, 2)).earlier == [2, 0, NOTED_EVERY + 3]


def test_a_user_without_a_home_switches_lasers_all_the_same(monkeypatch):
    def homeless(_=None):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(Path, "home", homeless)
    wear = Wear("/dev/x", (0,))
    wear.note([1], at_least=1)

    assert wear.earlier == [0]


def test_operations_are_counted_though_the_cable_is_pulled(board, time_until):
    with board("lcus") as (relays, uri):
        lasers = lasers_at(uri)
        lasers.open()
        lasers.set_mask(0b011)
        relays.unplug()
        file = wear_file(relays.port)
        noted_s = time_until(file.exists, 5.0)
        lasers.close()

    assert noted_s < 5.0
    assert json.loads(file.read_text())["operations"] == {"0": 1, "1": 1, "2": 0}


def test_operations_are_counted_from_run_to_run(board):
    with board("lcus") as (relays, uri):
        for _ in range(2):
            lasers = lasers_at(uri)
            with lasers:
                for mask in (0b001, 0, 0b011):
                    lasers.set_mask(mask)
        counted = json.loads(wear_file(relays.port).read_text())["operations"]

    assert counted == {"0": 4, "1": 2, "2": 0}


@pytest.mark.parametrize(("rated", "warns"), [(5, True), (10, False), (0, False)])
def test_a_relay_near_the_end_of_its_life_is_named(board, rated, warns):
    with board("lcus") as (relays, uri):
        file = wear_file(relays.port)
        file.parent.mkdir(parents=True)
        file.write_text(json.dumps({"port": relays.port, "operations": {"1": 4}}))
        lasers = lasers_at(f"{uri}&rated={rated}")
        with lasers:
            warnings = lasers.warnings()

    assert (len(warnings) == 1) is warns
    assert all("relay 2 has switched 4 times; its kind lasts for about 5" in line for line in warnings)


@pytest.mark.parametrize("state", ["", "{", "[]", '{"operations": 3}', '{"operations": {"0": "x"}}'])
def test_a_damaged_count_begins_anew(board, state):
    with board("lcus") as (relays, uri):
        file = wear_file(relays.port)
        file.parent.mkdir(parents=True)
        file.write_text(state)
        lasers = lasers_at(uri)
        with lasers:
            lasers.set_mask(1)

        assert json.loads(file.read_text())["operations"]["0"] == 1
