"""The GenTL driver with a fake of harvesters, since no free GenTL producer has a software trigger."""

import sys
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from fake_camera import camera_of

from ringpose.errors import DeviceError


@dataclass
class Node:
    """A fake feature node."""

    value: object
    min: float | None = None
    max: float | None = None


@dataclass
class Buffer:
    """A frame of one grey value."""

    number: int
    complete: bool = True
    queued: bool = False

    frame_id = property(lambda self: self.number)
    timestamp_ns = property(lambda self: 1000 * self.number)
    payload = property(
        lambda self: SimpleNamespace(
            components=[SimpleNamespace(data=np.full(6, self.number, np.uint8), width=3, height=2)]
        )
    )

    def is_complete(self) -> bool:
        return self.complete

    def queue(self) -> None:
        self.queued = True


@dataclass
class Nodes:
    """A fake node map."""

    triggered: int = 0
    ExposureTime: Node = field(default_factory=lambda: Node(5000.0, 10.0, 1e6))
    Gain: Node = field(default_factory=lambda: Node(0.0, 0.0, 24.0))
    TriggerMode: Node = field(default_factory=lambda: Node("Off"))
    TriggerSource: Node = field(default_factory=lambda: Node("Line1"))
    PixelFormat: Node = field(default_factory=lambda: Node("Mono8"))
    Width: Node = field(default_factory=lambda: Node(3))
    Height: Node = field(default_factory=lambda: Node(2))
    DeviceModelName: Node = field(default_factory=lambda: Node("Fake"))

    @property
    def TriggerSoftware(self):
        return SimpleNamespace(execute=self.trigger)

    def trigger(self) -> None:
        self.triggered += 1

    def has_node(self, name: str) -> bool:
        return hasattr(self, name)


class Acquirer:
    """A fake camera; frames of these numbers are incomplete, or do not come at all."""

    def __init__(self, broken: tuple[int, ...] = (), missing: tuple[int, ...] = ()) -> None:
        self.remote_device = SimpleNamespace(node_map=Nodes())
        self.broken, self.missing = broken, missing
        self.buffers: list[Buffer] = []
        self.state: list[str] = []

    def start(self) -> None:
        self.state.append("started")

    def stop(self) -> None:
        self.state.append("stopped")

    def destroy(self) -> None:
        self.state.append("destroyed")

    def try_fetch(self, timeout: float) -> Buffer | None:
        number = self.remote_device.node_map.triggered
        if number in self.missing:
            return None
        self.buffers.append(Buffer(number, complete=number not in self.broken))
        return self.buffers[-1]


@pytest.fixture
def harvested(monkeypatch, tmp_path):
    """A driver for which harvesters finds one fake camera."""
    producer = tmp_path / "fake.cti"
    producer.touch()

    def driver(acquirer: Acquirer):
        harvester = SimpleNamespace(
            add_file=lambda path: None, update=lambda: None, create=lambda key: acquirer, reset=lambda: None
        )
        monkeypatch.setitem(sys.modules, "harvesters", SimpleNamespace())
        monkeypatch.setitem(sys.modules, "harvesters.core", SimpleNamespace(Harvester=lambda: harvester))
        return camera_of(f"gentl:{producer}")

    return driver


def test_each_trigger_gives_one_frame_and_returns_the_buffer(harvested):
    acquirer = Acquirer()

    with (camera := harvested(acquirer)):
        camera.arm(0.004)
        frames = [camera.trigger(0) for _ in range(3)]

    nodes = acquirer.remote_device.node_map
    assert (nodes.TriggerMode.value, nodes.TriggerSource.value) == ("On", "Software")
    assert nodes.ExposureTime.value == pytest.approx(4000.0)
    assert [int(frame.image[0, 0]) for frame in frames] == [1, 2, 3]
    assert frames[2].device_stamp_s == pytest.approx(3e-6)
    assert all(buffer.queued for buffer in acquirer.buffers)
    assert acquirer.state == ["started", "destroyed"]


@pytest.mark.parametrize("spoiled", [{"broken": (1, 2)}, {"missing": (1, 2)}])
def test_a_frame_that_is_incomplete_or_missing_is_triggered_again(harvested, spoiled):
    with (camera := harvested(Acquirer(**spoiled))):
        frame = camera.trigger(0)

    assert (frame.attempts, int(frame.image[0, 0])) == (3, 3)


def test_a_value_out_of_bounds_is_rejected(harvested):
    with (camera := harvested(Acquirer())), pytest.raises(DeviceError, match="Gain cannot be 99; it takes 0 to 24"):
        camera.set("Gain", 99.0)


def test_a_missing_producer_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "harvesters", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "harvesters.core", SimpleNamespace(Harvester=lambda: SimpleNamespace(reset=bool)))

    with pytest.raises(DeviceError, match=r'there is no GenTL producer "/no\.cti"'):
        camera_of("gentl:/no.cti").open()


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "harvesters", None)

    with pytest.raises(DeviceError, match=r"needs harvesters.*pip install ringpose\[gentl\]"):
        camera_of("gentl:").open()
