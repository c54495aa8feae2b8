"""The interface of camera drivers."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from ringpose.capture.uri import Device
from ringpose.types.image import Frame


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraDescription:
    """Properties of a camera, as recorded in the session file."""

    name: str
    image_width: int
    image_height: int
    saturation_dn: int
    """Grey value of a saturated pixel."""


@runtime_checkable
class CameraDriver(Device, Protocol):
    """A camera with a software trigger."""

    def describe(self) -> CameraDescription:
        """Properties of the camera; the camera must be open."""

    def bounds(self, feature: str) -> tuple[float, float] | None:
        """Minimum and maximum of a feature by its SFNC name (`ExposureTime`, in us); None if it has no limits."""

    def set(self, feature: str, value: int | float | str) -> None:
        """Set a feature by its SFNC name; raises a `DeviceError` with the bounds if the value is outside them."""

    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user about the device, which must be open."""
        return ()

    def arm(self, exposure_s: float | None) -> None:
        """Prepare for the frames of one shot with this exposure; None for the device's own setting."""

    def trigger(self, lasers: int, exposure_s: float | None = None) -> Frame:
        """Expose one frame now and wait for it; by default with the exposure that was given to `arm`.

        `lasers` is the commanded mask, to be stored with the frame.
        """
