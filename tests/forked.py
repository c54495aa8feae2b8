"""Commands that are forked from a process that has already imported their modules."""

import json
import os
import signal
import socket
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import IO


class Forked(AbstractContextManager["Forked"]):
    """The real command, forked from a process with its modules; used like a `subprocess.Popen`.

    It runs in the working folder; `before` is code that is run in it first. Its streams are pipes, or what is given.
    """

    def __init__(
        self,
        forker: socket.socket,
        words: Sequence[str | Path],
        before: str = "",
        stdin: IO[str] | int | None = None,
        stdout: IO[str] | int | None = None,
        stderr: IO[str] | int | None = None,
    ) -> None:
        job = {"before": before, "words": [*map(str, words)], "folder": str(Path.cwd()), "environment": {**os.environ}}
        self._reply, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        (their_in, into), (out, their_out), (said, their_said) = os.pipe(), os.pipe(), os.pipe()
        self.stdin, self.stdout, self.stderr = os.fdopen(into, "w"), os.fdopen(out), os.fdopen(said)
        pipes = (their_in, their_out, their_said)
        given = [pipe if end is None else end for end, pipe in zip((stdin, stdout, stderr), pipes, strict=True)]
        ends = [end if isinstance(end, int) else end.fileno() for end in given]
        socket.send_fds(forker, [json.dumps(job).encode()], [theirs.fileno(), *ends])
        theirs.close()
        for end in pipes:
            os.close(end)
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
        """The remaining output, once there is no more input; a few lines, which fit into the pipe's buffer."""
        with suppress(BrokenPipeError):
            self.stdin.close()
        self.wait(timeout)
        return self.stdout.read(), self.stderr.read()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if kind is not None and self.returncode is None:
            self.kill()
        with suppress(BrokenPipeError):
            self.stdin.close()
        self.wait()
        for each in (self.stdout, self.stderr, self._reply):
            each.close()
