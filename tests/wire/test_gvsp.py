"""GVSP packets against bytes derived by hand from the published layout."""

import pytest

from ringpose.wire.gvsp import (
    Kind,
    Leader,
    PixelFormat,
    StreamedFrame,
    block_after,
    blocks_between,
    piece_size,
)

LEADER = Leader(stamp_ticks=0x0102030405060708, pixel_format=PixelFormat.MONO8, width=4, height=3)

FRAME = StreamedFrame(block=9, leader=LEADER, data=memoryview(bytes(range(12))), piece_size=5)


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (0, "0000000901000000" + "00000001" + "0102030405060708" + "01080001" + "00000004" + "00000003" + 12 * "00"),
        (1, "0000000903000001" + "0001020304"),
        (3, "0000000903000003" + "0a0b"),
        (4, "0000000902000004" + "00000001" + "00000003"),
    ],
    ids=["leader", "first piece", "last piece", "trailer"],
)
def test_a_packet_has_the_bytes_of_the_standard(number, text):
    assert FRAME.datagram(number).hex() == text


def test_the_payload_packets_contain_the_frame():
    datagrams = [FRAME.datagram(number) for number in range(FRAME.packets)]

    numbers = [int.from_bytes(datagram[5:8], "big") for datagram in datagrams]
    assert [datagram[4] for datagram in datagrams] == [Kind.LEADER, *3 * [Kind.PAYLOAD], Kind.TRAILER]
    assert numbers == [0, 1, 2, 3, 4]
    assert b"".join(datagram[8:] for datagram in datagrams[1:-1]) == bytes(range(12))


def test_a_packet_has_the_requested_size_on_the_wire():
    frame = StreamedFrame(block=1, leader=LEADER, data=memoryview(bytes(5000)), piece_size=piece_size(1400))

    assert len(frame.datagram(1)) + 20 + 8 == 1400


@pytest.mark.parametrize(("block", "following"), [(1, 2), (65534, 65535), (65535, 1)])
def test_no_frame_has_the_number_0(block, following):
    assert block_after(block) == following


@pytest.mark.parametrize(("last", "block", "lost"), [(1, 2, 0), (1, 5, 3), (65535, 1, 0), (65534, 2, 2)])
def test_lost_frames_are_counted_across_the_wrap(last, block, lost):
    assert blocks_between(last, block) == lost


@pytest.mark.parametrize(("last", "block"), [(7, 7), (7, 5), (1, 65535)], ids=["twice", "late", "late, at the wrap"])
def test_a_late_frame_does_not_count_as_lost_ones(last, block):
    assert blocks_between(last, block) == 0


@pytest.mark.parametrize(("name", "size"), [("MONO8", 1), ("MONO12", 2)])
def test_a_pixel_format_has_its_bytes_per_pixel(name, size):
    assert PixelFormat[name].bytes_per_pixel == size
