"""Control channel of the virtual camera: access rights, heartbeat and effects of writes."""

import math
import struct
from unittest.mock import MagicMock, call

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.simulate.serve import genicam as features
from ringpose.simulate.serve.control import Actions, Control
from ringpose.simulate.serve.genicam import Identity, Registers
from ringpose.wire import gige_registers as bootstrap
from ringpose.wire.gvcp import Answer, Command, Request, Status

OWNER, OTHER = ("127.0.0.1", 5000), ("127.0.0.1", 5001)


def made_control(actions) -> Control:
    return Control(Registers(Identity(address="127.0.0.1", width=4, height=3, bits=8, exposure_s=0.01)), actions)


@pytest.fixture
def actions():
    """Records the actions that are triggered."""
    recorded = MagicMock(spec=Actions)
    recorded.stamp_ticks.return_value = 0x1_0000_0002
    return recorded


@pytest.fixture
def control(actions):
    return made_control(actions)


@pytest.fixture
def controlled(control):
    """The control channel with `OWNER` in control."""
    assert written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL) == Status.SUCCESS
    return control


def words(*values: int) -> bytes:
    """A payload of 32-bit numbers."""
    return struct.pack(f">{len(values)}I", *values)


def written(control: Control, address: int, value: int, client=OWNER) -> int:
    return asked(control, Command.WRITE_REGISTER, words(address, value), client).status


def asked(control: Control, command: int, payload: bytes = b"", client=OWNER) -> Answer:
    answer = control.answer(Request(command=command, number=7, payload=payload), client, 0.0)
    assert answer is not None
    assert answer.number == 7
    return answer


def test_only_the_controlling_client_may_write(control, actions):
    assert written(control, features.TRIGGER_SOFTWARE, 1) == Status.ACCESS_DENIED
    assert written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL) == Status.SUCCESS
    assert written(control, features.ACQUISITION_START, 1) == Status.SUCCESS
    assert written(control, features.TRIGGER_SOFTWARE, 1) == Status.SUCCESS
    assert written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL, OTHER) == Status.ACCESS_DENIED
    assert actions.mock_calls == [call.start(), call.trigger()]
    assert control.client == OWNER


def test_other_clients_may_read_unless_access_is_exclusive(control):
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.EXCLUSIVE)

    assert asked(control, Command.READ_REGISTER, words(features.WIDTH), OTHER).status == Status.ACCESS_DENIED
    assert asked(control, Command.READ_REGISTER, words(features.WIDTH)).payload == words(4)


def test_a_heartbeat_timeout_ends_control_and_sets_the_outputs_low(controlled, actions):
    written(controlled, features.USER_OUTPUT_VALUE_ALL, 0b101)

    controlled.expire(3.1)

    assert controlled.client is None
    assert controlled.registers[features.USER_OUTPUT_VALUE_ALL] == 0
    assert actions.mock_calls == [call.outputs_changed(), call.stop(), call.outputs_changed()]


def test_any_request_counts_as_a_heartbeat_whose_timeout_has_a_minimum(controlled):
    controlled.answer(Request(command=Command.DISCOVERY, number=1), OWNER, 2.0)
    controlled.expire(4.9)
    assert controlled.client == OWNER

    controlled.answer(
        Request(command=Command.WRITE_REGISTER, number=1, payload=words(bootstrap.HEARTBEAT_TIMEOUT, 0)), OWNER, 4.9
    )
    for later_s, client in ((0.4, OWNER), (0.6, None)):
        controlled.expire(4.9 + later_s)
        assert controlled.client == client


def test_the_xml_is_at_the_reported_address(control):
    url = asked(control, Command.READ_MEMORY, words(bootstrap.XML_URL, 512)).payload[4:]
    name, address, size = url.rstrip(b"\0").decode().split(";")

    start = asked(control, Command.READ_MEMORY, words(int(address, 16), 38)).payload[4:]

    assert name == "Local:ringpose.xml"
    assert start == b'<?xml version="1.0" encoding="utf-8"?>'
    assert int(size, 16) == len(features.description())


