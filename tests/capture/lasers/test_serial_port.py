"""The serial port converts every error of pyserial into a `DeviceError` with a remedy."""

import errno
import os
import termios
import tty

import pytest
import serial

from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError


class FakeSerial(serial.Serial):
    """A fake port whose calls raise an error, or whose inputs are set."""

    cts = dsr = False

    def __init__(self, error=None, cts=False, dsr=False):
        super().__init__()
        self.error, self.cts, self.dsr = error, cts, dsr

    def reset_input_buffer(self):
        if self.error:
            raise self.error


def port_with(fake):
    port = SerialPort("/dev/ttyUSB0", 9600)
    port._serial = fake
    return port


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (termios.error(errno.EIO, "Input/output error"), "cannot be used: input/output error; check cable and power"),
        (OSError(errno.ENODEV, "No such device"), "cannot be used: no such device; check cable and power"),
        (serial.SerialException("device reports readiness to read but returned no data"), "device reports readiness"),
        (serial.SerialTimeoutException("Write timeout"), "failed: Write timeout; check cable and power"),
        (PermissionError(errno.EACCES, "denied"), "permission denied; you may need to be in the group dialout"),
        (BlockingIOError(errno.EAGAIN, "busy"), "another program uses it; end that first"),
    ],
)
def test_every_error_of_pyserial_is_a_device_error(error, words):
    with pytest.raises(DeviceError, match=f"/dev/ttyUSB0: .*{words}"):
        port_with(FakeSerial(error)).exchange(b"x", lambda received: True, 0.1)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("name", ["cts", "dsr"])
def test_inputs_report_whether_the_interlock_is_closed(name, closed):
    assert port_with(FakeSerial(**{name: closed})).is_contact_closed(name) is closed


def test_a_port_without_inputs_is_an_error():
    master, slave = os.openpty()
    port = SerialPort(os.ttyname(slave), 9600)
    port.open()

    with pytest.raises(DeviceError, match="cannot be used"):
        port.is_contact_closed("cts")

    port.close()
    os.close(master)
    os.close(slave)


def test_an_answer_in_pieces_is_joined_and_a_late_one_times_out():
    master, slave = os.openpty()
    tty.setraw(slave)
    port = SerialPort(os.ttyname(slave), 9600)
    port.open()

    def answered(received):
        if received == b"":
            os.write(master, b"a")
        if received == b"a":
            os.write(master, b"b")
        return received == b"ab"

    assert port.exchange(b"?", answered, 1.0) == b"ab"
    assert port.exchange(b"?", lambda received: False, 0.05) == b""
    port.close()
    os.close(master)
    os.close(slave)


def test_a_readable_descriptor_interrupts_the_wait_for_an_answer():
    master, slave = os.openpty()
    ended, ending = os.pipe()
    port = SerialPort(os.ttyname(slave), 9600)
    port.open()
    port.interrupting = (ended,)
    os.close(ending)

    assert port.exchange(b"?", lambda received: False, 60.0) == b""

    port.close()
    for number in (master, slave, ended):
        os.close(number)
