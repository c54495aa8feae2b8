"""Whether the process that the guard works for is still at work."""

import os

from ringpose.errors import DeviceError

EXITING, DUMPING_CORE, SIGNALED = 0x4, 0x200, 0x400
"""Flags of the kernel (PF_*): a process ends with its first flag; its pipes are closed only when its memory is gone."""

STOPPED = "Tt"
"""States of a process that was stopped, by a signal or a debugger."""


class Owner:
    """The parent of this process."""

    def __init__(self, pid: int) -> None:
        self.end = os.pidfd_open(pid)
        """Becomes readable when the owner has ended."""
        if os.getppid() != pid:
            raise DeviceError("guard", "its owner has ended")
        self._status = os.open(f"/proc/{pid}/stat", os.O_RDONLY)

    def danger(self) -> str:
        """That it is about to end, or was stopped; nothing while it runs."""
        try:
            fields = os.pread(self._status, 1024, 0).rpartition(b")")[2].split()
        except OSError:
            return "the capture has ended"
        if int(fields[6]) & (EXITING | DUMPING_CORE | SIGNALED):
            return "the capture is ending"
        return "the capture was stopped" if fields[0].decode() in STOPPED else ""
