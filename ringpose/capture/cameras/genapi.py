"""Common part of the drivers that access a camera through GenApi nodes."""

from abc import abstractmethod
from typing import Any

from ringpose.capture.cameras.triggered import SoftwareTriggeredCamera
from ringpose.errors import DeviceError

TRIGGERED = (
    ("AcquisitionMode", "Continuous"),
    ("TriggerSelector", "FrameStart"),
    ("TriggerMode", "On"),
    ("TriggerSource", "Software"),
)
"""Feature values for single frames by software trigger, in the order of setting."""

ALIASES = {"ExposureTime": ("ExposureTimeAbs",), "Gain": ("GainAbs", "GainRaw")}
"""Names of features in older cameras."""


class GenApiCamera(SoftwareTriggeredCamera):
    """A camera whose features are nodes with a value and, if numeric, limits.

    A driver implements the abstract methods.
    """

    def bounds(self, feature: str) -> tuple[float, float] | None:
        """See `CameraDriver`."""
        node = self._node_of(feature)
        minimum, maximum = self._limits(node)
        return None if minimum is None or maximum is None else (float(minimum), float(maximum))

    def set(self, feature: str, value: int | float | str) -> None:
        """See `CameraDriver`."""
        node = self._node_of(feature)
        if node is None:
            raise DeviceError(self.uri.text, f"has no feature {feature}")
        limits = None if isinstance(value, str) else self.bounds(feature)
        if limits is not None and not limits[0] <= float(value) <= limits[1]:
            finding = f"{feature} cannot be {value:g}"
            raise DeviceError(self.uri.text, finding, f"it takes {limits[0]:g} to {limits[1]:g}")
        try:
            self._set_value(node, value)
        except DeviceError:
            raise
        except Exception as error:  # each wrapper of GenApi has its own error classes
            raise DeviceError(self.uri.text, f"{feature} cannot be set to {value}: {first_line(error)}") from error
        if feature == "Gain":
            self._gain_db = self._number("Gain")

    def _set_up(self) -> None:
        """Set single frames by software trigger, as far as the camera has these features."""
        for feature, value in TRIGGERED:
            if self._node_of(feature) is not None:
                self.set(feature, value)

    def _number(self, feature: str) -> float | None:
        node = self._node_of(feature)
        return None if node is None else float(self._value(node))

    def _format(self) -> str:
        return self._text("PixelFormat")

    def _identity(self) -> tuple[str, int, int]:
        words = [self._text(name) for name in ("DeviceVendorName", "DeviceModelName", "DeviceSerialNumber", "DeviceID")]
        width, height = (int(self._number(name) or 0) for name in ("Width", "Height"))
        return "-".join(word for word in words[:3] if word), width, height

    def _text(self, feature: str) -> str:
        node = self._node_of(feature)
        return "" if node is None else str(self._value(node))

    def _node_of(self, feature: str) -> Any:
        """The node of a feature under any of its names; None if the camera does not have it."""
        for name in (feature, *ALIASES.get(feature, ())):
            node = self._node(name)
            if node is not None:
                return node
        return None

    def _limits(self, node: Any) -> tuple[Any, Any]:
        """Minimum and maximum; None if the feature is not numeric."""
        return getattr(node, "min", None), getattr(node, "max", None)

    def _value(self, node: Any) -> Any:
        return node.value

    def _set_value(self, node: Any, value: int | float | str) -> None:
        node.value = value

    @abstractmethod
    def _node(self, name: str) -> Any:
        """The node of this name if it is available now; None otherwise."""


def first_line(error: Exception, otherwise: str = "") -> str:
    """The first line of an error's message; `otherwise`, or the error's class, if it is empty."""
    return (str(error).strip() or otherwise or type(error).__name__).splitlines()[0]
