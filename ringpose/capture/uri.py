"""Devices by name: `files:shots`, `sim:scene.yaml`, `none:`."""

import difflib
from collections.abc import Sequence

from ringpose.errors import UsageError

CAMERAS = ("files", "sim")

LASERS = ("none", "sim")


def scheme_and_rest(uri: str, option: str, schemes: Sequence[str]) -> tuple[str, str]:
    """What stands before and after the first colon; the scheme must be one of those known."""
    scheme, colon, rest = uri.partition(":")
    if not colon or scheme not in schemes:
        near = difflib.get_close_matches(scheme, schemes, n=1)
        known = ", ".join(f"{known}:" for known in schemes)
        remedy = f"did you mean {near[0]}:{rest}?" if near else f"it begins with one of {known}"
        raise UsageError(option, f'"{uri}" names no device', remedy)
    return scheme, rest
