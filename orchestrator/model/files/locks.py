"""Locks of files, which processes of one computer hold by turns. One lasts until its descriptor is closed, or its
process has ended.

Linux and macOS lock the file as a whole (`flock(2)`), which hinders nothing else. Windows locks bytes, which no other
process can read or write meanwhile: there it is one byte, behind all contents."""

import errno
import os
import sys
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    _LOCKED_BYTE = 2**31 - 2  # the last but one that `_locking` reaches

    def _lock_byte(descriptor: int, mode: int) -> None:
        position = os.lseek(descriptor, 0, os.SEEK_CUR)
        os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, mode, 1)
        finally:
            os.lseek(descriptor, position, os.SEEK_SET)

    def lock_file(descriptor: int) -> None:
        """Lock an open file, once no other process has it locked. Raises `OSError`."""
        while True:
            try:
                return _lock_byte(descriptor, msvcrt.LK_LOCK)
            except OSError as error:
                if error.errno != errno.EDEADLK:  # after ten tries, in as many seconds
                    raise

    def lock_file_now(descriptor: int) -> None:
        """Lock an open file. Raises `BlockingIOError` if another process has it locked, other `OSError`."""
        try:
            _lock_byte(descriptor, msvcrt.LK_NBLCK)
        except PermissionError as error:
            raise BlockingIOError(errno.EAGAIN, str(error)) from None

    _ask_for_lock = lock_file_now
    """Whether it is locked: there is no lock for several. A process that asks has it for a moment."""
else:
    import fcntl

    def lock_file(descriptor: int) -> None:
        """Lock an open file, once no other process has it locked. Raises `OSError`."""
        fcntl.flock(descriptor, fcntl.LOCK_EX)

    def lock_file_now(descriptor: int) -> None:
        """Lock an open file. Raises `BlockingIOError` if another process has it locked, other `OSError`."""
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _ask_for_lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)


def is_file_locked(path: Path) -> bool:
    """Whether a process has a file locked. One that cannot be opened is not."""
    try:
        with path.open("rb") as file:
            _ask_for_lock(file.fileno())
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False
