"""What this computer's network has to give for a camera on it."""

import errno
import ipaddress
import socket
from pathlib import Path

from ringpose.errors import DeviceError
from ringpose.wire.gvcp import PORT

SOCKET_BUFFER_BYTES = 8 << 20
"""Wanted for a stream's socket; the kernel grants no more than net.core.rmem_max."""

MORE_BUFFER = f"let the kernel buffer more: sysctl -w net.core.rmem_max={SOCKET_BUFFER_BYTES}"

_RMEM_MAX = Path("/proc/sys/net/core/rmem_max")


def granted_bytes() -> int | None:
    """The largest socket buffer that the kernel grants; None where it does not say."""
    try:
        return int(_RMEM_MAX.read_text())
    except (OSError, ValueError):
        return None


def check_route(place: str, text: str) -> None:
    """An address that cannot be reached is better said at once; what is no address has no route."""
    try:
        address = str(ipaddress.IPv4Address(place))
    except ValueError:
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((address, PORT))
        except OSError as error:
            if error.errno not in (errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EACCES):
                raise
            remedy = "give this computer an address in the camera's network"
            raise DeviceError(text, f"there is no route to {address}", remedy) from error
