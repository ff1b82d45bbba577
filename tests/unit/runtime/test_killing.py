"""A process that was killed and does not end: nothing waits for it without a limit, and a message names it."""

import asyncio
from pathlib import Path
from typing import Any, cast

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.examples import find_example
from orchestrator.runtime.live.fleet import END_TIMEOUT_S, ChildProcess, LiveFleet
from orchestrator.runtime.live.killing import KILLED_S

DEMO = load_fleet(find_example("demo.fleet.yaml"))


class KeptProcess:
    """A process that the operating system keeps, whatever is sent to it."""

    pid = 4711
    returncode: int | None = None

    def __init__(self) -> None:
        self.kills = 0

    def kill(self) -> None:
        self.kills += 1

    def send_signal(self, number: int) -> None:
        del number

    async def wait(self) -> int:
        await asyncio.Event().wait()
        raise AssertionError


def measure_ends(folder: Path, *, closes: bool) -> tuple[float, list[str], int]:
    """How long the fleet waits for a router that does not end, s; what it says; how often it kills it."""
    said: list[str] = []

    async def main(clock: VirtualClock) -> tuple[float, list[str], int]:
        fleet, process = LiveFleet(DEMO, folder, said.append), KeptProcess()
        fleet.children["router"] = ChildProcess("router", [], folder / "router.err", process=cast(Any, process))
        begun_ns = clock.now_ns()
        async with asyncio.timeout(600):
            await (fleet.close() if closes else fleet._restart_router())
        return (clock.now_ns() - begun_ns) / NS_PER_S, said, process.kills

    return run_virtual(main)


def test_a_router_that_is_restarted_and_does_not_end_is_named_after_a_limit(tmp_path: Path) -> None:
    took_s, said, kills = measure_ends(tmp_path, closes=False)
    assert took_s == KILLED_S and kills == 1
    assert len(said) == 1 and "router (process 4711) was killed and has not ended within 5 s" in said[0]


def test_a_fleet_ends_without_a_process_that_does_not(tmp_path: Path) -> None:
    took_s, said, kills = measure_ends(tmp_path, closes=True)
    assert took_s == END_TIMEOUT_S + KILLED_S and kills == 1
    assert "is killed" in said[0] and "(process 4711)" in said[1]
