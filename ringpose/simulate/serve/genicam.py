"""The stand-in camera's own registers, and the GenICam description by which clients find them.

Names and values are those of the Standard Features Naming Convention (SFNC 2).

The stand-in camera's register space: bootstrap registers, its own, and the XML behind them.
"""

import ipaddress
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ringpose.wire import gige_registers as bootstrap
from ringpose.wire.gvsp import PixelFormat

WIDTH = 0xA000

HEIGHT = 0xA004

PIXEL_FORMAT = 0xA008

PAYLOAD_SIZE = 0xA00C

ACQUISITION_START = 0xA010

ACQUISITION_STOP = 0xA014

ACQUISITION_MODE = 0xA018

MISSED_TRIGGERS = 0xA01C

EXPOSURE_TIME = 0xA020

GAIN = 0xA028

FRAME_RATE = 0xA030

TEMPERATURE = 0xA038

TRIGGER_SELECTOR = 0xA040

TRIGGER_MODE = 0xA044

TRIGGER_SOURCE = 0xA048

TRIGGER_SOFTWARE = 0xA04C

LINE_SELECTOR = 0xA050

LINE_MODE = 0xA054

USER_OUTPUT_SELECTOR = 0xA058

USER_OUTPUT_VALUE_ALL = 0xA05C

LINE_SOURCE = 0xA080
"""One word for each line."""

USER_OUTPUT_VALUE = 0xA0C0
"""One word for each output."""

CONTINUOUS, SINGLE_FRAME = 0, 1

LINES = 8
"""Output lines: one for each laser that a mask can name."""

EXPOSURE_BOUNDS_US = (10.0, 1_000_000.0)

GAIN_BOUNDS_DB = (0.0, 24.0)

FRAME_RATE_BOUNDS_HZ = (0.1, 200.0)

XML_ADDRESS = 0x10000

_HEAD = """\
<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="Stand-in" VendorName="ringpose" StandardNameSpace="GEV" SchemaMajorVersion="1"
 SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
 ToolTip="Simulated camera" ProductGuid="5b1d2c54-52d1-4bb0-9f14-0d7f3a6e0001"
 VersionGuid="5b1d2c54-52d1-4bb0-9f14-0d7f3a6e0002" xmlns="http://www.genicam.org/GenApi/Version_1_1">
"""

_CATEGORIES = {
    "DeviceControl": (
        "DeviceVendorName",
        "DeviceModelName",
        "DeviceVersion",
        "DeviceSerialNumber",
        "DeviceUserID",
        "DeviceTemperature",
    ),
    "ImageFormatControl": ("Width", "Height", "PixelFormat"),
    "AcquisitionControl": (
        "AcquisitionMode",
        "AcquisitionStart",
        "AcquisitionStop",
        "AcquisitionFrameRate",
        "TriggerSelector",
        "TriggerMode",
        "TriggerSource",
        "TriggerSoftware",
        "ExposureTime",
        "MissedTriggers",
    ),
    "AnalogControl": ("Gain",),
    "DigitalIOControl": (
        "LineSelector",
        "LineMode",
        "LineSource",
        "UserOutputSelector",
        "UserOutputValue",
        "UserOutputValueAll",
    ),
    "TransportLayerControl": (
        "PayloadSize",
        "TLParamsLocked",
        "GevSCPSPacketSize",
        "GevSCPHostPort",
        "GevSCDA",
        "GevCCP",
        "GevHeartbeatTimeout",
    ),
}


def description() -> bytes:
    """The GenICam XML."""
    nodes = [_category("Root", _CATEGORIES)]
    nodes += [_category(name, features) for name, features in _CATEGORIES.items()]
    nodes += [*_device_nodes(), *_picture_nodes(), *_trigger_nodes(), *_line_nodes(), *_transport_nodes()]
    return (_HEAD + "\n".join(nodes) + '\n<Port Name="Device"/>\n</RegisterDescription>\n').encode()


def _device_nodes() -> Iterable[str]:
    yield _text("DeviceVendorName", bootstrap.MANUFACTURER_NAME)
    yield _text("DeviceModelName", bootstrap.MODEL_NAME)
    yield _text("DeviceVersion", bootstrap.DEVICE_VERSION)
    yield _text("DeviceSerialNumber", bootstrap.SERIAL_NUMBER)
    yield _text("DeviceUserID", bootstrap.USER_DEFINED_NAME)
    yield _float("DeviceTemperature", TEMPERATURE, (-40.0, 120.0), "C", "RO")


