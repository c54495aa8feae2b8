"""Running devices of the cases, named in braces in their command lines."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from guarded_lasers import BOARDS, LinkedRelays


@pytest.fixture
def lcus_port(tmp_path: Path) -> Iterator[str]:
    """The port of an LCUS board of eight relays."""
    codec, _ = BOARDS["lcus"]
    with LinkedRelays(tmp_path, codec) as board:
        yield board.port
