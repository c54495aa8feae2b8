import operator
import signal
import subprocess
import sys
from functools import partial
from itertools import islice
from threading import Event
from threading import enumerate as threads

import pytest

from ringpose.processes import LimitedCalls, WorkerKilled, in_order, one_ahead


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


WAIT_S = 60.0
"""Longest wait for a thread, which ends a test that would otherwise wait for ever."""


def test_one_item_is_worked_on_while_the_result_before_is_used_and_no_further_one():
    begun, second = [], Event()

    def work(item):
        begun.append(item)
        if item == 1:
            second.set()
        return 2 * item

    results = one_ahead(work, range(6))
    first = next(results)
    is_ahead = second.wait(WAIT_S)
    begun_by_then = list(begun)

    assert is_ahead
    assert (first, begun_by_then) == (0, [0, 1])
    assert list(results) == [2, 4, 6, 8, 10]


def test_no_result_waits_for_a_later_item():
    later = Event()

    def items():
        yield 1
        later.wait(WAIT_S)
        yield 2

    results = one_ahead(str, items())
    first = next(results)
    awaited = later.is_set()
    later.set()

    assert (first, awaited, list(results)) == ("1", False, ["2"])


def test_an_exception_of_one_item_is_its_result_and_one_of_their_source_is_raised():
    def items():
        yield from (5, 0, 2)
        raise OSError("the source is gone")

    results = one_ahead(partial(operator.floordiv, 10), items())

    assert next(results) == 2
    assert isinstance(next(results), ZeroDivisionError)
    assert next(results) == 5
    with pytest.raises(OSError, match="source"):
        next(results)


def test_no_item_is_begun_after_the_end_of_the_iteration_and_the_thread_ends():
    begun = []
    results = one_ahead(begun.append, range(10**6))
    next(results)

    results.close()
    for thread in threads():
        if thread.name == "one ahead":
            thread.join(WAIT_S)

    assert len(begun) <= 2
    assert "one ahead" not in [thread.name for thread in threads()]


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
