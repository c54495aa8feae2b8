"""Notices when the guard itself ends or is stopped."""

import os
import threading
from collections.abc import Callable
from contextlib import suppress


class GuardEnd:
    """Waits, in a thread, for the end of a child process, and acts at once; a stopped one is as bad as a dead one."""

    def __init__(self, pid: int, act: Callable[[int], None]) -> None:
        self._pid = pid
        self._act = act
        self.has_come = threading.Event()
        """Set when the child has ended and everything was done about it."""
        self._thread = threading.Thread(target=self._watch, name="guard-end", daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        with suppress(ChildProcessError):  # if it was waited for elsewhere it has ended
            os.waitid(os.P_PID, self._pid, os.WEXITED | os.WSTOPPED | os.WNOWAIT)
        try:
            self._act(self._pid)
        finally:
            self.has_come.set()
