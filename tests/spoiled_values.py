"""Nested values of which one is replaced by another kind of value, and what becomes of them."""

import math
from collections.abc import Callable, Iterator
from typing import Any

from hypothesis import strategies as st

from ringpose.errors import DataError

NUMBERS = [0, -1, 1e308, -1e-308, 10**400, math.nan, math.inf]
ODD = st.sampled_from([None, True, *NUMBERS, "", "a", "1e3", [], [[]], {}, {"a": 1}, [None], [[1], 2]])


def paths(values: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every value in nested values."""
    items = values.items() if isinstance(values, dict) else enumerate(values) if isinstance(values, list) else ()
    for key, item in items:
        yield (*here, key)
        yield from paths(item, (*here, key))


def spoiled(values: Any, path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    copy = values.copy()
    copy[path[0]] = spoiled(values[path[0]], path[1:], value)
    return copy


def spoiled_once(values: Any) -> st.SearchStrategy[Any]:
    return st.builds(lambda path, odd: spoiled(values, path, odd), st.sampled_from(sorted(paths(values), key=str)), ODD)


def outcome(read: Callable[[Any], Any], source: Any, location: str) -> Any:
    """The result of reading, or None after a `DataError` of one line that begins with the location."""
    try:
        return read(source)
    except DataError as error:
        message = str(error)
    assert message.startswith(location)
    assert "\n" not in message
    return None
