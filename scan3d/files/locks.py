"""Locks of the operating system on open files, which end with the process that holds them."""

from __future__ import annotations

import errno
import sys

# The errors by which an operating system says that another process holds the lock.
_HELD = {errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK}

if sys.platform == "win32":
    import msvcrt

    # The locked byte lies behind the text of the file, which others may read.
    _BYTE = 1 << 20

    def lock(handle: int) -> bool:
        """Lock an open file; False if another process holds the lock.  File systems without locks count as unlocked."""
        import os

        os.lseek(handle, _BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            return error.errno not in _HELD
        finally:
            os.lseek(handle, 0, os.SEEK_SET)
        return True

else:
    import fcntl

    def lock(handle: int) -> bool:
        """Lock an open file; False if another process holds the lock.  File systems without locks count as unlocked."""
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            return error.errno not in _HELD
        return True
