"""The bridge from a track to CAN: its frames on the virtual bus, decoded by another library with the DBC file."""

import json
import runpy
import sys
import time
from io import StringIO
from pathlib import Path

import pytest
from needed import needed_module
from test_track_examples import track_record

EXAMPLES = Path(__file__).parents[1] / "examples"
NONE = {"Grasp_X": -5.24288, "Approach_X": -32768 / 32767, "Velocity_X": -3.2768}


@pytest.fixture
def can():
    return needed_module("can", "python-can")


@pytest.fixture
def bridge(can, monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return runpy.run_path(str(EXAMPLES / "track_to_can.py"))


@pytest.fixture(scope="module")
def decode():
    database = needed_module("cantools", "cantools").database.load_file(EXAMPLES / "ringpose.dbc")
    return lambda frames: {
        name: value
        for offset, data in frames.items()
        for name, value in database.decode_message(0x510 + offset, data).items()
    }


FOLLOW = {
    "do": "follow",
    "frame": "base",
    "grasp_m": [0.12345, -1.5, 5.0],
    "velocity_m_s": [0.01, -0.25, 0.0],
    "approach": [0.6, 0.0, -0.8],
    "level_m": 0.00031,
}


def test_a_pose_is_decoded_as_it_was(bridge, decode):
    signals = decode(bridge["frames_of"](FOLLOW, 0.045, 21))

    assert [signals[f"Grasp_{axis}"] for axis in "XYZ"] == pytest.approx(FOLLOW["grasp_m"], abs=5e-6)
    assert [signals[f"Velocity_{axis}"] for axis in "XYZ"] == pytest.approx(FOLLOW["velocity_m_s"], abs=5e-5)
    assert [signals[f"Approach_{axis}"] for axis in "XYZ"] == pytest.approx(FOLLOW["approach"], abs=2e-5)
    assert (str(signals["Command"]), str(signals["Reason"]), str(signals["Frame"])) == ("follow", "none", "base")
    assert (signals["Age"], signals["Grasp_Level"]) == pytest.approx((0.045, 0.00031))
    assert signals["Counter"] == 21 % 16


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ({"do": "hold", "why": "no track for 0.3 s"}, "no_track"),
        ({"do": "hold", "why": "the track is lost"}, "track_not_valid"),
        ({"do": "hold", "why": "side_unknown"}, "flagged"),
        ({"do": "hold", "why": "may be off by 9.00 mm, 0.50 degrees"}, "inaccurate"),
        ({"do": "hold", "why": "the stream has ended"}, "ended"),
        ({**FOLLOW, "grasp_m": [0.0, 0.0, 5.3]}, "out_of_range"),
        ({**FOLLOW, "velocity_m_s": [4.0, 0.0, 0.0]}, "out_of_range"),
    ],
)
def test_a_hold_has_its_reason_and_no_numbers(said, reason, bridge, decode):
    signals = decode(bridge["frames_of"](said, None, 0))

    assert (str(signals["Command"]), str(signals["Reason"]), str(signals["Frame"])) == ("hold", reason, "none")
    assert {name: signals[name] for name in NONE} == pytest.approx(NONE)
    assert (signals["Age"], signals["Grasp_Level"]) == pytest.approx((65.535, 0.65535))


def test_rounds_on_the_virtual_bus_are_complete_counted_and_end_with_a_hold(can, bridge, decode, monkeypatch):
    record = track_record(measurement_stamp_s=time.time() - 0.05, stamp_s=time.time())
    main = bridge["main"]

    class Lines:
        """A track, and the end of the stream after some rounds."""

        def __init__(self, _):
            self.record, self.heard_s, self._begin_s = record, time.monotonic(), time.monotonic()

        @property
        def ended(self):
            return time.monotonic() > self._begin_s + 0.3

    monkeypatch.setitem(main.__globals__, "Newest", Lines)
    words = ["--interface", "virtual", "--channel", "ring", "--rate", "100", "--patience", "60"]
    monkeypatch.setattr(sys, "argv", ["track_to_can.py", *words])
    monkeypatch.setattr(sys, "stdin", StringIO(json.dumps(record)))

    with can.Bus(interface="virtual", channel="ring") as listener:
        main()
        received = []
        while (message := listener.recv(0.0)) is not None:
            received.append(message)

    rounds = [received[first : first + 4] for first in range(0, len(received), 4)]
    decoded = [decode({each.arbitration_id - 0x510: each.data for each in one}) for one in rounds]
    assert {tuple(each.arbitration_id for each in one) for one in rounds} == {(0x511, 0x512, 0x513, 0x510)}
    assert len(rounds) > 2
    assert [each["Counter"] for each in decoded] == [number % 16 for number in range(len(rounds))]
    assert {str(each["Command"]) for each in decoded[:-1]} == {"follow"}
    assert all(0.04 < each["Age"] < 60 for each in decoded[:-1])
    assert (str(decoded[-1]["Command"]), str(decoded[-1]["Reason"])) == ("hold", "ended")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--rate", "0"], "--rate"),
        (["--id", "0x7fe"], "--id"),
        (["--interface", "nosuch"], "nosuch"),
    ],
)
def test_what_cannot_be_sent_ends_with_one_line(bridge, monkeypatch, capsys, words, told):
    monkeypatch.setattr(sys, "argv", ["track_to_can.py", *words])

    with pytest.raises(SystemExit) as ended:
        bridge["main"]()
    assert told in f"{ended.value} {capsys.readouterr().err}"
