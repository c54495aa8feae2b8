import operator
import signal
import subprocess
import sys
from functools import partial
from itertools import islice

import pytest

from ringpose.processes import LimitedCalls, WorkerKilled, in_order


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_in_order(jobs):
    assert list(in_order(partial(pow, 2), 12, jobs)) == [2**k for k in range(12)]


def test_zero_items_give_no_result():
    assert list(in_order(partial(pow, 2), 0, 4)) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_exception_in_a_worker_is_raised_in_the_parent(jobs):
    with pytest.raises(ZeroDivisionError):
        list(in_order(partial(operator.floordiv, 10), 8, jobs))


def test_unfetched_results_do_not_block_the_end():
    results = in_order(partial(pow, 2), 10**6, 2)

    first = list(islice(results, 3))
    results.close()

    assert first == [1, 2, 4]


LONG = range(10**12)
"""Its sum takes hours, in one call of C code that holds signals back."""


@pytest.mark.slow
def test_a_call_that_exceeds_its_cpu_time_ends_and_the_next_one_works():
    with LimitedCalls(sum) as calls:
        with pytest.raises(WorkerKilled):
            calls(1, LONG)

        assert calls(100, range(4)) == 6


def test_an_exception_of_a_limited_call_is_raised_here():
    with LimitedCalls(operator.floordiv) as calls, pytest.raises(ZeroDivisionError):
        calls(100, 1, 0)


HELD = """
import sys
from ringpose.cli.main import Interrupts, ignore_signals, raise_signals
from ringpose.errors import SignalReceived
from ringpose.processes import LimitedCalls

raise_signals(Interrupts())
try:
    with LimitedCalls(sum) as calls:
        calls(600, range(9))
        print("ready", flush=True)
        calls(600, range(10**12))
except SignalReceived as received:
    ignore_signals()
    sys.exit(received.status)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_is_obeyed_while_c_code_runs(number):
    process = subprocess.Popen([sys.executable, "-c", HELD], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"

    process.send_signal(number)

    _, stderr = process.communicate(timeout=120)  # a guard: without the child the sum takes hours
    assert (process.returncode, stderr) == (128 + number, "")
