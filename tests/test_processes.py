import operator
from functools import partial
from itertools import islice

import pytest

from ringpose.processes import in_order


@pytest.mark.parametrize("jobs", [1, 3])
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