def _picture_nodes() -> Iterable[str]:
    yield _integer("Width", WIDTH, "RO")
    yield _integer("Height", HEIGHT, "RO")
    formats = {"Mono8": PixelFormat.MONO8.value, "Mono12": PixelFormat.MONO12.value}
    yield _enumeration("PixelFormat", PIXEL_FORMAT, formats, locked=True)
    yield _float("Gain", GAIN, GAIN_BOUNDS_DB, "dB")
    yield _float("ExposureTime", EXPOSURE_TIME, EXPOSURE_BOUNDS_US, "us")


def _trigger_nodes() -> Iterable[str]:
    yield _enumeration("AcquisitionMode", ACQUISITION_MODE, {"Continuous": CONTINUOUS, "SingleFrame": SINGLE_FRAME})
    yield _command("AcquisitionStart", ACQUISITION_START)
    yield _command("AcquisitionStop", ACQUISITION_STOP)
    yield _float("AcquisitionFrameRate", FRAME_RATE, FRAME_RATE_BOUNDS_HZ, "Hz")
    yield _enumeration("TriggerSelector", TRIGGER_SELECTOR, {"FrameStart": 0})
    yield _enumeration("TriggerMode", TRIGGER_MODE, {"Off": 0, "On": 1})
    yield _enumeration("TriggerSource", TRIGGER_SOURCE, {"Software": 0})
    yield _command("TriggerSoftware", TRIGGER_SOFTWARE)
    yield _integer("MissedTriggers", MISSED_TRIGGERS, "RO")


def _line_nodes() -> Iterable[str]:
    numbers = range(LINES)
    yield _enumeration("LineSelector", LINE_SELECTOR, {f"Line{k + 1}": k for k in numbers})
    yield _enumeration("LineMode", LINE_MODE, {"Output": 1})
    sources = {"Off": 0} | {f"UserOutput{k + 1}": k + 1 for k in numbers}
    yield _enumeration("LineSource", LINE_SOURCE, sources, index="LineSelectorReg")
    yield _enumeration("UserOutputSelector", USER_OUTPUT_SELECTOR, {f"UserOutput{k + 1}": k for k in numbers})
    yield (
        '<Boolean Name="UserOutputValue"><pValue>UserOutputValueReg</pValue>'
        "<OnValue>1</OnValue><OffValue>0</OffValue></Boolean>\n"
        + _register("UserOutputValue", USER_OUTPUT_VALUE, index="UserOutputSelectorReg")
    )
    yield _integer("UserOutputValueAll", USER_OUTPUT_VALUE_ALL)


def _transport_nodes() -> Iterable[str]:
    yield _integer("PayloadSize", PAYLOAD_SIZE, "RO")
    yield '<Integer Name="TLParamsLocked"><Value>0</Value><Min>0</Min><Max>1</Max></Integer>'
    yield (
        '<Integer Name="GevSCPSPacketSize"><pValue>GevSCPSPacketSizeReg</pValue><Min>576</Min><Max>16260</Max>'
        '<Inc>4</Inc></Integer>\n<MaskedIntReg Name="GevSCPSPacketSizeReg">'
        f"<Address>{bootstrap.STREAM_PACKET_SIZE:#x}</Address><Length>4</Length><AccessMode>RW</AccessMode>"
        "<pPort>Device</pPort><LSB>31</LSB><MSB>16</MSB><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess>"
        "</MaskedIntReg>"
    )
    yield _integer("GevSCPHostPort", bootstrap.STREAM_PORT)
    yield _integer("GevSCDA", bootstrap.STREAM_ADDRESS)
    yield _integer("GevHeartbeatTimeout", bootstrap.HEARTBEAT_TIMEOUT)
    access = {"OpenAccess": 0, "ExclusiveAccess": 1, "ControlAccess": 2}
    yield _enumeration("GevCCP", bootstrap.CONTROL_PRIVILEGE, access)


def _category(name: str, features: Iterable[str]) -> str:
    inside = "".join(f"<pFeature>{feature}</pFeature>" for feature in features)
    return f'<Category Name="{name}">{inside}</Category>'


def _text(name: str, address: int) -> str:
    return (
        f'<StringReg Name="{name}"><Address>{address:#x}</Address><Length>{bootstrap.TEXTS[address]}</Length>'
        "<AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>"
    )


def _integer(name: str, address: int, access: str = "RW") -> str:
    return f'<Integer Name="{name}"><pValue>{name}Reg</pValue></Integer>\n{_register(name, address, access)}'


def _float(name: str, address: int, bounds: Sequence[float], unit: str, access: str = "RW") -> str:
    return (
        f'<Float Name="{name}"><pValue>{name}Reg</pValue><Min>{bounds[0]}</Min><Max>{bounds[1]}</Max>'
        f'<Unit>{unit}</Unit></Float>\n<FloatReg Name="{name}Reg"><Address>{address:#x}</Address><Length>8</Length>'
        f"<AccessMode>{access}</AccessMode><pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>"
    )


