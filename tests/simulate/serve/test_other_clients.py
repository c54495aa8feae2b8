"""The virtual camera with independent clients: EMVA's GenApi and the command-line tool of Aravis."""

import subprocess

import numpy as np
import pytest
from needed import needed_module, needed_program
from other_client import Port
from served_scene import small_scene

from ringpose.simulate.serve.virtual_device import Setup, virtual_device
from ringpose.types.options import AdvancePolicy


@pytest.fixture
def notes():
    return []


@pytest.fixture
def served(tmp_path, loopback_address, notes):
    with virtual_device(
        small_scene(tmp_path), Setup(address=loopback_address, move=AdvancePolicy.NEVER), notes.append
    ) as device:
        yield device


@pytest.fixture
def nodes(served, loopback_address):
    """GenApi's node map, and the GVCP port through which it reads and writes."""
    genapi = needed_module("genicam.genapi", "genicam")

    class GenApiPort(genapi.AbstractPort):
        def __init__(self, port: Port) -> None:
            super().__init__()
            self.port = port

        def is_open(self):
            return True

        def get_access_mode(self):
            return genapi.EAccessMode.RW

        def read(self, address, length):
            return self.port.read(address, length)

        def write(self, address, data):
            self.port.write(address, data)

    port = Port(loopback_address)
    node_map = genapi.NodeMap()
    node_map.load_xml_from_string(port.description().decode())
    held = GenApiPort(port)
    node_map.connect(held, "Device")
    yield node_map, port
    port.close()


def started(nodes, pixel_format: str = "Mono8"):
    node_map, port = nodes
    address, number = port.stream.getsockname()
    node_map.GevCCP.value = "ControlAccess"
    node_map.GevSCDA.value = int.from_bytes(bytes(map(int, address.split("."))), "big")
    node_map.GevSCPHostPort.value = number
    node_map.GevSCPSPacketSize.value = 1400
    node_map.PixelFormat.value = pixel_format
    node_map.TriggerMode.value = "On"
    node_map.ExposureTime.value = 4000.0
    node_map.AcquisitionStart.execute()
    return node_map, port


def test_genapi_reads_the_features(nodes):
    node_map, _ = nodes

    assert node_map.Width.value == 200
    assert node_map.ExposureTime.max == 1e6
    assert node_map.PixelFormat.symbolics == ("Mono8", "Mono12")
    assert node_map.DeviceVendorName.value == "ringpose"


def test_genapi_switches_lasers_by_output_lines(nodes, notes):
    node_map, port = started(nodes)
    lit = []
    for line in (None, 1, 2, 3):
        for number in (1, 2, 3):
            node_map.LineSelector.value = f"Line{number}"
            node_map.LineSource.value = f"UserOutput{number}"
            node_map.UserOutputSelector.value = f"UserOutput{number}"
            node_map.UserOutputValue.value = number == line
        node_map.TriggerSoftware.execute()
        lit.append(port.frame())

    rises = [(frame.astype(int) - lit[0]).max() for frame in lit[1:]]
    assert [note["laser_shares"] for note in notes] == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert min(rises) > 60


def test_genapi_receives_twelve_bits(nodes):
    node_map, port = started(nodes, "Mono12")

    node_map.TriggerSoftware.execute()
    frame = port.frame()

    assert frame.dtype == np.uint16
    assert node_map.PayloadSize.value == 2 * 200 * 150


def test_the_tool_of_aravis_reads_the_camera(served, loopback_address):
    tool = needed_program("arv-tool-0.8", "aravis-tools-cli")

    done = subprocess.run(
        [tool, "-a", loopback_address, "control", "Width", "PixelFormat", "ExposureTime"],
        capture_output=True,
        text=True,
        timeout=300,
    )

    assert [line.split(" = ")[1].split()[0] for line in done.stdout.splitlines()] == ["200", "Mono8", "5000"]
