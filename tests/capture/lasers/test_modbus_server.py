"""The Modbus codec against an independent server: pymodbus at the other end of a serial line."""

import os
import select
import subprocess
import sys
import threading
import tty

import pytest

from ringpose.capture.lasers.driver import LaserContext
from ringpose.capture.uri import LASERS, device_uri, driver
from ringpose.errors import DeviceError

SERVER = """
import asyncio, sys
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import DataType, SimData, SimDevice

def noted(sending, pdu):
    if not sending:
        bits = [int(bit) for bit in pdu.bits]
        print(pdu.function_code, pdu.address, getattr(pdu, "count", 0), bits, flush=True)
    return pdu

async def serve():
    coils = [SimData(0, count=16, values=False, datatype=DataType.BITS)]
    none = [SimData(0, count=1, values=0, datatype=DataType.REGISTERS)]
    device = SimDevice(1, (coils, coils, none, none))
    server = ModbusSerialServer(device, port=sys.argv[1], baudrate=9600, trace_pdu=noted)
    await server.serve_forever(background=True)
    print("serving", flush=True)
    await asyncio.sleep(600)

asyncio.run(serve())
"""


@pytest.fixture
def line():
    """Two pseudo-terminals that are the ends of one serial line."""
    (left, left_end), (right, right_end) = os.openpty(), os.openpty()
    stopped, stop = os.pipe()

    def carry():
        while True:
            ready, _, _ = select.select([left, right, stopped], [], [])
            if stopped in ready:
                return
            for number, other in ((left, right), (right, left)):
                if number in ready:
                    os.write(other, os.read(number, 4096))

    for end in (left_end, right_end):
        tty.setraw(end)
    carrier = threading.Thread(target=carry)
    carrier.start()
    yield os.ttyname(left_end), os.ttyname(right_end)
    os.write(stop, b"x")
    carrier.join()
    for number in (left, left_end, right, right_end, stopped, stop):
        os.close(number)


@pytest.fixture
def server(line):
    pytest.importorskip("pymodbus")
    words = [sys.executable, "-c", SERVER, line[1]]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "serving\n"
        yield process
        process.kill()


def modbus_at(port, words=""):
    parts = device_uri(f"modbus:{port}?ch=0,1,2{words}", "--lasers", LASERS)
    return driver(LASERS, "modbus")(parts, LaserContext())


def test_a_standard_server_switches_every_mask(line, server):
    lasers = modbus_at(line[0])
    with lasers:
        reported = []
        for mask in (0b001, 0b010, 0b100, 0b111, 0b101, 0):
            lasers.set_mask(mask)
            reported.append(lasers.read_mask())
    server.kill()
    noted = server.stdout.read().splitlines()

    assert reported == [0b001, 0b010, 0b100, 0b111, 0b101, 0]
    assert noted[:2] == ["15 0 3 [0, 0, 0]", "1 0 3 []"]
    assert noted[2:6] == ["5 0 0 [1]", "1 0 3 []", "5 0 0 [0]", "5 1 0 [1]"]


def test_a_standard_server_rejects_the_timed_pulse_and_that_is_reported(line, server):
    lasers = modbus_at(line[0], "&pulse=0.7")
    with lasers, pytest.raises(DeviceError, match="refused 01 05 02 00 00 07 8d b0: illegal"):
        lasers.set_mask(0b001)


def test_a_missing_unit_is_an_error(line, server):
    with pytest.raises(DeviceError, match="refused 09 0f 00 00 00 03 01 00 8e f1"), modbus_at(line[0], "&unit=9"):
        pass
