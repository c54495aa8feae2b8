"""What every device has in common."""

from types import TracebackType
from typing import Protocol, runtime_checkable


@runtime_checkable
class Device(Protocol):
    """Something that is taken and let go of; a driver derives from this and gains the `with` block that ends closed."""

    def open(self) -> None:
        """Take the device; a `DeviceError` says what is in the way."""

    def close(self) -> None:
        """Let go of the device; closing twice does nothing."""

    def __enter__(self) -> None:
        try:
            self.open()
        except BaseException:
            self.close()
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
