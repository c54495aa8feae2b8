"""A client of the image server, written from ringpose-images(5) alone: nothing of the program is used."""

import hashlib
import hmac
import json
import socket
import struct

import numpy as np


class ImageClient:
    """A connection; `frame()` and `answer()` read messages of one kind and keep those of the other."""

    def __init__(self, port, *, secret=None, receive_buffer=None, timeout_s=20.0, hello=True):
        self.socket = socket.socket()
        if receive_buffer is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.settimeout(timeout_s)
        self.socket.connect(("127.0.0.1", port))
        self.greeting = None
        if hello:
            self.send(type="hello", protocol="ringpose/images/1")
            self.greeting, _ = self.message()
            if self.greeting["type"] == "challenge":
                text = b"ringpose images client:" + self.greeting["nonce"].encode()
                self.send(type="proof", proof=hmac.new(secret, text, hashlib.sha256).hexdigest())
                self.greeting, _ = self.message()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, **header):
        text = json.dumps(header).encode()
        self.socket.sendall(b"RPI1" + struct.pack(">II", len(text), 0) + text)

    def ask(self, **header):
        """Send a request and return its answer; frames that come before it are skipped."""
        self.send(**header)
        while True:
            answer, _ = self.message()
            if answer["type"] != "frame":
                return answer

    def message(self):
        magic, header_bytes, payload_bytes = struct.unpack(">4sII", self._read(12))
        assert magic == b"RPI1"
        return json.loads(self._read(header_bytes)), self._read(payload_bytes)

    def frame(self):
        header, payload = self.message()
        assert header["type"] == "frame", header
        image = np.frombuffer(payload, f"<u{header['pixel_bytes']}").reshape(header["height"], header["width"])
        return header, image

    def frames(self, count, **subscription):
        self.send(type="subscribe", frames=count, **subscription)
        return [self.frame() for _ in range(count)]

    def ends(self):
        """Whether the server closes the connection without another message."""
        try:
            return self.socket.recv(1) == b""
        except ConnectionResetError:
            return True

    def _read(self, size):
        data = b""
        while len(data) < size:
            part = self.socket.recv(min(size - len(data), 1 << 20))
            if not part:
                raise EOFError(data)
            data += part
        return data
