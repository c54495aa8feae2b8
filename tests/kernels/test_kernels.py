"""What the package of kernels promises beyond its results."""

import importlib
import sys
import threading
from graphlib import TopologicalSorter

import numpy as np
import pytest
from benchmarks.structure import c_calls

from ringpose.detect.line_segments import edge_chains, image_gradient
from ringpose.kernels import _kernels
from ringpose.optics.feature_errors import COLUMNS_PER_CUT, MAX_CUT


def test_missing_kernels_are_an_import_error_that_says_what_to_do(monkeypatch):
    monkeypatch.delitem(sys.modules, "ringpose.kernels")
    monkeypatch.setitem(sys.modules, "ringpose.kernels._kernels", None)

    with pytest.raises(ImportError, match=r"not built for this Python; run `pip install \.`"):
        importlib.import_module("ringpose.kernels")


def test_threads_with_their_own_images_do_not_disturb_each_other(rng):
    images = np.kron(rng.integers(0, 256, (4, 20, 30), np.uint8), np.ones((1, 9, 9), np.uint8))
    found = {}

    def find(number):
        found[number] = edge_chains(image_gradient(images[number], 2.5), 1.2, 5).pixels.tobytes()

    alone = [edge_chains(image_gradient(image, 2.5), 1.2, 5).pixels.tobytes() for image in images]
    threads = [threading.Thread(target=find, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert [found[number] for number in range(4)] == alone


def test_the_kernels_leave_out_as_many_centres_of_a_line_as_its_noise_model_states():
    assert (_kernels.MAX_CUT, _kernels.COLUMNS_PER_CUT) == (MAX_CUT, COLUMNS_PER_CUT)


def test_no_c_files_call_each_other_in_a_circle():
    calls = c_calls()

    TopologicalSorter(calls).prepare()  # CycleError names the files of a circle

    called = {path.stem: {each.stem for each in below} for path, below in calls.items()}
    assert called["ends"] >= {"end_edges", "end_sigmas", "end_noise", "profile"}
