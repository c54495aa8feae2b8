"""GVCP, the control protocol of GigE Vision cameras, on the camera's side: decodes requests and encodes answers.

A message is a header of four 16-bit numbers, big-endian, and a payload. A request begins with 0x42 and its flags, an
answer with its status; both end with the number of the request. Fields as in `arvgvcpprivate.h` of Aravis.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum

PORT = 3956

_KEY = 0x42
_ACKNOWLEDGE = 0x01
_HEADER = struct.Struct(">BBHHH")
_ANSWER = struct.Struct(">HHHH")


class Command(IntEnum):
    """Commands; the code of the answer is one higher."""

    DISCOVERY = 0x0002
    RESEND = 0x0040
    READ_REGISTER = 0x0080
    WRITE_REGISTER = 0x0082
    READ_MEMORY = 0x0084
    WRITE_MEMORY = 0x0086


class Status(IntEnum):
    """Status codes of answers."""

    SUCCESS = 0x0000
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """One message to a camera."""

    command: int
    number: int
    """Request number, 1 to 65535; the answer repeats it."""
    payload: bytes = b""
    needs_answer: bool = True

    @property
    def words(self) -> tuple[int, ...]:
        """The payload as 32-bit numbers, without remaining bytes at its end."""
        return tuple(word for (word,) in struct.iter_unpack(">I", self.payload[: len(self.payload) // 4 * 4]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """One message from a camera."""

    status: int
    command: int
    """Command of the request."""
    number: int
    payload: bytes = b""


def request_in(datagram: bytes) -> Request | None:
    """The request in a datagram; None if it is not a complete request."""
    if len(datagram) < _HEADER.size:
        return None
    key, flags, command, size, number = _HEADER.unpack_from(datagram)
    payload = datagram[_HEADER.size : _HEADER.size + size]
    if key != _KEY or len(payload) != size:
        return None
    return Request(command=command, number=number, payload=payload, needs_answer=bool(flags & _ACKNOWLEDGE))


def answer_bytes(answer: Answer) -> bytes:
    """The answer as a datagram."""
    answered = answer.command + 1 & 0xFFFF
    return _ANSWER.pack(answer.status, answered, len(answer.payload), answer.number) + answer.payload


def written_payload(count: int) -> bytes:
    """The payload of the answer to a write: the number of registers, or bytes, written."""
    return struct.pack(">HH", 0, count)


def resend_range(payload: bytes) -> tuple[int, int, int] | None:
    """Frame, first and last packet of a resend request; None if it is too short."""
    if len(payload) < 12:
        return None
    _, block, first, last = struct.unpack_from(">HHII", payload)
    return block, first & 0xFFFFFF, last & 0xFFFFFF
