"""Commands that are forked from a process that has already imported their modules."""

import json
import os
import signal
import socket
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path


class Forked(AbstractContextManager["Forked"]):
    """The real command, forked from a process with its modules; used like a `subprocess.Popen`.

    It runs in the working folder; `before` is code that is run in it first.
    """

    def __init__(self, forker: socket.socket, words: Sequence[str], before: str = "") -> None:
        job = {"before": before, "words": words, "folder": str(Path.cwd()), "environment": {**os.environ}}
        self._reply, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        (out, their_out), (said, their_said) = os.pipe(), os.pipe()
        self.stdout, self.stderr = os.fdopen(out), os.fdopen(said)
        socket.send_fds(forker, [json.dumps(job).encode()], [theirs.fileno(), their_out, their_said])
        theirs.close()
        os.close(their_out)
        os.close(their_said)
        self.pid = int(self._reply.recv(32))
        self.returncode: int | None = None

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            self.send_signal(signal.SIGKILL)

    def wait(self, timeout: float | None = None) -> int:
        if self.returncode is None:
            self._reply.settimeout(timeout)
            self.returncode = int(self._reply.recv(32))
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """The remaining output; a few lines, which fit into the pipe's buffer."""
        self.wait(timeout)
        return self.stdout.read(), self.stderr.read()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if kind is not None and self.returncode is None:
            self.kill()
        self.wait()
        for each in (self.stdout, self.stderr, self._reply):
            each.close()
