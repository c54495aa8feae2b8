"""A serial adapter that echoes what is sent, as of RS-485 with two wires, with or without a board behind it."""

import os
import select
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def echoing_adapter(link: Path, board: str = "") -> Iterator[None]:
    """Serve the adapter at a link to a pseudo-terminal; `board` is the port of the board behind it, if there is one."""
    master, slave = os.openpty()
    tty.setraw(slave)
    line = os.open(board, os.O_RDWR | os.O_NOCTTY) if board else -1
    stopped, stop = os.pipe()

    def carry() -> None:
        while True:
            ready, _, _ = select.select([master, stopped, *([line] if board else [])], [], [])
            if stopped in ready:
                return
            if master in ready:
                sent = os.read(master, 4096)
                os.write(master, sent)
                if board:
                    os.write(line, sent)
            if line in ready:
                os.write(master, os.read(line, 4096))

    carrier = threading.Thread(target=carry)
    carrier.start()
    link.symlink_to(os.ttyname(slave))
    try:
        yield
    finally:
        link.unlink()
        os.write(stop, b"x")
        carrier.join()
        for number in (master, slave, stopped, stop, *([line] if board else [])):
            os.close(number)
