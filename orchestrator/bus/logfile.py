"""The file that log lines are written to, live."""

import json
import os
import sys
from contextlib import suppress
from pathlib import Path

from orchestrator.bus.journald import JournalSender, is_wanted
from orchestrator.bus.log import LogSink
from orchestrator.model.files.locks import lock_file
from orchestrator.model.files.private_files import open_for_append, open_private_file, replace_private_file

MAX_LOG_BYTES = 10_000_000  # of one file, before it is rotated
KEPT_LOGS = 3  # rotated files that are kept: PATH.1 is the newest
_RENAMES_OPEN_FILES = sys.platform != "win32"
"""Where an open file keeps its name, it is rotated only before it is opened."""


class LogFile:
    """A log file that several processes may append to. Each line is written at once, so that it survives a crash.

    A line that cannot be written is counted: a full disk must not keep a process from its work. The count is written
    as soon as that is possible.
    """

    def __init__(self, path: Path, max_bytes: int = MAX_LOG_BYTES) -> None:
        """Open the file at `path`, and create its folder. Raises `UnsafePath`, `OSError`."""
        self._path = path
        self._max_bytes = max_bytes
        if not _RENAMES_OPEN_FILES:
            with suppress(PermissionError):  # another process appends to it
                rotate_if_large(path)
        self._fd = open_for_append(path)
        self._lost = 0
        self._cause = ""

    def append_line(self, line: str) -> None:
        """Append a line, and rotate the file if it has become too large. Raises nothing."""
        try:
            self._use_present_file()
            if self._lost:
                text = f"{self._lost} lines could not be written: {self._cause}"
                self._write_line(json.dumps({"level": "warning", "text": text}))
                self._lost = 0
            self._write_line(line)
        except OSError as error:
            self._lost += 1
            self._cause = error.strerror or str(error)

    def close(self) -> None:
        os.close(self._fd)

    def _write_line(self, line: str) -> None:
        data = line.encode("utf-8", "replace") + b"\n"
        count = os.write(self._fd, data)
        if count != len(data):  # the disk is full in the middle of the line
            os.write(self._fd, b"\n")

    def _use_present_file(self) -> None:
        """Open the file again if another process has rotated it, or it was deleted; rotate it if it is too large."""
        status = os.fstat(self._fd)
        if not self._is_present(status):
            self._open_again()
        elif status.st_size >= self._max_bytes and _RENAMES_OPEN_FILES:
            # One of the processes rotates it; the others find that it is done.
            lock_file(self._fd)
            if self._is_present(status):
                rotate_files(self._path)
            self._open_again()

    def _is_present(self, ours: os.stat_result) -> bool:
        try:
            return os.path.samestat(ours, self._path.lstat())
        except FileNotFoundError:
            return False

    def _open_again(self) -> None:
        fresh = open_for_append(self._path)
        os.close(self._fd)
        self._fd = fresh


def rotate_files(path: Path) -> None:
    """Rename the file at `path` to PATH.1, an older PATH.1 to PATH.2, and so on; the oldest is replaced.

    Raises `OSError`.
    """
    _shift_files(path)
    path.replace(path.with_name(f"{path.name}.1"))


def _shift_files(path: Path) -> None:
    names = [path.with_name(f"{path.name}.{number}") for number in range(1, KEPT_LOGS + 1)]
    for older, newer in zip(reversed(names[1:]), reversed(names[:-1]), strict=True):
        if newer.exists():
            newer.replace(older)


def rotate_if_large(path: Path) -> None:
    """Rotate a file that is appended to without a `LogFile`, before it is opened. Raises `OSError`."""
    if path.exists() and path.stat().st_size >= MAX_LOG_BYTES:
        rotate_files(path)


def rotate_open_file(path: Path, max_bytes: int = MAX_LOG_BYTES) -> None:
    """Rotate a file that another process keeps open and appends to: its newest bytes are copied, and it is emptied.

    What is written between the two is lost, and on a full disk all of it. Does nothing if the file is not too large.
    Raises `UnsafePath`, `OSError`.
    """
    with suppress(FileNotFoundError), os.fdopen(open_private_file(path, os.O_RDWR), "r+b") as file:
        size = file.seek(0, os.SEEK_END)
        if size < max_bytes:
            return
        file.seek(size - max_bytes)
        with suppress(OSError):
            copy = path.with_name(f"{path.name}.copy")
            replace_private_file(copy, file.read(max_bytes))
            _shift_files(path)
            copy.replace(path.with_name(f"{path.name}.1"))
        file.truncate(0)


def make_file_sink(path: Path) -> LogSink:
    """Make a sink that appends to `path`, and sends to the journal of systemd if that is wanted. Raises `UnsafePath`,
    `OSError`."""
    append = LogFile(path).append_line
    if not is_wanted():
        return append
    send = JournalSender().send_line

    def write_line(line: str) -> None:
        append(line)
        send(line)

    return write_line
