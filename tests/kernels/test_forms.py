"""The closed forms in C refuse what they cannot read."""

import numpy as np
import pytest

from ringpose.kernels import _forms


@pytest.mark.parametrize(
    ("points", "edges"),
    [
        (np.zeros((1, 2, 2)), np.array([0, 1])),
        (np.zeros((1, 3, 3)), np.array([0, 1])),
        (np.zeros((1, 2, 3)), np.array([0, 2])),
        (np.zeros((1, 65, 3)), np.zeros(65, dtype=np.int64)),
        (np.zeros((1, 0, 3)), np.zeros(0, dtype=np.int64)),
    ],
    ids=["axes", "numbers", "edge", "too many", "none"],
)
def test_arrays_that_do_not_fit_are_refused(points, edges):
    with pytest.raises(ValueError, match=r"points|edges"):
        _forms.forms(points, edges, False, 1e-3)
