"""How often relays have switched, whatever becomes of the guard that counts."""

import json
from pathlib import Path

import pytest

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
