"""Checks of shapes and types in the first calls of every function, restarted in each test.

Checking every call would take 40 % of the tests' time, most of it in loops of similar calls. Functions inside functions
are not checked: they are new objects at each call of the outer one, and making a check takes longer than most calls.
"""

import functools
import inspect
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

from beartype import beartype

CALLS = 5
"""How many of a function's calls are checked in each test."""

_CHECKS_OF_A_CALL = 2
_checks: Counter[tuple[str, str]] = Counter()
_believed: list[Any] = []


def checked(stub: Callable) -> Callable:
    """The type checker that jaxtyping applies to the arguments of a call, then to its result."""
    if "<locals>" in stub.__qualname__:
        return stub
    name = (stub.__module__, stub.__qualname__)
    check: Callable | None = None

    @functools.wraps(stub)
    def first(*args: object, **kwargs: object) -> None:
        nonlocal check
        if check is None:  # generating it takes a third of the time of importing a module; many are never called
            check = beartype(stub)
        check(*args, **kwargs)
        _checks[name] += 1
        if _checks[name] == CALLS * _CHECKS_OF_A_CALL:
            _believe(*name)

    return first


def begin() -> None:
    """Check the first calls of every function again."""
    _checks.clear()
    while _believed:
        vars(_believed.pop()).pop("__no_type_check__", None)


def _believe(module: str, qualified_name: str) -> None:
    found: Any = sys.modules.get(module)
    for part in qualified_name.split("."):
        found = inspect.getattr_static(found, part, None)
    function = inspect.unwrap(getattr(found, "fget", None) or getattr(found, "__func__", None) or found)
    if getattr(function, "__qualname__", None) == qualified_name:
        function.__no_type_check__ = True  # which jaxtyping looks for at each call
        _believed.append(function)
