"""Shared secrets of servers and their clients."""

import stat
from pathlib import Path

from ringpose.errors import DataError
from ringpose.files.io import read_bytes

MIN_BYTES = 16


def read_secret(path: Path) -> bytes:
    """The contents of a secret's file without white space at its ends; rejected if short or readable by others."""
    secret = read_bytes(path).strip()
    if len(secret) < MIN_BYTES:
        found = f"is a secret of {len(secret)} bytes, must have at least {MIN_BYTES}"
        raise DataError(str(path), found, "make one: head -c 32 /dev/urandom | base64 >FILE")
    if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise DataError(str(path), "is a secret that other users can read", f"chmod 600 {path}")
    return secret
