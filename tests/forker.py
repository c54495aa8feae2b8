"""A process that forks the real command for each job, so that its modules are imported once for all tests.

A job has four descriptors: one on which the process's number and finally its status (as in `subprocess`) are
reported, and its standard input, output and error.
"""

import json
import os
import signal
import socket
import sys

import scipy.interpolate
import scipy.optimize

import ringpose.capture.lasers.watchdog
import ringpose.capture.live
import ringpose.cli.acquisition
import ringpose.cli.capture
import ringpose.cli.live_input
import ringpose.cli.pose
import ringpose.cli.simulate.serve
import ringpose.files.images.sessions
import ringpose.files.scenes.scene
import ringpose.simulate.pipeline
import ringpose.simulate.serve.virtual_device
from ringpose.cli.main import run

LOADED = (scipy, ringpose)


def carry_out(job, streams):
    """Become the command."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    os.closerange(3, 256)
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
    os.chdir(job["folder"])
    os.environ.clear()
    os.environ.update(job["environment"])
    sys.argv[1:] = job["words"]
    sys.dont_write_bytecode = True  # it would be cut off where a test limits the size of files
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"  # the same for its own processes
    exec(job["before"], {"__name__": "before"})
    run()


def look_after(job, reply, *streams):
    """Start the command and report its exit status; the intermediate process waits only for this command."""
    pid = os.fork()
    if not pid:
        carry_out(job, streams)
    for stream in streams:
        os.close(stream)
    os.write(reply, str(pid).encode())
    _, status = os.waitpid(pid, 0)
    os.write(reply, str(os.waitstatus_to_exitcode(status)).encode())


jobs = socket.socket(fileno=int(sys.argv[1]))
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
while True:
    line, descriptors, _, _ = socket.recv_fds(jobs, 1 << 20, 4)
    if not line:
        break
    if not os.fork():
        jobs.close()
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        look_after(json.loads(line), *descriptors)
        os._exit(0)
    for number in descriptors:
        os.close(number)
jobs.close()
