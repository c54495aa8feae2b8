"""The stand-in camera's register space: bootstrap registers, its own, and the XML behind them."""

import ipaddress
import struct
from dataclasses import dataclass

from ringpose.simulate.serve import features
from ringpose.wire import gige_registers as bootstrap
from ringpose.wire.gvsp import PixelFormat

HEARTBEAT_MS = 3000

TICKS_PER_S = 1_000_000_000

BOUNDED = {
    features.EXPOSURE_TIME: features.EXPOSURE_BOUNDS_US,
    features.GAIN: features.GAIN_BOUNDS_DB,
    features.FRAME_RATE: features.FRAME_RATE_BOUNDS_HZ,
}
"""Floating-point numbers that a client may set."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """What the camera says of itself."""

    address: str
    """The IPv4 address that it listens on."""
    width: int
    height: int
    bits: int
    exposure_s: float
    serial: str = "RP0001"


class Registers:
    """Big-endian memory; what is computed when it is read is kept up by the device."""

    def __init__(self, identity: Identity) -> None:
        self._memory = bytearray(features.XML_ADDRESS) + features.description()
        self._memory += bytes(-len(self._memory) % 4)
        self._write_identity(identity)
        self._write_defaults(identity)

    def read(self, address: int, size: int) -> bytes | None:
        """Bytes; None if some of them are not there."""
        if address + size > len(self._memory):
            return None
        return bytes(self._memory[address : address + size])

    def write(self, address: int, data: bytes) -> bool:
        """Put bytes into the memory; whether there is room before the XML."""
        if address + len(data) > features.XML_ADDRESS:
            return False
        self._memory[address : address + len(data)] = data
        return True

    def __getitem__(self, address: int) -> int:
        """A 32-bit number."""
        (value,) = struct.unpack_from(">I", self._memory, address)
        return int(value)

    def __setitem__(self, address: int, value: int) -> None:
        struct.pack_into(">I", self._memory, address, value & 0xFFFFFFFF)

    def number(self, address: int, bounds: tuple[float, float]) -> float:
        """A floating-point number within its bounds, whatever a client wrote; the least for what is no number."""
        (value,) = struct.unpack_from(">d", self._memory, address)
        return float(min(value, bounds[1])) if value > bounds[0] else bounds[0]

    def set_number(self, address: int, value: float) -> None:
        """Write a floating-point number."""
        struct.pack_into(">d", self._memory, address, value)

    @property
    def pixel_format(self) -> PixelFormat:
        """As a client set it last; Mono8 if that is none that the camera has."""
        is_deep = self[features.PIXEL_FORMAT] == PixelFormat.MONO12
        return PixelFormat.MONO12 if is_deep else PixelFormat.MONO8

    def renew(self) -> None:
        """Recompute what depends on other registers, and bring numbers back into their bounds."""
        for address, bounds in BOUNDED.items():
            self.set_number(address, self.number(address, bounds))
        self[features.PIXEL_FORMAT] = self.pixel_format
        pixels = self[features.WIDTH] * self[features.HEIGHT]
        self[features.PAYLOAD_SIZE] = pixels * self.pixel_format.bytes_per_pixel

    def _write_identity(self, identity: Identity) -> None:
        self[bootstrap.VERSION] = 0x00010002
        self[bootstrap.DEVICE_MODE] = bootstrap.BIG_ENDIAN_UTF8
        ip = int(ipaddress.IPv4Address(identity.address))
        self[bootstrap.MAC_HIGH], self[bootstrap.MAC_LOW] = 0x0200, ip
        self[bootstrap.SUPPORTED_IP_CONFIGURATION] = self[bootstrap.CURRENT_IP_CONFIGURATION] = 0x4
        self[bootstrap.CURRENT_IP_ADDRESS], self[bootstrap.CURRENT_SUBNET_MASK] = ip, 0xFF000000
        self[bootstrap.NETWORK_INTERFACES] = self[bootstrap.STREAM_CHANNELS] = 1
        there = bootstrap.SERIAL_NUMBER_THERE | bootstrap.NAME_THERE
        self[bootstrap.CAPABILITY] = there | bootstrap.WRITE_MEMORY | bootstrap.PACKET_RESEND
        self[bootstrap.TICK_FREQUENCY_LOW] = TICKS_PER_S
        xml_size = len(features.description())
        for address, text in (
            (bootstrap.MANUFACTURER_NAME, "ringpose"),
            (bootstrap.MODEL_NAME, "Stand-in"),
            (bootstrap.DEVICE_VERSION, "1"),
            (bootstrap.MANUFACTURER_INFO, "simulated"),
            (bootstrap.SERIAL_NUMBER, identity.serial),
            (bootstrap.XML_URL, f"Local:ringpose.xml;{features.XML_ADDRESS:x};{xml_size:x}"),
        ):
            self.write(address, text.encode()[: bootstrap.TEXTS[address] - 1])

    def _write_defaults(self, identity: Identity) -> None:
        self[bootstrap.HEARTBEAT_TIMEOUT] = HEARTBEAT_MS
        self[bootstrap.STREAM_PACKET_SIZE] = 1400
        self[features.WIDTH], self[features.HEIGHT] = identity.width, identity.height
        self[features.PIXEL_FORMAT] = PixelFormat.MONO8 if identity.bits == 8 else PixelFormat.MONO12
        self[features.LINE_MODE] = 1
        self.set_number(features.EXPOSURE_TIME, 1e6 * identity.exposure_s)
        self.set_number(features.FRAME_RATE, 10.0)
        self.set_number(features.TEMPERATURE, 41.5)
        self.renew()
