"""GVCP messages against bytes derived by hand from the published layout."""

import pytest

from ringpose.wire.gvcp import Answer, Command, Request, Status, answer_bytes, request_in, resend_range

MESSAGES = [
    ("4201000200000001", Request(command=Command.DISCOVERY, number=1)),
    ("420100800004000200000a00", Request(command=Command.READ_REGISTER, number=2, payload=bytes.fromhex("00000a00"))),
    (
        "420100820008000300000a0000000002",
        Request(command=Command.WRITE_REGISTER, number=3, payload=bytes.fromhex("00000a0000000002")),
    ),
    (
        "42000040000c0005000000070000000a0000000c",
        Request(
            command=Command.RESEND,
            number=5,
            payload=bytes.fromhex("000000070000000a0000000c"),
            needs_answer=False,
        ),
    ),
]


@pytest.mark.parametrize(("text", "request_"), MESSAGES)
def test_a_request_is_read_from_the_bytes_of_the_standard(text, request_):
    assert request_in(bytes.fromhex(text)) == request_


def test_a_payload_is_read_as_32_bit_words():
    assert request_in(bytes.fromhex("420100820009000300000a0000000002ff")).words == (0xA00, 2)


def test_a_denied_write_has_the_bytes_of_the_standard():
    answer = Answer(status=Status.ACCESS_DENIED, command=Command.WRITE_REGISTER, number=3, payload=bytes(4))

    assert answer_bytes(answer).hex() == "800600830004000300000000"


def test_the_last_of_all_commands_has_an_answer():
    assert answer_bytes(Answer(status=Status.NOT_IMPLEMENTED, command=0xFFFF, number=1)).hex() == "8001000000000001"


@pytest.mark.parametrize(
    "text", ["", "42", "4101000200000001", "42010080000400020000"], ids=["none", "a", "key", "cut"]
)
def test_an_invalid_datagram_is_not_a_request(text):
    assert request_in(bytes.fromhex(text)) is None


def test_a_resend_names_its_packets():
    assert resend_range(bytes.fromhex("000000070000000a0000000c")) == (7, 10, 12)
    assert resend_range(bytes(8)) is None