def _command(name: str, address: int) -> str:
    return (
        f'<Command Name="{name}"><pValue>{name}Reg</pValue><CommandValue>1</CommandValue></Command>\n'
        f"{_register(name, address, 'WO')}"
    )


def _enumeration(name: str, address: int, values: dict[str, int], index: str = "", *, locked: bool = False) -> str:
    entries = "".join(
        f'<EnumEntry Name="{entry}"><Value>{value}</Value></EnumEntry>' for entry, value in values.items()
    )
    lock = "<pIsLocked>TLParamsLocked</pIsLocked>" if locked else ""
    register = _register(name, address, index=index)
    return f'<Enumeration Name="{name}">{lock}{entries}<pValue>{name}Reg</pValue></Enumeration>\n{register}'


def _register(name: str, address: int, access: str = "RW", index: str = "") -> str:
    indexed = f'<pIndex Offset="4">{index}</pIndex>' if index else ""
    return (
        f'<IntReg Name="{name}Reg"><Address>{address:#x}</Address>{indexed}<Length>4</Length>'
        f"<AccessMode>{access}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>"
        "<Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
    )


HEARTBEAT_MS = 3000

TICKS_PER_S = 1_000_000_000

BOUNDED = {
    EXPOSURE_TIME: EXPOSURE_BOUNDS_US,
    GAIN: GAIN_BOUNDS_DB,
    FRAME_RATE: FRAME_RATE_BOUNDS_HZ,
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
        self._memory = bytearray(XML_ADDRESS) + description()
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
        if address + len(data) > XML_ADDRESS:
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
        is_deep = self[PIXEL_FORMAT] == PixelFormat.MONO12
        return PixelFormat.MONO12 if is_deep else PixelFormat.MONO8

    def renew(self) -> None:
        """Recompute what depends on other registers, and bring numbers back into their bounds."""
        for address, bounds in BOUNDED.items():
            self.set_number(address, self.number(address, bounds))
        self[PIXEL_FORMAT] = self.pixel_format
        pixels = self[WIDTH] * self[HEIGHT]
        self[PAYLOAD_SIZE] = pixels * self.pixel_format.bytes_per_pixel

    def _write_identity(self, identity: Identity) -> None:
        self[bootstrap.VERSION] = 0x00010002
        self[bootstrap.DEVICE_MODE] = bootstrap.BIG_ENDIAN_UTF8
        ip = int(ipaddress.IPv4Address(identity.address))
        self[bootstrap.MAC_HIGH], self[bootstrap.MAC_LOW] = 0x0200, ip
        self[bootstrap.SUPPORTED_IP_CONFIGURATION] = self[bootstrap.CURRENT_IP_CONFIGURATION] = 0x4
        self[bootstrap.CURRENT_IP_ADDRESS], self[bootstrap.CURRENT_SUBNET_MASK] = ip, 0xFF000000
        self[bootstrap.NETWORK_INTERFACES] = self[bootstrap.STREAM_CHANNELS] = 1
        there = bootstrap.HAS_SERIAL_NUMBER | bootstrap.HAS_USER_NAME
        self[bootstrap.CAPABILITY] = there | bootstrap.WRITE_MEMORY | bootstrap.PACKET_RESEND
        self[bootstrap.TICK_FREQUENCY_LOW] = TICKS_PER_S
        xml_size = len(description())
        for address, text in (
            (bootstrap.MANUFACTURER_NAME, "ringpose"),
            (bootstrap.MODEL_NAME, "Stand-in"),
            (bootstrap.DEVICE_VERSION, "1"),
            (bootstrap.MANUFACTURER_INFO, "simulated"),
            (bootstrap.SERIAL_NUMBER, identity.serial),
            (bootstrap.XML_URL, f"Local:ringpose.xml;{XML_ADDRESS:x};{xml_size:x}"),
        ):
            self.write(address, text.encode()[: bootstrap.TEXTS[address] - 1])

    def _write_defaults(self, identity: Identity) -> None:
        self[bootstrap.HEARTBEAT_TIMEOUT] = HEARTBEAT_MS
        self[bootstrap.STREAM_PACKET_SIZE] = 1400
        self[WIDTH], self[HEIGHT] = identity.width, identity.height
        self[PIXEL_FORMAT] = PixelFormat.MONO8 if identity.bits == 8 else PixelFormat.MONO12
        self[LINE_MODE] = 1
        self.set_number(EXPOSURE_TIME, 1e6 * identity.exposure_s)
        self.set_number(FRAME_RATE, 10.0)
        self.set_number(TEMPERATURE, 41.5)
        self.renew()
