"""A client of a page in viser's protocol, in place of a browser."""

import socket

import msgspec.msgpack
import viser
import zstandard
from websockets.sync.client import connect

WAIT_S = 120


class PageClient:
    """An open socket of a page; it keeps the newest properties of each element of the panel."""

    def __init__(self, port: int, host: str | None = None, origin: str | None = None) -> None:
        raw = socket.create_connection(("127.0.0.1", port), timeout=WAIT_S)
        self._client = connect(
            f"ws://{host or f'127.0.0.1:{port}'}/",
            sock=raw,
            origin=origin,
            subprotocols=[f"viser-v{viser.__version__}"],
            compression=None,
            max_size=None,
        )
        self.elements: dict[str, dict] = {}

    def __enter__(self) -> "PageClient":
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def send(self, kind: str, **values: object) -> None:
        """Send a message of a kind."""
        self._client.send(msgspec.msgpack.encode({"type": kind, **values}))

    def look(self) -> None:
        """Send the place from which the scene is seen, after which the page takes the client for a browser."""
        view = {"wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.0] * 3, "look_at": [0.0, 0.0, 1.0], "fov": 1.0}
        more = {"up_direction": [0.0, -1.0, 0.0], "image_height": 100, "image_width": 100, "near": 0.1, "far": 10.0}
        self.send("ViewerCameraMessage", **view, **more)

    def set(self, label: str, value: object) -> None:
        """Set the value of the control with this label."""
        self.wait_for(lambda: self.of(label))
        self.send("GuiUpdateMessage", uuid=self.of(label), updates={"value": value})

    def of(self, label: str) -> str | None:
        """The element with this label."""
        return next((uuid for uuid, each in self.elements.items() if each.get("label") == label), None)

    @property
    def texts(self) -> str:
        """All texts of the page."""
        return "\n".join(each.get("_markdown") or "" for each in self.elements.values())

    @property
    def html(self) -> str:
        """All HTML of the page."""
        return "\n".join(str(each["content"]) for each in self.elements.values() if "content" in each)

    def wait_for(self, condition) -> None:
        """Take in what the page sends until a condition holds."""
        while not condition():
            self.receive()

    def receive(self) -> None:
        """Take in the next messages: two lengths, compressed MessagePack, and arrays."""
        data = self._client.recv(WAIT_S)
        length = int.from_bytes(data[8:16], "little")
        for message in msgspec.msgpack.decode(zstandard.decompress(data[16 : 16 + length]))["messages"]:
            if "props" in message and "uuid" in message:
                self.elements[message["uuid"]] = {**message["props"], "value": message.get("value")}
            elif message["type"] == "GuiUpdateMessage":
                self.elements.setdefault(message["uuid"], {}).update(message["updates"])
