"""The lock of a folder of recordings: two recorders would delete each other's files."""

import os
from pathlib import Path

from orchestrator.model.errors import TuttiError
from orchestrator.model.files.locks import is_file_locked, lock_file_now
from orchestrator.model.files.private_files import make_private_folder, open_private_file

LOCK = ".lock"


class FolderInUse(TuttiError):
    """Another recorder uses the folder. The text names it, and the remedy."""


class FolderLock:
    """The lock of a folder, held until `release` or the end of the process."""

    def __init__(self, folder: Path) -> None:
        """Create the folder, and lock it. Raises `FolderInUse`, `UnsafePath`, `OSError`."""
        make_private_folder(folder)
        self._fd = open_private_file(folder / LOCK, os.O_RDWR | os.O_CREAT)
        try:
            lock_file_now(self._fd)
        except BlockingIOError:
            os.close(self._fd)
            remedy = "end that one, or choose another folder: --folder"
            raise FolderInUse(f"{folder}: another recorder uses this folder; {remedy}") from None

    def release(self) -> None:
        os.close(self._fd)


def is_locked(folder: Path) -> bool:
    """Whether a recorder uses the folder now."""
    return is_file_locked(folder / LOCK)
