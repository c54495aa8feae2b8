"""`sim:`: the camera of a simulated scene, rendered in this process, and its lasers."""

from collections.abc import Callable
from typing import TypeAlias

from ringpose.capture.cameras.driver import CameraDescription, CameraDriver
from ringpose.capture.lasers.driver import LaserContext, LaserDriver
from ringpose.capture.uri import DeviceUri
from ringpose.errors import DeviceError
from ringpose.types.image import Frame

SceneFrame: TypeAlias = Callable[[int, int, float | None], Frame]
"""Renders the frame of a view of the scene (from 0), while the lasers of a mask are on, with an exposure in seconds."""


class SimulatedCamera(CameraDriver):
    """A camera that shows the next view of the scene after each `arm`, with the lasers that are actually on."""

    def __init__(self, description: CameraDescription, scene_frame: SceneFrame, lasers: LaserDriver) -> None:
        self._description = description
        self._scene_frame = scene_frame
        self._lasers = lasers
        self._moment = -1
        self._exposure_s: float | None = None

    def open(self) -> None:
        """Start before the scene's first view."""
        self._moment = -1

    def skip(self) -> None:
        """Skip the scene's next view."""
        self._moment += 1

    def describe(self) -> CameraDescription:
        """The scene's camera."""
        return self._description

    def arm(self, exposure_s: float | None) -> None:
        """Advance to the scene's next view."""
        self._moment += 1
        self._exposure_s = exposure_s

    def bounds(self, feature: str) -> tuple[float, float] | None:
        """None: the simulated camera accepts any value."""
        return None

    def set(self, feature: str, value: int | float | str) -> None:
        """Raises `DeviceError`: the settings of the camera are defined in the scene file."""
        raise DeviceError("sim:", f"{feature} cannot be set to {value}", "change the scene file")

    def trigger(self, lasers: int, exposure_s: float | None = None) -> Frame:
        """A frame of this view; lasers whose driver does not report its state are rendered as commanded."""
        on_mask = self._lasers.read_mask()
        exposed_s = self._exposure_s if exposure_s is None else exposure_s
        frame = self._scene_frame(self._moment, lasers if on_mask is None else on_mask, exposed_s)
        return Frame(image=frame.image, lasers=lasers, stamp_s=frame.stamp_s, exposure_s=frame.exposure_s)

    def close(self) -> None:
        """Nothing to close."""


class SimulatedLasers(LaserDriver):
    """Lasers that exist as a mask only; off before opening and after closing."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._mask = 0

    @property
    def count(self) -> int:
        """Number of lasers of the scene's rig."""
        return self._count

    def open(self) -> None:
        """Start with all off."""
        self._mask = 0

    def set_mask(self, lasers: int) -> None:
        """Switch on exactly these lasers."""
        self._mask = lasers

    def read_mask(self) -> int | None:
        """The mask of the lasers that are on."""
        return self._mask

    def close(self) -> None:
        """End with all off."""
        self._mask = 0


def sim(uri: DeviceUri, context: LaserContext) -> SimulatedLasers:
    """The lasers of the simulated scene."""
    if uri.address or uri.parameters:
        raise uri.problem("has words after its colon", "leave them out")
    if context.names is None or context.camera is not None:
        raise uri.problem("needs a simulated camera")
    return SimulatedLasers(len(context.names))
