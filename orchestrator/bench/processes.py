"""What processes of this computer use, from `/proc`."""

import os
from collections.abc import Iterator
from pathlib import Path


def read_cpu_s(pid: int) -> float:
    """The processor time that a process has used, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def read_resident_bytes(pid: int) -> int:
    """The memory of a process that is resident, bytes; pages that it shares with others are counted."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def list_children(pid: int) -> list[int]:
    """The processes that the main thread of a process has started, by id."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="utf-8").split()]


def iterate_tree(pid: int) -> Iterator[int]:
    """A process, and all that it has started."""
    yield pid
    for child in list_children(pid):
        yield from iterate_tree(child)
