"""The image stream of `ringpose simulate serve --images` over TCP, as ringpose-images(5) describes it.

A message is a prefix of twelve bytes (`PREFIX`), a header, which is a JSON object with the key `type`, and a payload:
the pixels of a frame, else nothing. Both sides check what they receive here, before memory of a declared size is
allocated.
"""

import hashlib
import hmac
import json
import math
import re
import struct
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

import numpy as np

from ringpose.types.arrays import Array, UInt

PROTOCOL = "ringpose/images/1"

PREFIX = struct.Struct(">4sII")
"""Magic, length of the header, length of the payload."""

MAGIC = b"RPI1"

MAX_HEADER = 1 << 20
"""Bytes; a trajectory of a few thousand views is the longest header."""

MAX_PAYLOAD = 1 << 28
"""Bytes: 128 million pixels of 16 bits."""

MAX_SEQUENCE = 16
"""Frames of a shot."""

MAX_VIEWS = 10_000
"""Views of a trajectory."""

MAX_NUMBER = 2**53

Clock = Literal["wall", "lockstep"]


class MalformedMessage(Exception):
    """A message that breaks the protocol, in words for the other side; the connection is closed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Greeting:
    """What the server reports about itself when a client has been admitted."""

    clock: Clock
    rate_hz: float
    """Frames a second; with the clock `lockstep` of simulated time."""
    camera_name: str
    image_width: int
    image_height: int
    saturation_dn: int
    lasers: tuple[str, ...]
    """Names, in the order of the mask's bits."""
    sequence: tuple[int, ...]
    """Laser mask of each frame of a shot."""
    min_exposure_s: float
    max_exposure_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ServedFrame:
    """One exposure with its header."""

    image: UInt[Array, "row column"]
    frame_id: int
    """Number of the exposure, from 1."""
    shot: str
    """Name of the shot that it belongs to."""
    step: int
    """Place of the frame in the shot, from 0."""
    lasers: int
    stamp_s: float
    """Start of the exposure: Unix epoch, UTC; with the clock `lockstep` simulated time."""
    exposure_s: float
    dropped: int = 0
    """Frames that the server could not render in time since it started."""
    missed: int = 0
    """Frames that this client has missed since its previous frame."""
    truth: Mapping[str, Any] | None = None
    """The line of truth.jsonl of its shot (ringpose-conventions(7))."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Subscribe:
    """Asks for frames; `frames` None for all that follow, `whole_shots` to begin with the first frame of a shot."""

    frames: int | None
    whole_shots: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SetLasers:
    """Sets the mask of every frame; None for the masks of the sequence."""

    mask: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SetExposure:
    """Sets the exposure; None for the exposure that the scene defines."""

    exposure_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ServedPose:
    """A pose of the ring in the camera frame."""

    center_m: tuple[float, float, float]
    normal: tuple[float, float, float]
    """Normal towards the camera; any length above 0."""
    roll_rad: float = 0.0
    light: str | None = None
    """Name of a light of the scene; None for that of its first view."""
    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the ring's centre; the pose is that at the begin of a shot ..."""
    angular_velocity_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """... and angular velocity of the target, both constant within it."""

    @property
    def is_moving(self) -> bool:
        """Whether it changes within a shot."""
        return any(self.velocity_m_s) or any(self.angular_velocity_rad_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class SetTrajectory:
    """Shows these poses in turn, one a shot; empty for the trajectory of the scene. A single one is a fixed pose."""

    poses: tuple[ServedPose, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SetTime:
    """Continues at another time of the trajectory, rounded down to a shot; `paused` holds it there."""

    time_s: float
    paused: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Unsubscribe:
    """Ends the subscription."""


Request = Subscribe | Unsubscribe | SetLasers | SetExposure | SetTrajectory | SetTime


def message(header: Mapping[str, Any]) -> bytes:
    """A message without payload."""
    return encoded_prefix(header, 0)


def encoded_prefix(header: Mapping[str, Any], payload_bytes: int) -> bytes:
    """Prefix and header of a message; its payload follows."""
    text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
    return PREFIX.pack(MAGIC, len(text), payload_bytes) + text


def lengths_in(prefix: bytes, max_payload: int) -> tuple[int, int]:
    """Lengths of header and payload."""
    magic, header_bytes, payload_bytes = PREFIX.unpack(prefix)
    if magic != MAGIC:
        raise MalformedMessage(f"a message begins with {MAGIC!r}, not with {magic!r}")
    if not 0 < header_bytes <= MAX_HEADER:
        raise MalformedMessage(f"the header has {header_bytes} bytes; 1 to {MAX_HEADER} are allowed")
    if payload_bytes > max_payload:
        raise MalformedMessage(f"the payload has {payload_bytes} bytes; at most {max_payload} are allowed")
    return header_bytes, payload_bytes


def header_in(encoded: bytes) -> "Header":
    """Parse the header of a message; anything but a JSON object raises `MalformedMessage`."""
    try:
        values = json.loads(encoded, parse_constant=_reject_constant)
    except (ValueError, RecursionError):
        raise MalformedMessage("the header is not valid JSON") from None
    if not isinstance(values, dict):
        raise MalformedMessage("the header is not a JSON object")
    return Header(values)


def _reject_constant(word: str) -> None:
    raise ValueError(word)


def challenge_answer(secret: bytes, nonce: str) -> str:
    """The proof that a client has the secret: HMAC-SHA-256 of the server's nonce."""
    return hmac.new(secret, b"ringpose images client:" + nonce.encode(), hashlib.sha256).hexdigest()


def stream_token(secret: bytes) -> str:
    """The token of `/stream.mjpg`, from which the secret cannot be computed."""
    return hmac.new(secret, b"ringpose images stream", hashlib.sha256).hexdigest()[:32]


class Header:
    """The keys and values of a message's header. Methods check a value; a wrong one raises `MalformedMessage`."""

    def __init__(self, values: Mapping[str, Any], name: str = "") -> None:
        self.values = values
        self.type = values.get("type") if isinstance(values.get("type"), str) else ""
        self._name = name or str(self.type)[:40]

    def problem(self, key: str, finding: str) -> MalformedMessage:
        """The error to raise for one value."""
        return MalformedMessage(f"{self._name}: {key} {finding}")

    def has(self, key: str) -> bool:
        """Whether a value is given and not null."""
        return self.values.get(key) is not None

    def integer(self, key: str, minimum: int = 0, maximum: int = MAX_NUMBER) -> int:
        """The whole number of a key, within these bounds."""
        value = self.values.get(key)
        if type(value) is not int or not minimum <= value <= maximum:
            raise self.problem(key, f"must be a whole number from {minimum} to {maximum}")
        return value

    def number(self, key: str, minimum: float = -1e12, maximum: float = 1e12) -> float:
        """The finite number of a key, within these bounds."""
        value = self.values.get(key)
        if type(value) not in (int, float) or not minimum <= value <= maximum:  # type: ignore[operator]
            raise self.problem(key, f"must be a number from {minimum:g} to {maximum:g}")
        return float(value)  # type: ignore[arg-type]

    def boolean(self, key: str) -> bool:
        """The boolean of a key; false if the key is missing."""
        value = self.values.get(key, False)
        if not isinstance(value, bool):
            raise self.problem(key, "must be true or false")
        return value

    def text(self, key: str, longest: int = 200) -> str:
        """The text of a key, which can be printed on one line."""
        value = self.values.get(key)
        if not isinstance(value, str) or len(value) > longest or not value.isprintable():
            raise self.problem(key, f"must be a printable text of at most {longest} characters")
        return value

    def items(self, key: str, longest: int) -> "Header":
        """The list of a key, as a header with the numbers "0", "1", ... of its items as keys."""
        value = self.values.get(key)
        if not isinstance(value, list) or len(value) > longest:
            raise self.problem(key, f"must be a list of at most {longest} items")
        return Header({str(number): item for number, item in enumerate(value)}, f"{self._name}: {key}")

    def vector(self, key: str) -> tuple[float, float, float]:
        """The list of three finite numbers of a key."""
        parts = self.items(key, 3)
        return parts.number("0"), parts.number("1"), parts.number("2")


def request_in(header: Header) -> Request:
    """The request in a header from a client."""
    reader = _REQUESTS.get(str(header.type))
    if reader is None:
        raise MalformedMessage(f'"{str(header.type)[:40]}" is not a request; use one of {", ".join(_REQUESTS)}')
    request: Request = reader(header)
    return request


def _pose_in(header: Header) -> ServedPose:
    normal = header.vector("normal")
    if not 1e-6 < math.hypot(*normal) < 1e6:
        raise header.problem("normal", "must not be zero")
    rates = {name: header.vector(name) for name in ("velocity_m_s", "angular_velocity_rad_s") if header.has(name)}
    return ServedPose(
        center_m=header.vector("center_m"),
        normal=normal,
        roll_rad=header.number("roll_rad", -100, 100) if header.has("roll_rad") else 0.0,
        light=header.text("light") if header.has("light") else None,
        **rates,
    )


def _trajectory_in(header: Header) -> SetTrajectory:
    if not header.has("poses"):
        return SetTrajectory(poses=())
    poses = list(header.items("poses", MAX_VIEWS).values.values())
    if not all(isinstance(each, dict) for each in poses):
        raise header.problem("poses", "must be a list of objects with center_m and normal")
    return SetTrajectory(poses=tuple(_pose_in(Header(each, f"pose {k}")) for k, each in enumerate(poses, start=1)))


_REQUESTS: Mapping[str, Any] = {
    "subscribe": lambda header: Subscribe(
        frames=header.integer("frames", 1, 1_000_000) if header.has("frames") else None,
        whole_shots=header.boolean("whole_shots"),
    ),
    "unsubscribe": lambda _: Unsubscribe(),
    "lasers": lambda header: SetLasers(mask=header.integer("mask", 0, 255) if header.has("mask") else None),
    "exposure": lambda header: SetExposure(
        exposure_s=header.number("exposure_s", 1e-9, 1e3) if header.has("exposure_s") else None
    ),
    "pose": lambda header: SetTrajectory(poses=(_pose_in(header),)),
    "trajectory": _trajectory_in,
    "time": lambda header: SetTime(time_s=header.number("time_s", 0.0, 1e9), paused=header.boolean("paused")),
}
"""Reader of each request by its type."""


def greeting_header(greeting: Greeting) -> dict[str, Any]:
    """The header of the greeting."""
    return {"type": "greeting", "protocol": PROTOCOL, **asdict(greeting)}


def greeting_in(header: Header) -> Greeting:
    """The greeting of a server."""
    protocol = header.text("protocol")
    if protocol != PROTOCOL:
        raise MalformedMessage(f"the server uses the protocol {protocol}, this program {PROTOCOL}")
    clock = header.text("clock")
    if clock not in ("wall", "lockstep"):
        raise header.problem("clock", "must be wall or lockstep")
    lasers, masks = header.items("lasers", 8), header.items("sequence", MAX_SEQUENCE)
    if not masks.values:
        raise header.problem("sequence", "is empty")
    names = tuple(lasers.text(key) for key in lasers.values)
    return Greeting(
        clock="wall" if clock == "wall" else "lockstep",
        rate_hz=header.number("rate_hz", 1e-6, 1e6),
        camera_name=header.text("camera_name"),
        image_width=header.integer("image_width", 1, 1 << 16),
        image_height=header.integer("image_height", 1, 1 << 16),
        saturation_dn=header.integer("saturation_dn", 1, 65535),
        lasers=names,
        sequence=tuple(masks.integer(key, 0, (1 << len(names)) - 1) for key in masks.values),
        min_exposure_s=header.number("min_exposure_s", 0.0, 1e3),
        max_exposure_s=header.number("max_exposure_s", 0.0, 1e3),
    )


def frame_header(frame: ServedFrame) -> dict[str, Any]:
    """The header of a frame."""
    height, width = frame.image.shape
    values = {field.name: getattr(frame, field.name) for field in fields(frame) if field.name != "image"}
    return {"type": "frame", "width": width, "height": height, "pixel_bytes": frame.image.dtype.itemsize, **values}


def pixels(image: UInt[Array, "row column"]) -> memoryview:
    """The payload: row by row, 16 bits as little-endian."""
    stored = image.dtype.newbyteorder("<")
    return np.ascontiguousarray(image, dtype=stored).data.cast("B")


def _shot_name(header: Header) -> str:
    """The name of a shot, which must be valid as the name of a file."""
    name = header.text("shot")
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*", name):
        raise header.problem("shot", "must consist of letters, digits and _ . + -, and not begin with a point")
    return name


def frame_in(header: Header, payload: bytes) -> ServedFrame:
    """The frame of a message."""
    width, height = header.integer("width", 1, 1 << 16), header.integer("height", 1, 1 << 16)
    pixel_bytes = header.integer("pixel_bytes", 1, 2)
    if width * height * pixel_bytes != len(payload):
        raise MalformedMessage(f"a frame of {width} x {height} pixels of {pixel_bytes} bytes has {len(payload)} bytes")
    image = np.frombuffer(payload, dtype=f"<u{pixel_bytes}").reshape(height, width)
    if sys.byteorder == "big":
        image = image.astype(image.dtype.newbyteorder("="))
    truth = header.values.get("truth")
    if truth is not None and not isinstance(truth, dict):
        raise header.problem("truth", "must be an object")
    return ServedFrame(
        image=image,
        frame_id=header.integer("frame_id"),
        shot=_shot_name(header),
        step=header.integer("step", 0, MAX_SEQUENCE - 1),
        lasers=header.integer("lasers", 0, 255),
        stamp_s=header.number("stamp_s"),
        exposure_s=header.number("exposure_s", 0.0, 1e3),
        dropped=header.integer("dropped"),
        missed=header.integer("missed"),
        truth=truth,
    )
