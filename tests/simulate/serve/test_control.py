"""Who may write to the camera, and for how long."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.simulate.serve import genicam as features
from ringpose.simulate.serve.control import Control
from ringpose.simulate.serve.genicam import Identity, Registers
from ringpose.wire import gige_registers as bootstrap
from ringpose.wire.gvcp import Answer, Command, Request, Status

OWNER, OTHER = ("127.0.0.1", 5000), ("127.0.0.1", 5001)


class Recorded:
    """Notes what the camera is told to do."""

    def __init__(self) -> None:
        self.done: list[object] = []

    def start(self) -> None:
        self.done.append("start")

    def stop(self) -> None:
        self.done.append("stop")

    def trigger(self) -> None:
        self.done.append("trigger")

    def resend(self, block: int, first: int, last: int) -> None:
        self.done.append((block, first, last))

    def fire_test_packet(self, client: tuple[str, int], size: int) -> None:
        self.done.append(size)

    def outputs_changed(self) -> None:
        self.done.append("outputs")

    def stamp_ticks(self) -> int:
        return 0x1_0000_0002


@pytest.fixture
def actions():
    return Recorded()


@pytest.fixture
def control(actions):
    identity = Identity(address="127.0.0.1", width=4, height=3, bits=8, exposure_s=0.01)
    return Control(Registers(identity), actions)


def words(*values: int) -> bytes:
    """Numbers of 32 bits, as a payload has them."""
    return struct.pack(f">{len(values)}I", *values)


def written(control: Control, address: int, value: int, client=OWNER, now_s: float = 0.0) -> int:
    payload = words(address, value)
    answer = control.answer(Request(command=Command.WRITE_REGISTER, number=1, payload=payload), client, now_s)
    assert answer is not None
    return answer.status


def asked(control: Control, command: int, payload: bytes = b"", client=OWNER) -> Answer:
    answer = control.answer(Request(command=command, number=7, payload=payload), client, 0.0)
    assert answer is not None
    assert answer.number == 7
    return answer


def test_nobody_writes_without_control(control, actions):
    assert written(control, features.TRIGGER_SOFTWARE, 1) == Status.ACCESS_DENIED
    assert actions.done == []


def test_the_one_who_has_control_sets_things_off(control, actions):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    assert written(control, features.ACQUISITION_START, 1) == Status.SUCCESS
    assert written(control, features.TRIGGER_SOFTWARE, 1) == Status.SUCCESS
    assert actions.done == ["start", "trigger"]


def test_control_is_not_taken_from_its_owner(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    assert written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL, OTHER) == Status.ACCESS_DENIED
    assert control.client == OWNER


def test_others_may_read_unless_the_owner_is_exclusive(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.EXCLUSIVE)

    assert asked(control, Command.READ_REGISTER, bytes.fromhex("0000a000"), OTHER).status == Status.ACCESS_DENIED
    assert asked(control, Command.READ_REGISTER, bytes.fromhex("0000a000")).payload == b"\0\0\0\4"


def test_a_silent_owner_is_given_up_and_its_outputs_go_low(control, actions):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)
    written(control, features.USER_OUTPUT_VALUE_ALL, 0b101)

    control.expire(3.1)

    assert control.client is None
    assert control.registers[features.USER_OUTPUT_VALUE_ALL] == 0
    assert actions.done == ["outputs", "stop", "outputs"]


def test_an_owner_that_is_heard_keeps_control(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)
    control.answer(Request(command=Command.DISCOVERY, number=1), OWNER, 2.0)

    control.expire(4.9)

    assert control.client == OWNER


def test_outputs_one_by_one_make_the_mask_of_all(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    written(control, features.USER_OUTPUT_VALUE + 8, 1)

    assert control.registers[features.USER_OUTPUT_VALUE_ALL] == 0b100


def test_the_description_is_where_the_camera_says(control):
    url = asked(control, Command.READ_MEMORY, words(bootstrap.XML_URL, 512)).payload[4:]
    name, address, size = url.rstrip(b"\0").decode().split(";")

    start = asked(control, Command.READ_MEMORY, words(int(address, 16), 38)).payload[4:]

    assert name == "Local:ringpose.xml"
    assert start == b'<?xml version="1.0" encoding="utf-8"?>'
    assert int(size, 16) == len(features.description())


@pytest.mark.parametrize(
    ("address", "status"),
    [
        (features.WIDTH, Status.WRITE_PROTECT),
        (0xA001, Status.BAD_ALIGNMENT),
        (features.XML_ADDRESS, Status.INVALID_ADDRESS),
        (bootstrap.MANUFACTURER_NAME, Status.WRITE_PROTECT),
        (bootstrap.XML_URL, Status.WRITE_PROTECT),
    ],
)
def test_what_cannot_be_written_is_refused(control, address, status):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    assert written(control, address, 1) == status


def test_a_row_of_registers_is_written_as_each_of_them_would_be(control, actions):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)
    unknown_format = bytes(4) + bytes.fromhex("01100007")

    refused = asked(control, Command.WRITE_MEMORY, (features.HEIGHT).to_bytes(4, "big") + unknown_format)
    uneven = asked(control, Command.WRITE_MEMORY, features.PIXEL_FORMAT.to_bytes(4, "big") + b"\0\0")
    row = features.USER_OUTPUT_VALUE.to_bytes(4, "big") + 2 * bytes.fromhex("00000001")
    accepted = asked(control, Command.WRITE_MEMORY, row)

    assert [refused.status, uneven.status] == [Status.WRITE_PROTECT, Status.BAD_ALIGNMENT]
    assert accepted.status == Status.SUCCESS
    assert control.registers[features.USER_OUTPUT_VALUE_ALL] == 0b11


def test_a_pixel_format_that_the_camera_lacks_is_not_kept(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    written(control, features.PIXEL_FORMAT, 0x010C0006)

    assert control.registers[features.PIXEL_FORMAT] == 0x01080001


@pytest.mark.parametrize(
    ("address", "value", "kept"),
    [
        (features.GAIN, 99.0, 24.0),
        (features.EXPOSURE_TIME, 1.0, 10.0),
        (features.EXPOSURE_TIME, math.nan, 10.0),
        (features.FRAME_RATE, math.inf, 200.0),
        (features.FRAME_RATE, 50.0, 50.0),
    ],
)
def test_a_number_out_of_its_bounds_is_not_kept(control, address, value, kept):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    asked(control, Command.WRITE_MEMORY, struct.pack(">Id", address, value))

    read = asked(control, Command.READ_MEMORY, words(address, 8)).payload[4:]
    assert struct.unpack(">d", read) == (kept,)


def test_no_heartbeat_is_too_short_to_be_kept(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)
    written(control, bootstrap.HEARTBEAT_TIMEOUT, 0)

    control.expire(0.4)
    kept = control.client
    control.expire(0.6)

    assert (kept, control.client) == (OWNER, None)


def test_an_address_that_is_not_there_is_refused(control):
    assert asked(control, Command.READ_MEMORY, words(0xFFFFFF00, 8)).status == Status.INVALID_ADDRESS
    assert asked(control, Command.READ_REGISTER, b"\xff\xff\xff\xfc").status == Status.INVALID_ADDRESS


@given(
    st.lists(st.tuples(st.sampled_from([0x02, 0x40, 0x80, 0x82, 0x84, 0x86]), st.binary(max_size=24)), max_size=8),
    st.integers(0, 0xFFFF),
)
def test_no_request_whatsoever_stops_the_camera(commands, address):
    identity = Identity(address="127.0.0.1", width=4, height=3, bits=8, exposure_s=0.01)
    control = Control(Registers(identity), Recorded())
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    for command, payload in commands:
        for start in (b"", (address & ~3).to_bytes(4, "big")):
            control.answer(Request(command=command, number=1, payload=start + payload), OWNER, 0.0)

    low, high = features.EXPOSURE_BOUNDS_US
    assert low <= control.registers.number(features.EXPOSURE_TIME, features.EXPOSURE_BOUNDS_US) <= high
    assert asked(control, Command.DISCOVERY).status == Status.SUCCESS


def test_an_unknown_command_is_answered_so(control):
    assert asked(control, 0x00A0).status == Status.NOT_IMPLEMENTED


def test_twelve_bits_need_two_bytes_a_pixel(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    written(control, features.PIXEL_FORMAT, 0x01100005)

    assert control.registers[features.PAYLOAD_SIZE] == 2 * 4 * 3


def test_the_clock_is_latched(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    written(control, bootstrap.TIMESTAMP_CONTROL, 2)

    assert control.registers[bootstrap.TIMESTAMP_HIGH] == 1
    assert control.registers[bootstrap.TIMESTAMP_LOW] == 2