@pytest.mark.parametrize(
    ("command", "payload", "status"),
    [
        (Command.WRITE_REGISTER, words(features.WIDTH, 1), Status.WRITE_PROTECT),
        (Command.WRITE_REGISTER, words(0xA001, 1), Status.BAD_ALIGNMENT),
        (Command.WRITE_REGISTER, words(features.XML_ADDRESS, 1), Status.INVALID_ADDRESS),
        (Command.WRITE_REGISTER, words(bootstrap.MANUFACTURER_NAME, 1), Status.WRITE_PROTECT),
        (Command.WRITE_REGISTER, words(bootstrap.XML_URL, 1), Status.WRITE_PROTECT),
        (Command.WRITE_MEMORY, words(features.HEIGHT, 0, 0x01100007), Status.WRITE_PROTECT),
        (Command.WRITE_MEMORY, words(features.PIXEL_FORMAT) + b"\0\0", Status.BAD_ALIGNMENT),
        (Command.READ_MEMORY, words(0xFFFFFF00, 8), Status.INVALID_ADDRESS),
        (Command.READ_REGISTER, words(0xFFFFFFFC), Status.INVALID_ADDRESS),
        (0x00A0, b"", Status.NOT_IMPLEMENTED),
    ],
)
def test_a_request_that_is_not_allowed_is_answered_with_the_reason(controlled, command, payload, status):
    assert asked(controlled, command, payload).status == status


@pytest.mark.parametrize(
    ("address", "values", "mask"),
    [(features.USER_OUTPUT_VALUE + 8, (1,), 0b100), (features.USER_OUTPUT_VALUE, (1, 1), 0b11)],
)
def test_single_user_outputs_update_their_mask(controlled, address, values, mask):
    accepted = asked(controlled, Command.WRITE_MEMORY, words(address, *values))

    assert accepted.status == Status.SUCCESS
    assert controlled.registers[features.USER_OUTPUT_VALUE_ALL] == mask


@pytest.mark.parametrize(
    ("written_format", "kept", "payload_bytes"),
    [(0x01100005, 0x01100005, 2 * 4 * 3), (0x010C0006, 0x01080001, 4 * 3)],
    ids=["Mono12", "unknown"],
)
def test_an_unknown_pixel_format_is_replaced_and_the_payload_size_follows(
    controlled, written_format, kept, payload_bytes
):
    written(controlled, features.PIXEL_FORMAT, written_format)

    assert controlled.registers[features.PIXEL_FORMAT] == kept
    assert controlled.registers[features.PAYLOAD_SIZE] == payload_bytes


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


@given(
    st.lists(st.tuples(st.sampled_from([0x02, 0x40, 0x80, 0x82, 0x84, 0x86]), st.binary(max_size=24)), max_size=8),
    st.integers(0, 0xFFFF),
)
def test_arbitrary_requests_do_not_stop_the_camera(commands, address):
    actions = MagicMock(spec=Actions, stamp_ticks=lambda: 0)
    control = made_control(actions)
    written(control, bootstrap.CONTROL_PRIVILEGE, bootstrap.CONTROL)

    for command, payload in commands:
        for start in (b"", (address & ~3).to_bytes(4, "big")):
            control.answer(Request(command=command, number=1, payload=start + payload), OWNER, 0.0)

    low, high = features.EXPOSURE_BOUNDS_US
    assert low <= control.registers.number(features.EXPOSURE_TIME, features.EXPOSURE_BOUNDS_US) <= high
    assert asked(control, Command.DISCOVERY).status == Status.SUCCESS


def test_the_time_stamp_is_latched(controlled):
    written(controlled, bootstrap.TIMESTAMP_CONTROL, 2)

    assert controlled.registers[bootstrap.TIMESTAMP_HIGH] == 1
    assert controlled.registers[bootstrap.TIMESTAMP_LOW] == 2
