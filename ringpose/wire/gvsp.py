"""GVSP, the stream protocol of GigE Vision cameras: a frame as datagrams: leader, payload packets, trailer.

Each datagram begins with a status, the number of the frame (16 bits, never 0), the kind of packet and the number of the
packet, which is 0 for the leader. Fields as in `arvgvspprivate.h` of Aravis.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum

HEADER_SIZE = 8

UDP_OVERHEAD = 28
"""Bytes of the IP and UDP headers, which are included in the packet size of a stream."""

PAYLOAD_OVERHEAD = UDP_OVERHEAD + HEADER_SIZE

_HEADER = struct.Struct(">HHI")
_LEADER = struct.Struct(">HHQIIIIIHH")
_TRAILER = struct.Struct(">II")
_IMAGE = 0x0001


class Kind(IntEnum):
    """Kinds of packets."""

    LEADER = 1
    TRAILER = 2
    PAYLOAD = 3


class PixelFormat(IntEnum):
    """Numbers of the pixel formats in the GenICam naming convention."""

    MONO8 = 0x01080001
    MONO12 = 0x01100005
    """Twelve bits in the lower part of sixteen, little-endian."""

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes of a pixel, from the size field of the format."""
        return (self.value >> 16 & 0xFF) // 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Leader:
    """Metadata of a frame, sent before its image."""

    stamp_ticks: int
    pixel_format: int
    width: int
    height: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StreamedFrame:
    """A frame as datagrams, each encoded when it is sent or sent again."""

    block: int
    leader: Leader
    data: memoryview
    piece_size: int
    """Image bytes in a packet."""

    @property
    def packets(self) -> int:
        """Number of datagrams of the frame, leader and trailer included."""
        return 2 + -(-len(self.data) // self.piece_size)

    def datagram(self, number: int) -> bytes:
        """The packet of this number, from 0 (the leader) to the last one (the trailer)."""
        if number == 0:
            return _HEADER.pack(0, self.block, Kind.LEADER << 24) + self._leader_payload()
        if number == self.packets - 1:
            trailer = _TRAILER.pack(_IMAGE, self.leader.height)
            return _HEADER.pack(0, self.block, Kind.TRAILER << 24 | number) + trailer
        piece = self.data[(number - 1) * self.piece_size : number * self.piece_size]
        return _HEADER.pack(0, self.block, Kind.PAYLOAD << 24 | number) + piece

    def _leader_payload(self) -> bytes:
        leader = self.leader
        size = (leader.width, leader.height)
        return _LEADER.pack(0, _IMAGE, leader.stamp_ticks, leader.pixel_format, *size, 0, 0, 0, 0)


def piece_size(packet_size: int) -> int:
    """Image bytes in a packet of this size on the wire."""
    return max(packet_size - PAYLOAD_OVERHEAD, 1)


def block_after(block: int) -> int:
    """Number of the next frame; 0 is skipped."""
    return block % 0xFFFF + 1


def blocks_between(last: int, block: int) -> int:
    """Number of frames lost between two received ones; 0 if the second is late or repeated."""
    lost = (block - last - 1) % 0xFFFF
    return lost if lost < 0x8000 else 0
