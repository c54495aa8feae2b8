"""What a report needs beyond the usual dependencies."""

from importlib.util import find_spec

from ringpose.errors import UsageError


def require_matplotlib() -> None:
    """Refuse a report before any work is done for it, if nothing can draw it."""
    if find_spec("matplotlib") is None:
        raise UsageError("--report", "matplotlib is not installed", "pip install 'ringpose[report]'")
