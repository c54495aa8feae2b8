"""A folder that one process at a time writes into."""

import errno
import fcntl
import os
from pathlib import Path

from ringpose.errors import CannotCreateError

_HELD = {errno.EWOULDBLOCK, errno.EACCES}


class FolderLock:
    """Held from the start until `release`, or until the process ends, however it does."""

    def __init__(self, folder: Path) -> None:
        self._folder = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(self._folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:  # file systems that know no locks do without
            if error.errno in _HELD:
                self.release()
                found = "another capture is writing into it"
                raise CannotCreateError(str(folder), found, "end that first, or choose another output") from error

    def release(self) -> None:
        """Let go of the folder; releasing twice does nothing."""
        if self._folder >= 0:
            os.close(self._folder)
        self._folder = -1
