"""What a capture was: which devices, which steps, which shots."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

CaptureState = Literal["capturing", "finished", "stopped"]
"""`capturing` in a folder that nobody writes to any more: it was cut off, and may hold more shots than it lists."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """One run of `ringpose capture`; URIs are as the user wrote them."""

    camera: str
    lasers: str
    sequence: str | None = None
    """None for recorded shots that were taken over as they are."""
    exposure_s: float | None = None
    """None for the device's own setting."""
    rate_hz: float | None = None
    """None for as fast as it goes."""
    camera_name: str | None = None
    laser_count: int | None = None
    """None where only the recording knows."""
    laser_names: tuple[str, ...] | None = None
    """By the rig, in the order of the mask's bits; None where no rig was given."""
    state: CaptureState = "capturing"
    shots: tuple[str, ...] = ()
    """Names of the finished shots in the order in which they were taken."""
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """The captures whose shots lie in one folder, the oldest first."""

    captures: tuple[Capture, ...]

    @property
    def shots(self) -> tuple[str, ...]:
        """Names of all shots in the order in which they were taken."""
        return tuple(shot for capture in self.captures for shot in capture.shots)
