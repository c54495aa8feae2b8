"""Shots are computed by processes, of which some are killed."""

import pytest
from study_work import FATAL, square, square_or_die

from ringpose.bench.study.executors import by_processes, computed, in_this_process, software


def test_processes_compute_every_shot_once():
    done = sorted(computed(by_processes(2), square, range(40)))

    assert done == list(computed(in_this_process, square, range(40)))


@pytest.mark.slow
def test_a_shot_that_kills_its_worker_is_given_up_alone():
    done = dict(computed(by_processes(2), square_or_die, range(12)))

    assert done.pop(FATAL) is None
    assert done == {index: square(index) for index in range(12) if index != FATAL}


def test_the_software_is_named_with_a_hash_of_its_code():
    assert len(software()["code_sha256"]) == 64
    assert software() == software()
