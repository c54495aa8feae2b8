"""The Modbus codec against an independent server: pymodbus at the other end of a serial line."""

import os
import select
import subprocess
import sys
import threading
import tty
from contextlib import ExitStack

import pytest
from guarded_lasers import lasers_at
from needed import needed_module

from ringpose.capture.lasers import relay_board
from ringpose.capture.lasers.relay_board import RelayBoard
from ringpose.capture.lasers.serial_port import SerialPort
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
    needed_module("pymodbus", "ringpose[dev]")
    words = [sys.executable, "-c", SERVER, line[1]]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "serving\n"
        yield process
        process.kill()


@pytest.fixture
def board_at(line, server, monkeypatch):
    """Opens the board of a URI with these parameters; it may answer as late as the machine is busy."""
    monkeypatch.setattr(relay_board, "ANSWER_LIMIT_S", 120.0)
    with ExitStack() as stack:

        def opened(words=""):
            settings = lasers_at(f"modbus:{line[0]}?ch=0,1,2{words}").settings
            port = SerialPort(settings.port, settings.baud)
            port.open()
            stack.callback(port.close)
            return RelayBoard(settings, port)

        yield opened


def test_a_standard_server_switches_every_mask(board_at, server):
    board, reported = board_at(), []
    board.all_off()
    for mask in (0b001, 0b010, 0b100, 0b111, 0b101, 0):
        board.set_mask(mask)
        reported.append(board.read_mask())
    server.kill()
    noted = server.stdout.read().splitlines()

    assert reported == [0b001, 0b010, 0b100, 0b111, 0b101, 0]
    assert noted[:2] == ["15 0 3 [0, 0, 0]", "1 0 3 []"]
    assert noted[2:6] == ["5 0 0 [1]", "1 0 3 []", "5 0 0 [0]", "5 1 0 [1]"]


def test_a_standard_server_rejects_the_timed_pulse_and_that_is_reported(board_at):
    board = board_at("&pulse=0.7")
    with pytest.raises(DeviceError, match="refused 01 05 02 00 00 07 8d b0: illegal"):
        board.set_mask(0b001)


def test_a_missing_unit_is_an_error(board_at):
    board = board_at("&unit=9")
    with pytest.raises(DeviceError, match="refused 09 0f 00 00 00 03 01 00 8e f1"):
        board.all_off()
