"""The register space of the virtual camera, and the GenICam XML that describes its features to clients.

Features have the names and values of the Standard Features Naming Convention (SFNC 2).
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
"""First of the registers of the lines, one word each."""
USER_OUTPUT_VALUE = 0xA0C0
"""First of the registers of the user outputs, one word each."""
XML_ADDRESS = 0x10000

CONTINUOUS, SINGLE_FRAME = 0, 1
"""Values of `ACQUISITION_MODE`."""

LINES = 8
"""Number of output lines: one for each laser of a mask."""

EXPOSURE_BOUNDS_US = (10.0, 1_000_000.0)
GAIN_BOUNDS_DB = (0.0, 24.0)
FRAME_RATE_BOUNDS_HZ = (0.1, 200.0)

BOUNDED = {EXPOSURE_TIME: EXPOSURE_BOUNDS_US, GAIN: GAIN_BOUNDS_DB, FRAME_RATE: FRAME_RATE_BOUNDS_HZ}
"""Floating-point registers that a client may write, with their bounds."""

HEARTBEAT_MS = 3000

_CAPABILITIES = bootstrap.HAS_SERIAL_NUMBER | bootstrap.HAS_USER_NAME | bootstrap.WRITE_MEMORY | bootstrap.PACKET_RESEND

TICKS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """The properties that the camera reports."""

    address: str
    """IPv4 address."""
    width: int
    height: int
    bits: int
    """Initial bit depth, 8 or 12."""
    exposure_s: float
    """Initial exposure."""
    serial: str = "RP0001"


class Registers:
    """Big-endian memory of the camera; `renew` updates the registers that depend on others."""

    def __init__(self, identity: Identity) -> None:
        xml = description()
        self._memory = bytearray(XML_ADDRESS) + xml + bytes(-len(xml) % 4)
        ip = int(ipaddress.IPv4Address(identity.address))
        for address, value in (
            (bootstrap.VERSION, 0x00010002),
            (bootstrap.DEVICE_MODE, bootstrap.BIG_ENDIAN_UTF8),
            (bootstrap.MAC_HIGH, 0x0200),
            (bootstrap.MAC_LOW, ip),
            (bootstrap.SUPPORTED_IP_CONFIGURATION, 0x4),
            (bootstrap.CURRENT_IP_CONFIGURATION, 0x4),
            (bootstrap.CURRENT_IP_ADDRESS, ip),
            (bootstrap.CURRENT_SUBNET_MASK, 0xFF000000),
            (bootstrap.NETWORK_INTERFACES, 1),
            (bootstrap.STREAM_CHANNELS, 1),
            (bootstrap.CAPABILITY, _CAPABILITIES),
            (bootstrap.TICK_FREQUENCY_LOW, TICKS_PER_S),
            (bootstrap.HEARTBEAT_TIMEOUT, HEARTBEAT_MS),
            (bootstrap.STREAM_PACKET_SIZE, 1400),
            (WIDTH, identity.width),
            (HEIGHT, identity.height),
            (PIXEL_FORMAT, PixelFormat.MONO8 if identity.bits == 8 else PixelFormat.MONO12),
            (LINE_MODE, 1),
        ):
            self[address] = value
        for address, text in (
            (bootstrap.MANUFACTURER_NAME, "ringpose"),
            (bootstrap.MODEL_NAME, "Stand-in"),
            (bootstrap.DEVICE_VERSION, "1"),
            (bootstrap.MANUFACTURER_INFO, "simulated"),
            (bootstrap.SERIAL_NUMBER, identity.serial),
            (bootstrap.XML_URL, f"Local:ringpose.xml;{XML_ADDRESS:x};{len(xml):x}"),
        ):
            self.write(address, text.encode()[: bootstrap.TEXTS[address] - 1])
        for address, number in ((EXPOSURE_TIME, 1e6 * identity.exposure_s), (FRAME_RATE, 10.0), (TEMPERATURE, 41.5)):
            self.set_number(address, number)
        self.renew()

    def read(self, address: int, size: int) -> bytes | None:
        """Bytes of the memory; None if the range exceeds it."""
        return bytes(self._memory[address : address + size]) if address + size <= len(self._memory) else None

    def write(self, address: int, data: bytes) -> bool:
        """Write bytes; False, without writing, if the range is not below the XML."""
        if address + len(data) > XML_ADDRESS:
            return False
        self._memory[address : address + len(data)] = data
        return True

    def __getitem__(self, address: int) -> int:
        """A 32-bit register."""
        (value,) = struct.unpack_from(">I", self._memory, address)
        return int(value)

    def __setitem__(self, address: int, value: int) -> None:
        struct.pack_into(">I", self._memory, address, value & 0xFFFFFFFF)

    def number(self, address: int, bounds: tuple[float, float]) -> float:
        """A floating-point register, limited to its bounds; the lower one for NaN."""
        (value,) = struct.unpack_from(">d", self._memory, address)
        return float(min(value, bounds[1])) if value > bounds[0] else bounds[0]

    def set_number(self, address: int, value: float) -> None:
        """Write a floating-point register."""
        struct.pack_into(">d", self._memory, address, value)

    @property
    def pixel_format(self) -> PixelFormat:
        """The pixel format; Mono8 if a client has written an unknown one."""
        return PixelFormat.MONO12 if self[PIXEL_FORMAT] == PixelFormat.MONO12 else PixelFormat.MONO8

    def renew(self) -> None:
        """Replace invalid values that a client has written, and update the payload size."""
        for address, bounds in BOUNDED.items():
            self.set_number(address, self.number(address, bounds))
        self[PIXEL_FORMAT] = self.pixel_format
        self[PAYLOAD_SIZE] = self[WIDTH] * self[HEIGHT] * self.pixel_format.bytes_per_pixel


_HEAD = """\
<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="Stand-in" VendorName="ringpose" StandardNameSpace="GEV" SchemaMajorVersion="1"
 SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
 ToolTip="Simulated camera" ProductGuid="5b1d2c54-52d1-4bb0-9f14-0d7f3a6e0001"
 VersionGuid="5b1d2c54-52d1-4bb0-9f14-0d7f3a6e0002" xmlns="http://www.genicam.org/GenApi/Version_1_1">
