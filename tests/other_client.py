"""An independent GigE Vision client: EMVA's GenApi reads the camera's description and maps its features."""

import socket
import struct

import numpy as np

HEADER = struct.Struct(">BBHHH")


class Port:
    """Register access over UDP, with the methods `read` and `write` that GenApi requires of a port."""

    def __init__(self, address: str) -> None:
        self.control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.control.settimeout(60.0)
        self.control.connect((address, 3956))
        self.stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
        self.stream.bind((self.control.getsockname()[0], 0))
        self.stream.settimeout(60.0)
        self.number = 0

    def command(self, command: int, payload: bytes) -> bytes:
        self.number = self.number % 0xFFFF + 1
        self.control.send(HEADER.pack(0x42, 1, command, len(payload), self.number) + payload)
        answer = self.control.recv(2048)
        status, answered, _, number = struct.unpack_from(">HHHH", answer)
        assert (status, answered, number) == (0, command + 1, self.number)
        return answer[8:]

    def read(self, address: int, length: int) -> bytes:
        data = b""
        while len(data) < length:
            size = min(512, length - len(data))
            padded = -(-size // 4) * 4
            data += self.command(0x84, struct.pack(">II", address + len(data), padded))[4 : 4 + size]
        return data

    def write(self, address: int, data: bytes) -> None:
        self.command(0x86, struct.pack(">I", address) + bytes(data))

    def description(self) -> bytes:
        _, address, size = self.read(0x200, 512).rstrip(b"\0").decode().split(";")
        return self.read(int(address, 16), int(size, 16))

    def frame(self) -> np.ndarray:
        """The next frame: leader, pieces in any order, trailer."""
        pieces: dict[int, bytes] = {}
        shape, last = (0, 0), None
        while last is None or len(pieces) < last - 1:
            datagram = self.stream.recv(20000)
            _, _, infos = struct.unpack_from(">HHI", datagram)
            kind, number = infos >> 24, infos & 0xFFFFFF
            if kind == 1:
                width, height = struct.unpack_from(">II", datagram, 8 + 16)
                shape = (height, width)
            elif kind == 2:
                last = number
            else:
                pieces[number] = datagram[8:]
        data = b"".join(pieces[number] for number in sorted(pieces))
        kind_of_pixel = np.uint8 if len(data) == shape[0] * shape[1] else np.dtype("<u2")
        return np.frombuffer(data, dtype=kind_of_pixel).reshape(shape)

    def close(self) -> None:
        self.control.close()
        self.stream.close()
