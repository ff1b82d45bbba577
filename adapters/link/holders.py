"""Who has a device open, as far as this user may see it."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


def holders(device: Path) -> list[str]:
    """Processes that have the character device open, for people: `pid 1234 (minicom)`. Empty if none can be seen."""
    number = device.stat().st_rdev
    return [_shown(process) for process in _processes() if _has_open(process, number)]


def _processes() -> Iterator[Path]:
    own = str(os.getpid())
    return (each for each in Path("/proc").iterdir() if each.name.isdecimal() and each.name != own)


def _has_open(process: Path, number: int) -> bool:
    # Processes of other users can not be looked into, and any may end meanwhile.
    with contextlib.suppress(OSError):
        for descriptor in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                if descriptor.stat().st_rdev == number:
                    return True
    return False


def _shown(process: Path) -> str:
    name = "?"
    with contextlib.suppress(OSError):
        name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
    return f"pid {process.name} ({name})"
