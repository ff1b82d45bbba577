"""Files and folders that only the user of a fleet may read, opened without following a link that was put in their
place.

Windows has no mode bits: there a file may be read by those that may read its folder, in a user's profile by that user
and administrators. It does not bring the names in a folder to the disk either."""

import errno
import os
import stat
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple

from orchestrator.model.errors import TuttiError

FOLDER_MODE = 0o700
FILE_MODE = 0o600
HAS_MODES = sys.platform != "win32"
"""Whether the mode of a file says which users may read it."""
_OPEN_FLAGS = os.O_NOFOLLOW | os.O_CLOEXEC if sys.platform != "win32" else os.O_BINARY


class UnsafePath(TuttiError, OSError):
    """A file or folder of a fleet is not what it should be, e.g. a symbolic link. Names it, and the remedy."""

    def __init__(self, path: Path, problem: str, remedy: str) -> None:
        super().__init__(errno.ELOOP, f"{problem}; {remedy}", str(path))

    def __str__(self) -> str:
        return f"{self.filename}: {self.strerror}"


def make_private_folder(folder: Path) -> None:
    """Create `folder` and its missing parents for this user alone; one that exists is left as it is.

    Raises `OSError`.
    """
    missing_folders = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in reversed(missing_folders):
        path.mkdir(mode=FOLDER_MODE, exist_ok=True)


def restrict_to_user(path: Path) -> None:
    """Take from other users what they may do with a file or folder; one of another user, or none, is left as it is.

    Raises `UnsafePath` if it is a symbolic link.
    """
    refuse_link(path)
    if sys.platform == "win32":
        return
    try:
        status = path.lstat()
    except FileNotFoundError:
        return
    if status.st_uid == os.geteuid() and stat.S_IMODE(status.st_mode) & 0o077:
        path.chmod(stat.S_IMODE(status.st_mode) & 0o700)


def refuse_link(path: Path) -> None:
    """Raises `UnsafePath` if there is a symbolic link at `path`."""
    if path.is_symlink():
        target = os.readlink(path)  # noqa: PTH115 - a path would lose what is wrong in it
        raise UnsafePath(path, f"is a symbolic link, to {target!r}", "remove it, or give the place that it points to")


def open_private_file(path: Path, flags: int) -> int:
    """Open a file with the flags of `os.open`, and return its descriptor. What is created is for this user alone.

    Raises `UnsafePath` for a symbolic link, and `OSError`.
    """
    if sys.platform == "win32":
        refuse_link(path)
    try:
        return os.open(path, flags | _OPEN_FLAGS, FILE_MODE)
    except OSError as error:
        if error.errno == errno.ELOOP:
            refuse_link(path)
        raise


def open_for_append(path: Path) -> int:
    """Open a file to append to, and return its descriptor; its folder is created. Raises as `open_private_file`."""
    make_private_folder(path.parent)
    return open_private_file(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)


def read_private_file(path: Path) -> bytes:
    """The contents of a file. Raises as `open_private_file`."""
    with os.fdopen(open_private_file(path, os.O_RDONLY), "rb") as file:
        return file.read()


def replace_private_file(path: Path, contents: bytes) -> None:
    """Replace a file as a whole: after a crash it has the old contents or the new ones, and both are on disk.

    Raises `UnsafePath`, `OSError`.
    """
    make_private_folder(path.parent)
    with write_new_file(path) as file:
        file.write(contents)


@contextmanager
def write_new_file(path: Path) -> Generator[BinaryIO]:
    """A private file to write, which takes the place of `path` as a whole when the context ends without an error.

    Raises `UnsafePath`, `OSError`.
    """
    fresh = path.with_name(f"{path.name}.new")
    fresh.unlink(missing_ok=True)
    try:
        with os.fdopen(open_private_file(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL), "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
    except BaseException:
        fresh.unlink(missing_ok=True)
        raise


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk: after a crash a renamed file has its new name. Raises `OSError`."""
    if sys.platform == "win32":
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class FileAccess(NamedTuple):
    """How small files are read and replaced: on a disk, or on that of a virtual fleet. Raise as the functions above."""

    read: Callable[[Path], bytes] = read_private_file
    replace: Callable[[Path, bytes], None] = replace_private_file


ON_DISK = FileAccess()
