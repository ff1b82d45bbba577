"""The end of a process that was killed: at once as a rule, and late while the operating system keeps it."""

import asyncio
from collections.abc import Callable
from typing import Protocol

KILLED_S = 5.0
"""A killed process is gone within milliseconds. One in a call of a device driver or of a disk that hangs is not, until
that call returns, and nothing can end it before."""


class KillableProcess(Protocol):
    """What is used of a process."""

    pid: int

    def kill(self) -> None:
        """Kill it."""
        ...

    async def wait(self) -> int:
        """Wait for its end; return its exit code."""
        ...


async def kill_process(name: str, process: KillableProcess, say: Callable[[str], None]) -> bool:
    """Kill a process and wait for its end, at most `KILLED_S`; return whether it has ended, and say if it has not."""
    process.kill()
    try:
        async with asyncio.timeout(KILLED_S):
            await process.wait()
    except TimeoutError:
        say(
            f"{name} (process {process.pid}) was killed and has not ended within {KILLED_S:g} s: the operating system "
            "keeps it, as a rule for a device or a disk that hangs; it ends with that, or when the computer restarts"
        )
        return False
    return True
