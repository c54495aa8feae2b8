"""A camera without hardware, of which tests override what they need, and the driver of a camera's URI."""

from typing import Any

from ringpose.capture.cameras.driver import CameraDescription, CameraDriver
from ringpose.capture.uri import CAMERAS, device_uri, driver
from ringpose.errors import DeviceError


class FakeCamera(CameraDriver):
    """Takes any exposure and has no other settings."""

    image_width, image_height, saturation_dn = 3, 2, 255

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def describe(self) -> CameraDescription:
        return CameraDescription(
            name="fake",
            image_width=self.image_width,
            image_height=self.image_height,
            saturation_dn=self.saturation_dn,
        )

    def bounds(self, feature: str) -> tuple[float, float] | None:
        return None

    def set(self, feature: str, value: float | str) -> None:
        raise DeviceError("camera", "has no settings")

    def arm(self, exposure_s: float | None) -> None:
        pass


def camera_of(uri: str, **parameters: str) -> Any:
    """The driver of a camera, created from its URI as the command does; parameters are added to the URI."""
    query = "&".join(f"{key}={value}" for key, value in parameters.items())
    parts = device_uri(f"{uri}?{query}" if query else uri, "--camera", CAMERAS)
    return driver(CAMERAS, parts.scheme)(parts)
