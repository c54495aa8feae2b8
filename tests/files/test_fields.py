import math

import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files.schema import Fields
from ringpose.types.plausible import PLANE_DISTANCE_M


def fields(**values):
    return Fields("rig.yaml", values)


def message_of(action) -> str:
    with pytest.raises(DataError) as caught:
        action()
    return str(caught.value)


@pytest.mark.parametrize(
    ("values", "is_like"),
    [
        ({"image_width": 1, "camera_matrix": {}}, "a camera"),
        ({"camera": {}, "lasers": []}, "a rig"),
        ({"rig": "rig.yaml", "trajectory": []}, "a scene"),
        ({"kind": "charuco"}, "a board"),
    ],
)
def test_a_file_of_another_kind_is_reported(values, is_like):
    line = message_of(lambda: Fields("mount.yaml", values, ("mount",)))

    assert line == f"mount.yaml: is {is_like}; give another file"


def test_keys_with_the_free_prefix_are_accepted():
    assert Fields("rig.yaml", {"x_colour": 1}, ("name",)).values == {"x_colour": 1}


@pytest.mark.parametrize(
    ("read", "value", "finding"),
    [
        *((lambda a: a.number("a"), value, "") for value in (math.nan, math.inf, True, "1", None, [1.0])),
        *((lambda a: a.integer("a"), value, "") for value in (1.5, True, "3", None)),
        *((lambda a: a.vector("a", 3), value, "") for value in ([1, 2], [1, 2, "3"], [1, 2, True], [[1, 2, 3]], 3.0)),
        *((lambda a: a.vector("a", 3), value, "") for value in ([1, 2, math.nan], [1, 2, None])),
        (lambda a: a.array("a", (None, 2)), [[1, 2], [3]], "must be n x 2 numbers"),
        (lambda a: a.number("a", least=0, most=5), 7, "is 7, must be at least 0 and at most 5"),
        (lambda a: a.integer("a", least=1), -1, "is -1, must be at least 1"),
        *((lambda a: a.quantity("a", PLANE_DISTANCE_M), value, "if it is in centimetres") for value in (-39.5, 5.1)),
        (lambda a: a.choice("a", ("board", "scene")), "boord", "must be one of board, scene; did you mean 'board'?"),
    ],
)
def test_an_invalid_value_is_rejected_with_its_key(read, value, finding):
    line = message_of(lambda: read(fields(a=value)))

    assert line.startswith("rig.yaml: a")
    assert line.endswith(finding)


@pytest.mark.parametrize(
    ("key", "hint"),
    [("imge_width", "; did you mean 'image_width' instead of 'imge_width'?"), ("image_height", "")],
)
def test_a_missing_key_is_reported_with_a_similar_one_that_is_not_known(key, hint):
    values = Fields("x.yaml", {key: 640}, None)
    values.known = ("image_height", "image_width")

    assert message_of(lambda: values.raw("image_width")) == f"x.yaml: has no key 'image_width'{hint}"


def test_arrays_may_be_empty_and_have_missing_values_where_that_is_allowed():
    array = fields(a=[[1, None], [3, 4]]).array("a", (2, 2), allow_nan=True)

    np.testing.assert_array_equal(array, [[1, math.nan], [3, 4]])
    assert fields(a=[]).array("a", (None, 2)).shape == (0, 2)


LENGTHS = {
    "sum of squares": lambda vector: math.sqrt(sum(x * x for x in vector)),
    "exact sum of squares": lambda vector: math.sqrt(math.fsum(x * x for x in vector)),
    "hypot": lambda vector: math.hypot(*vector),
    "NumPy": np.linalg.norm,
    "NumPy, by axis": lambda vector: np.linalg.norm(vector[None], axis=1)[0],
}
"""Ways to compute a length, which round differently."""


@pytest.mark.parametrize("length", LENGTHS.values(), ids=LENGTHS)
@pytest.mark.parametrize(("read", "size"), [(Fields.unit_vector, 3), (Fields.quaternion, 4)])
def test_a_normalised_vector_is_read_to_the_last_bit_however_its_length_was_rounded(rng, length, read, size):
    for vector in rng.normal(size=(300, size)):
        written = vector / length(vector)

        assert read(fields(a=written.tolist()), "a").tolist() == written.tolist()


@pytest.mark.parametrize(("read", "size", "digits"), [(Fields.unit_vector, 3, 7), (Fields.quaternion, 4, 4)])
def test_a_unit_vector_of_few_digits_is_normalised_once(rng, read, size, digits):
    for vector in rng.normal(size=(300, size)):
        once = read(fields(a=np.round(vector / math.hypot(*vector), digits).tolist()), "a")

        assert math.hypot(*once) == pytest.approx(1, abs=1e-15)
        assert read(fields(a=once.tolist()), "a").tolist() == once.tolist()
