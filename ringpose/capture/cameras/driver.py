"""What capture asks of a camera driver."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from ringpose.capture.uri import Device
from ringpose.types.image import Frame


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraDescription:
    """Which camera it is, as it stands in the session file."""

    name: str
    image_width: int
    image_height: int
    saturation_dn: int
    """The grey value at which a pixel is full."""


@runtime_checkable
class CameraDriver(Device, Protocol):
    """A camera that a program triggers."""

    def describe(self) -> CameraDescription:
        """Which camera it is; only while it is open."""

    def bounds(self, feature: str) -> tuple[float, float] | None:
        """Least and greatest value of a feature by its SFNC name (`ExposureTime`, in us); None if it has none."""

    def set(self, feature: str, value: int | float | str) -> None:
        """Set a feature by its SFNC name; a `DeviceError` names the bounds if the value lies outside them."""

    def warnings(self) -> tuple[str, ...]:
        """What the user should know about the device, which is open."""
        return ()

    def arm(self, exposure_s: float | None) -> None:
        """Be ready for the frames of one shot, each exposed this long; None for the device's own setting."""

    def trigger(self, lasers: int, exposure_s: float | None = None) -> Frame:
        """Expose one frame now and wait for it; without an exposure of its own, as long as was said when arming.

        `lasers` is the mask commanded, to be kept with the frame.
        """
