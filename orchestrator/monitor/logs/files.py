"""The log files of a state folder: all of their lines, and those that are added."""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from orchestrator.bus.logfile import KEPT_LOGS
from orchestrator.monitor.logs.line import LogLine, parse_line, parse_plain_line
from orchestrator.monitor.logs.placing import PlacedLine, place_lines

LineParser = Callable[[str, str], LogLine]

_PARSERS: dict[str, LineParser] = {".jsonl": parse_line, ".err": parse_plain_line}


class LogTail:
    """One log file: the lines of its rotated files and its own, then those that are appended.

    A file that is rotated is read to its end before the new one is opened; one that is emptied is read from the
    beginning.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        # Names of different kinds are kept apart: `coordinator` and `coordinator.err`.
        self.name = path.stem if path.suffix == ".jsonl" else path.name
        self.anchor: LogLine | None = None
        """The last line with both times, from which later ones are placed."""
        self._parse = _PARSERS[path.suffix]
        self._file: BinaryIO | None = None
        self._begun = b""

    @property
    def written_ns(self) -> int:
        """When the file was written last, UTC; 0 if it has gone."""
        try:
            return self.path.stat().st_mtime_ns
        except OSError:
            return 0

    def read_rotated(self) -> list[LogLine]:
        """Read the lines of the rotated files, the oldest first. Raises `OSError`."""
        data = b""
        for number in range(KEPT_LOGS, 0, -1):
            older = self.path.with_name(f"{self.path.name}.{number}")
            if older.exists():
                data += older.read_bytes()
        return self._note(self._split(data))

    def read_added(self) -> list[LogLine]:
        """Read the whole lines that were added since the last call. Raises `OSError`."""
        if self._file is None:
            self._file = self._open()
        if self._file is None:
            return []
        data = self._read_rest(self._file)
        if not self._is_present(self._file):
            # All of the old file has been read: no process appends to it any more.
            data += self._file.read()
            self._file.close()
            self._file = self._open()
            data += self._file.read() if self._file is not None else b""
        return self._note(self._split(data))

    def close(self) -> None:
        """Close the file. Safe to call twice."""
        if self._file is not None:
            self._file.close()

    def _open(self) -> BinaryIO | None:
        try:
            return self.path.open("rb")
        except FileNotFoundError:
            return None

    def _read_rest(self, file: BinaryIO) -> bytes:
        if os.fstat(file.fileno()).st_size < file.tell():
            file.seek(0)
            self._begun = b""
        return file.read()

    def _is_present(self, file: BinaryIO) -> bool:
        try:
            return os.path.samestat(os.fstat(file.fileno()), self.path.stat())
        except FileNotFoundError:
            return False

    def _split(self, data: bytes) -> Iterator[LogLine]:
        *lines, self._begun = (self._begun + data).split(b"\n")
        for line in lines:
            if line.strip(b"\0 \r"):
                yield self._parse(self.name, line.decode("utf-8", "replace"))

    def _note(self, lines: Iterator[LogLine]) -> list[LogLine]:
        all_lines = list(lines)
        timed_lines = (line for line in reversed(all_lines) if line.utc_ns is not None and line.fleet_ns is not None)
        self.anchor = next(timed_lines, self.anchor)
        return all_lines


class LogFolder:
    """The log files of a state folder; also those that appear later."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._tails: dict[Path, LogTail] = {}

    def read_all(self) -> list[PlacedLine]:
        """Read all lines, in order. Raises `OSError`."""
        return self._read({tail.name: tail.read_rotated() for tail in self._find_new()}, {})

    def read_added(self) -> list[PlacedLine]:
        """Read the lines that were added since the last call, in order among themselves. Raises `OSError`."""
        anchors = {tail.name: tail.anchor for tail in self._tails.values()}
        self._find_new()
        return self._read({}, anchors)

    def close(self) -> None:
        """Close all files. Safe to call twice."""
        for tail in self._tails.values():
            tail.close()

    def _find_new(self) -> Sequence[LogTail]:
        paths = sorted(path for path in self._folder.glob("*") if path.suffix in _PARSERS)
        new = {path: LogTail(path) for path in paths if path not in self._tails}
        self._tails.update(new)
        return list(new.values())

    def _read(self, before: dict[str, list[LogLine]], anchors: dict[str, LogLine | None]) -> list[PlacedLine]:
        known_anchors = {name: [anchor] for name, anchor in anchors.items() if anchor is not None}
        new_lines = {tail.name: before.get(tail.name, []) + tail.read_added() for tail in self._tails.values()}
        write_times = {tail.name: tail.written_ns for tail in self._tails.values()}
        placed_lines = place_lines(
            {name: known_anchors.get(name, []) + lines for name, lines in new_lines.items()}, write_times
        )
        old = {id(line) for anchors in known_anchors.values() for line in anchors}
        return [line for line in placed_lines if id(line.line) not in old]
