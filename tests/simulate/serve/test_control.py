"""Control channel of the virtual camera: access rights, heartbeat and effects of writes."""

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
    """Records the actions that are triggered."""

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


@pytest.fixture
def controlled(control):
    """The control channel with `OWNER` in control."""
    assert written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL) == Status.SUCCESS
    return control


def words(*values: int) -> bytes:
    """A payload of 32-bit numbers."""
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


def test_a_write_without_control_is_denied(control, actions):
    assert written(control, features.TRIGGER_SOFTWARE, 1) == Status.ACCESS_DENIED
    assert actions.done == []


def test_writes_of_the_controlling_client_trigger_actions(controlled, actions):
    assert written(controlled, features.ACQUISITION_START, 1) == Status.SUCCESS
    assert written(controlled, features.TRIGGER_SOFTWARE, 1) == Status.SUCCESS
    assert actions.done == ["start", "trigger"]


def test_a_second_client_does_not_get_control(controlled):
    assert written(controlled, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL, OTHER) == Status.ACCESS_DENIED
    assert controlled.client == OWNER


def test_other_clients_may_read_unless_access_is_exclusive(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.EXCLUSIVE)

    assert asked(control, Command.READ_REGISTER, bytes.fromhex("0000a000"), OTHER).status == Status.ACCESS_DENIED
    assert asked(control, Command.READ_REGISTER, bytes.fromhex("0000a000")).payload == b"\0\0\0\4"


def test_a_heartbeat_timeout_ends_control_and_sets_the_outputs_low(controlled, actions):
    written(controlled, features.USER_OUTPUT_VALUE_ALL, 0b101)

    controlled.expire(3.1)

    assert controlled.client is None
    assert controlled.registers[features.USER_OUTPUT_VALUE_ALL] == 0
    assert actions.done == ["outputs", "stop", "outputs"]


def test_any_request_counts_as_a_heartbeat(controlled):
    controlled.answer(Request(command=Command.DISCOVERY, number=1), OWNER, 2.0)

    controlled.expire(4.9)

    assert controlled.client == OWNER


def test_single_user_outputs_update_their_mask(controlled):
    written(controlled, features.USER_OUTPUT_VALUE + 8, 1)

    assert controlled.registers[features.USER_OUTPUT_VALUE_ALL] == 0b100


def test_the_xml_is_at_the_reported_address(control):
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
def test_a_write_to_a_read_only_or_invalid_address_is_rejected(controlled, address, status):
    assert written(controlled, address, 1) == status


def test_a_memory_write_has_the_effects_of_its_register_writes(controlled, actions):
    unknown_format = bytes(4) + bytes.fromhex("01100007")

    refused = asked(controlled, Command.WRITE_MEMORY, (features.HEIGHT).to_bytes(4, "big") + unknown_format)
    uneven = asked(controlled, Command.WRITE_MEMORY, features.PIXEL_FORMAT.to_bytes(4, "big") + b"\0\0")
    row = features.USER_OUTPUT_VALUE.to_bytes(4, "big") + 2 * bytes.fromhex("00000001")
    accepted = asked(controlled, Command.WRITE_MEMORY, row)

    assert [refused.status, uneven.status] == [Status.WRITE_PROTECT, Status.BAD_ALIGNMENT]
    assert accepted.status == Status.SUCCESS
    assert controlled.registers[features.USER_OUTPUT_VALUE_ALL] == 0b11


def test_an_unknown_pixel_format_is_replaced(controlled):
    written(controlled, features.PIXEL_FORMAT, 0x010C0006)

    assert controlled.registers[features.PIXEL_FORMAT] == 0x01080001


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
def test_a_number_is_limited_to_its_bounds(controlled, address, value, kept):
    asked(controlled, Command.WRITE_MEMORY, struct.pack(">Id", address, value))

    read = asked(controlled, Command.READ_MEMORY, words(address, 8)).payload[4:]
    assert struct.unpack(">d", read) == (kept,)


def test_the_heartbeat_timeout_has_a_minimum(controlled):
    written(controlled, bootstrap.HEARTBEAT_TIMEOUT, 0)

    controlled.expire(0.4)
    kept = controlled.client
    controlled.expire(0.6)

    assert (kept, controlled.client) == (OWNER, None)


def test_reading_an_invalid_address_is_rejected(control):
    assert asked(control, Command.READ_MEMORY, words(0xFFFFFF00, 8)).status == Status.INVALID_ADDRESS
    assert asked(control, Command.READ_REGISTER, bytes.fromhex("fffffffc")).status == Status.INVALID_ADDRESS


@given(
    st.lists(st.tuples(st.sampled_from([0x02, 0x40, 0x80, 0x82, 0x84, 0x86]), st.binary(max_size=24)), max_size=8),
    st.integers(0, 0xFFFF),
)
def test_arbitrary_requests_do_not_stop_the_camera(commands, address):
    identity = Identity(address="127.0.0.1", width=4, height=3, bits=8, exposure_s=0.01)
    control = Control(Registers(identity), Recorded())
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    for command, payload in commands:
        for start in (b"", (address & ~3).to_bytes(4, "big")):
            control.answer(Request(command=command, number=1, payload=start + payload), OWNER, 0.0)

    low, high = features.EXPOSURE_BOUNDS_US
    assert low <= control.registers.number(features.EXPOSURE_TIME, features.EXPOSURE_BOUNDS_US) <= high
    assert asked(control, Command.DISCOVERY).status == Status.SUCCESS


def test_an_unknown_command_is_answered_as_not_implemented(control):
    assert asked(control, 0x00A0).status == Status.NOT_IMPLEMENTED


def test_the_payload_size_follows_the_pixel_format(controlled):
    written(controlled, features.PIXEL_FORMAT, 0x01100005)

    assert controlled.registers[features.PAYLOAD_SIZE] == 2 * 4 * 3


def test_the_time_stamp_is_latched(controlled):
    written(controlled, bootstrap.TIMESTAMP_CONTROL, 2)

    assert controlled.registers[bootstrap.TIMESTAMP_HIGH] == 1
    assert controlled.registers[bootstrap.TIMESTAMP_LOW] == 2
