"""The signals of processes that tests start."""

import asyncio
import signal
import subprocess
from collections.abc import Iterator

import pytest
from processes import IGNORED_BY_SOME_PARENTS, give_children_default_signals

COMMAND = ["cat", "/proc/self/status"]


@pytest.fixture
def ignored() -> Iterator[None]:
    """This process as one whose parent has them ignored."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in IGNORED_BY_SOME_PARENTS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def ignores(status: bytes) -> list[signal.Signals]:
    """Which of the signals that matter a process ignores, by its status from the kernel."""
    mask = next(int(line.split()[1], 16) for line in status.decode().splitlines() if line.startswith("SigIgn:"))
    return [each for each in (*IGNORED_BY_SOME_PARENTS, signal.SIGPIPE) if mask >> (each - 1) & 1]


async def start_from_a_loop() -> bytes:
    child = await asyncio.create_subprocess_exec(*COMMAND, stdout=asyncio.subprocess.PIPE)
    return (await child.communicate())[0]


@pytest.mark.usefixtures("ignored")
def test_children_have_default_signals_where_this_process_has_them_ignored() -> None:
    assert ignores(subprocess.run(COMMAND, capture_output=True, check=True).stdout) == [*IGNORED_BY_SOME_PARENTS]
    give_children_default_signals()
    assert ignores(subprocess.run(COMMAND, capture_output=True, check=True).stdout) == []
    assert ignores(asyncio.run(start_from_a_loop())) == []
    for number in IGNORED_BY_SOME_PARENTS:
        signal.raise_signal(number)  # this process goes on ignoring them


def test_every_test_process_has_it() -> None:
    assert ignores(subprocess.run(COMMAND, capture_output=True, check=True).stdout) == []
