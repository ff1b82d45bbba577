"""Processes that have a device open, as far as this user may see them."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


def find_holders(device: Path) -> list[str]:
    """Return the processes that have the character device open, for display: `pid 1234 (minicom)`. Empty if none is
    visible."""
    number = device.stat().st_rdev
    return [_describe_process(process) for process in _list_processes() if _has_open(process, number)]


def _list_processes() -> Iterator[Path]:
    own = str(os.getpid())
    return (path for path in Path("/proc").iterdir() if path.name.isdecimal() and path.name != own)


def _has_open(process: Path, number: int) -> bool:
    # Processes of other users are not readable, and any process may end meanwhile.
    with contextlib.suppress(OSError):
        for descriptor in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                if descriptor.stat().st_rdev == number:
                    return True
    return False


def _describe_process(process: Path) -> str:
    name = "?"
    with contextlib.suppress(OSError):
        name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
    return f"pid {process.name} ({name})"
