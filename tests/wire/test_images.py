"""The messages of the image stream: what one side writes the other reads, and everything else is rejected."""

import json
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.wire import images as wire
from ringpose.wire.images import MalformedMessage

GREETING = wire.Greeting(
    clock="lockstep",
    rate_hz=5.0,
    camera_name="rig b",
    image_width=20,
    image_height=10,
    saturation_dn=4095,
    lasers=("left", "right"),
    sequence=(0, 1, 2, 3),
    min_exposure_s=1e-5,
    max_exposure_s=0.1,
)


def header_of(message):
    header_bytes, payload_bytes = wire.lengths_in(message[:12], wire.MAX_PAYLOAD)
    assert len(message) == 12 + header_bytes
    return wire.header_in(message[12:]), payload_bytes


def frame_of(image, **changes):
    given = {"frame_id": 7, "shot": "a_1", "step": 2, "lasers": 3, "stamp_s": 1.75e9 + 0.125, "exposure_s": 0.004}
    return wire.ServedFrame(image=image, **(given | changes))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_frame_arrives_as_it_was_sent(rng, dtype):
    image = rng.integers(0, np.iinfo(dtype).max, (10, 20), dtype=dtype)
    frame = frame_of(image, missed=2, dropped=5, truth={"center_m": [0.1, 0.2, 0.3]})
    payload = wire.pixels(image)

    header, payload_bytes = header_of(wire.encoded_prefix(wire.frame_header(frame), len(payload)))
    after = wire.frame_in(header, bytes(payload))

    assert payload_bytes == image.nbytes
    np.testing.assert_array_equal(after.image, image)
    assert after.image.dtype == dtype
    assert wire.frame_header(after) == wire.frame_header(frame)


def test_pixels_of_sixteen_bits_are_little_endian():
    assert bytes(wire.pixels(np.array([[0x0102]], dtype=np.uint16))) == struct.pack("<H", 0x0102)
    assert bytes(wire.pixels(np.array([[0x0102]], dtype=">u2"))) == struct.pack("<H", 0x0102)


def test_a_view_of_an_image_is_sent_row_by_row():
    image = np.arange(24, dtype=np.uint8).reshape(4, 6)[::2, ::3]

    assert bytes(wire.pixels(image)) == bytes([0, 3, 12, 15])


def test_a_greeting_arrives_as_it_was_sent():
    header, _ = header_of(wire.message(wire.greeting_header(GREETING)))

    assert wire.greeting_in(header) == GREETING


@pytest.mark.parametrize(
    ("prefix", "finding"),
    [
        (b"HTTP" + struct.pack(">II", 10, 0), "begins"),
        (b"RPI1" + struct.pack(">II", 0, 0), "header"),
        (b"RPI1" + struct.pack(">II", wire.MAX_HEADER + 1, 0), "header"),
        (b"RPI1" + struct.pack(">II", 10, 1), "payload"),
    ],
)
def test_a_wrong_prefix_is_rejected(prefix, finding):
    with pytest.raises(MalformedMessage, match=finding):
        wire.lengths_in(prefix, max_payload=0)


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b'{"a": NaN}', b"\xff", b"[" * 10000, b"1"])
def test_a_header_that_is_no_object_is_rejected(text):
    with pytest.raises(MalformedMessage, match="header"):
        wire.header_in(text)


@pytest.mark.parametrize(
    "header",
    [
        {"type": "unknown"},
        {"type": ["subscribe"]},
        {"type": "subscribe", "frames": 0},
        {"type": "subscribe", "frames": 1.5},
        {"type": "subscribe", "frames": True},
        {"type": "subscribe", "whole_shots": 1},
        {"type": "lasers", "mask": 256},
        {"type": "lasers", "mask": "1"},
        {"type": "exposure", "exposure_s": -1.0},
        {"type": "exposure", "exposure_s": 10**400},
        {"type": "pose", "center_m": [0, 0], "normal": [0, 0, -1]},
        {"type": "pose", "center_m": [0, 0, 1], "normal": [0, 0, 0]},
        {"type": "pose", "center_m": [0, 0, 1], "normal": [0, 0, None]},
        {"type": "trajectory", "poses": [1]},
        {"type": "time", "time_s": -1},
    ],
)
def test_a_wrong_request_is_rejected(header):
    with pytest.raises(MalformedMessage):
        wire.request_in(wire.Header(header))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
REQUESTS = ["subscribe", "unsubscribe", "lasers", "exposure", "pose", "trajectory", "time"]
REQUEST_KEYS = ["frames", "whole_shots", "mask", "exposure_s", "center_m", "normal", "poses", "time_s", "light"]
GREETED, FRAME = wire.greeting_header(GREETING), wire.frame_header(frame_of(np.zeros((2, 3), np.uint8)))
READERS = {
    **{kind: (wire.request_in, wire.Request, {"type": kind}, REQUEST_KEYS, ()) for kind in REQUESTS},
    "greeting": (
        wire.greeting_in,
        wire.Greeting,
        wire.greeting_header(GREETING),
        [*wire.greeting_header(GREETING)],
        (),
    ),
    "frame": (wire.frame_in, wire.ServedFrame, FRAME, [*FRAME], (bytes(6),)),
}
"""For each kind of message: its reader, what it returns, a header, the keys that are changed, and the payload."""


@pytest.mark.parametrize(
    "kind",
    ["pose", "greeting", "frame", *(pytest.param(kind, marks=pytest.mark.slow) for kind in REQUESTS if kind != "pose")],
)
@given(data=st.data())
def test_any_header_is_read_or_rejected_in_one_line(kind, data):
    reader, made, header, keys, payload = READERS[kind]
    changes = data.draw(st.dictionaries(st.sampled_from(keys), JSON, max_size=4))

    try:
        read, lines = reader(wire.header_in(json.dumps(header | changes).encode()), *payload), 0
    except MalformedMessage as problem:
        read, lines = None, len(str(problem).splitlines())

    assert lines == 1 if read is None else isinstance(read, made)
    assert read is None or kind != "frame" or read.image.nbytes == 6


@pytest.mark.parametrize("name", ["", "../a", "a/b", ".a", "a\nb", "a b", "C:a"])
def test_a_shot_name_that_could_be_a_path_is_rejected(name):
    sent = wire.frame_header(frame_of(np.zeros((2, 3), np.uint8))) | {"shot": name}

    with pytest.raises(MalformedMessage, match="shot"):
        wire.frame_in(wire.Header(sent), bytes(6))


def test_another_version_of_the_protocol_is_named():
    header = wire.Header({"type": "greeting", "protocol": "ringpose/images/2"})

    with pytest.raises(MalformedMessage, match="images/2"):
        wire.greeting_in(header)


def test_proof_and_token_depend_on_the_secret_and_do_not_contain_it():
    secret, other = b"0123456789abcdef", b"0123456789abcdeg"

    assert wire.challenge_answer(secret, "n") != wire.challenge_answer(other, "n")
    assert wire.challenge_answer(secret, "n") != wire.challenge_answer(secret, "m")
    assert wire.stream_token(secret) != wire.stream_token(other)
    assert wire.stream_token(secret) not in wire.challenge_answer(secret, "")