"""

_CATEGORIES = {
    "DeviceControl": "DeviceVendorName DeviceModelName DeviceVersion DeviceSerialNumber DeviceUserID DeviceTemperature",
    "ImageFormatControl": "Width Height PixelFormat",
    "AcquisitionControl": "AcquisitionMode AcquisitionStart AcquisitionStop AcquisitionFrameRate TriggerSelector"
    " TriggerMode TriggerSource TriggerSoftware ExposureTime MissedTriggers",
    "AnalogControl": "Gain",
    "DigitalIOControl": "LineSelector LineMode LineSource UserOutputSelector UserOutputValue UserOutputValueAll",
    "TransportLayerControl": "PayloadSize TLParamsLocked GevSCPSPacketSize GevSCPHostPort GevSCDA GevCCP"
    " GevHeartbeatTimeout",
}
"""Names of the features in each category."""


def description() -> bytes:
    """The GenICam XML; each feature is a node that refers to a register."""
    lines = range(LINES)
    nodes = [
        _category("Root", _CATEGORIES),
        *(_category(name, features.split()) for name, features in _CATEGORIES.items()),
        _text("DeviceVendorName", bootstrap.MANUFACTURER_NAME),
        _text("DeviceModelName", bootstrap.MODEL_NAME),
        _text("DeviceVersion", bootstrap.DEVICE_VERSION),
        _text("DeviceSerialNumber", bootstrap.SERIAL_NUMBER),
        _text("DeviceUserID", bootstrap.USER_DEFINED_NAME),
        _float("DeviceTemperature", TEMPERATURE, (-40.0, 120.0), "C", "RO"),
        _integer("Width", WIDTH, "RO"),
        _integer("Height", HEIGHT, "RO"),
        _enumeration(
            "PixelFormat", PIXEL_FORMAT, {"Mono8": PixelFormat.MONO8, "Mono12": PixelFormat.MONO12}, locked=True
        ),
        _float("Gain", GAIN, GAIN_BOUNDS_DB, "dB"),
        _float("ExposureTime", EXPOSURE_TIME, EXPOSURE_BOUNDS_US, "us"),
        _enumeration("AcquisitionMode", ACQUISITION_MODE, {"Continuous": CONTINUOUS, "SingleFrame": SINGLE_FRAME}),
        _command("AcquisitionStart", ACQUISITION_START),
        _command("AcquisitionStop", ACQUISITION_STOP),
        _float("AcquisitionFrameRate", FRAME_RATE, FRAME_RATE_BOUNDS_HZ, "Hz"),
        _enumeration("TriggerSelector", TRIGGER_SELECTOR, {"FrameStart": 0}),
        _enumeration("TriggerMode", TRIGGER_MODE, {"Off": 0, "On": 1}),
        _enumeration("TriggerSource", TRIGGER_SOURCE, {"Software": 0}),
        _command("TriggerSoftware", TRIGGER_SOFTWARE),
        _integer("MissedTriggers", MISSED_TRIGGERS, "RO"),
        _enumeration("LineSelector", LINE_SELECTOR, {f"Line{k + 1}": k for k in lines}),
        _enumeration("LineMode", LINE_MODE, {"Output": 1}),
        _enumeration(
            "LineSource",
            LINE_SOURCE,
            {"Off": 0} | {f"UserOutput{k + 1}": k + 1 for k in lines},
            index="LineSelectorReg",
        ),
        _enumeration("UserOutputSelector", USER_OUTPUT_SELECTOR, {f"UserOutput{k + 1}": k for k in lines}),
        '<Boolean Name="UserOutputValue"><pValue>UserOutputValueReg</pValue>'
        "<OnValue>1</OnValue><OffValue>0</OffValue></Boolean>",
        _register("UserOutputValue", USER_OUTPUT_VALUE, index="UserOutputSelectorReg"),
        _integer("UserOutputValueAll", USER_OUTPUT_VALUE_ALL),
        _integer("PayloadSize", PAYLOAD_SIZE, "RO"),
        '<Integer Name="TLParamsLocked"><Value>0</Value><Min>0</Min><Max>1</Max></Integer>',
        '<Integer Name="GevSCPSPacketSize"><pValue>GevSCPSPacketSizeReg</pValue><Min>576</Min><Max>16260</Max>'
        "<Inc>4</Inc></Integer>",
        '<MaskedIntReg Name="GevSCPSPacketSizeReg">'
        f"<Address>{bootstrap.STREAM_PACKET_SIZE:#x}</Address><Length>4</Length><AccessMode>RW</AccessMode>"
        "<pPort>Device</pPort><LSB>31</LSB><MSB>16</MSB><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess>"
        "</MaskedIntReg>",
        _integer("GevSCPHostPort", bootstrap.STREAM_PORT),
        _integer("GevSCDA", bootstrap.STREAM_ADDRESS),
        _integer("GevHeartbeatTimeout", bootstrap.HEARTBEAT_TIMEOUT),
        _enumeration(
            "GevCCP", bootstrap.CONTROL_PRIVILEGE, {"OpenAccess": 0, "ExclusiveAccess": 1, "ControlAccess": 2}
        ),
    ]
    return (_HEAD + "\n".join(nodes) + '\n<Port Name="Device"/>\n</RegisterDescription>\n').encode()


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
    """An integer register; one of several words if `index` names the register that selects it."""
    indexed = f'<pIndex Offset="4">{index}</pIndex>' if index else ""
    return (
        f'<IntReg Name="{name}Reg"><Address>{address:#x}</Address>{indexed}<Length>4</Length>'
        f"<AccessMode>{access}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>"
        "<Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
    )
