"""Description of a capture: devices, sequence and shots."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

CaptureState = Literal["capturing", "finished", "stopped"]
"""`capturing` in a folder that is no longer being written: the capture was aborted, and may have more shots than
listed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """One run of `ringpose capture`; URIs are as given by the user."""

    camera: str
    lasers: str
    sequence: str | None = None
    """None for recorded shots that were imported unchanged."""
    exposure_s: float | None = None
    """None for the device's own setting."""
    rate_hz: float | None = None
    """None for the highest possible rate."""
    camera_name: str | None = None
    laser_count: int | None = None
    """None if only the recording contains it."""
    laser_names: tuple[str, ...] | None = None
    """From the rig, in the order of the mask's bits; None without a rig."""
    state: CaptureState = "capturing"
    shots: tuple[str, ...] = ()
    """Names of the finished shots in chronological order."""
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """The captures in one folder, the oldest first."""

    captures: tuple[Capture, ...]

    @property
    def shots(self) -> tuple[str, ...]:
        """Names of all shots in chronological order."""
        return tuple(shot for capture in self.captures for shot in capture.shots)
