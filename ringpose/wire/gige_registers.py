"""Bootstrap registers of GigE Vision devices: addresses, and the meaning of their bits.

Addresses as in `arvgvcpprivate.h` of Aravis; numbers are big-endian, texts end with a zero byte.
"""

VERSION = 0x0000
DEVICE_MODE = 0x0004
MAC_HIGH = 0x0008
MAC_LOW = 0x000C
SUPPORTED_IP_CONFIGURATION = 0x0010
CURRENT_IP_CONFIGURATION = 0x0014
CURRENT_IP_ADDRESS = 0x0024
CURRENT_SUBNET_MASK = 0x0034
MANUFACTURER_NAME = 0x0048
MODEL_NAME = 0x0068
DEVICE_VERSION = 0x0088
MANUFACTURER_INFO = 0x00A8
SERIAL_NUMBER = 0x00D8
USER_DEFINED_NAME = 0x00E8
DISCOVERY_SIZE = 0x00F8
"""Size of the answer to a discovery: the first bytes of the register space."""

XML_URL = 0x0200
NETWORK_INTERFACES = 0x0600
STREAM_CHANNELS = 0x0904
CAPABILITY = 0x0934
HEARTBEAT_TIMEOUT = 0x0938
"""Heartbeat timeout in milliseconds."""
TICK_FREQUENCY_LOW = 0x0940
TIMESTAMP_CONTROL = 0x0944
TIMESTAMP_HIGH = 0x0948
TIMESTAMP_LOW = 0x094C
CONTROL_PRIVILEGE = 0x0A00
STREAM_PORT = 0x0D00
STREAM_PACKET_SIZE = 0x0D04
STREAM_ADDRESS = 0x0D18

TEXTS = {
    MANUFACTURER_NAME: 32,
    MODEL_NAME: 32,
    DEVICE_VERSION: 32,
    MANUFACTURER_INFO: 48,
    SERIAL_NUMBER: 16,
    USER_DEFINED_NAME: 16,
    XML_URL: 512,
}
"""Text registers, with their size in bytes."""

BIG_ENDIAN_UTF8 = 0x80000001
"""Device mode."""

WRITE_MEMORY, PACKET_RESEND = 1 << 1, 1 << 2
HAS_SERIAL_NUMBER, HAS_USER_NAME = 1 << 30, 1 << 31
"""Capabilities."""

EXCLUSIVE, CONTROL = 1 << 0, 1 << 1
"""Privileges that a client writes into `CONTROL_PRIVILEGE`."""

PACKET_SIZE_MASK = 0xFFFF
FIRE_TEST_PACKET = 1 << 31
"""Bits of `STREAM_PACKET_SIZE`; the second sends one packet of that size, to test whether the network carries it."""
