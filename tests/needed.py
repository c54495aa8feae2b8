"""Programs, modules and data that a test needs: without them it is skipped on a developer's machine and fails in CI."""

import importlib
import os
import shutil
from types import ModuleType
from typing import Any, NoReturn

import pytest


def needed_module(name: str, package: str) -> Any:
    """The module, which `pip install PACKAGE` installs."""
    try:
        module: ModuleType = importlib.import_module(name)
    except ImportError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise  # it is installed, and broken
        missing(f"{name} is not installed (pip install '{package}')")
    return module


def needed_program(name: str, package: str) -> str:
    """Path of the program, which `apt install PACKAGE` installs."""
    path = shutil.which(name)
    if path is None:
        missing(f"{name} is not installed (apt install {package})")
    return path


def missing(what: str, allowed: bool = False) -> NoReturn:
    """Skip on a developer's machine; fail in CI unless allowed."""
    if os.environ.get("CI") and not allowed:
        pytest.fail(what)
    pytest.skip(what, allow_module_level=True)
