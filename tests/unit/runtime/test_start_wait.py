"""How long starts of processes may take on slow computers, in virtual time."""

import asyncio

import pytest

from adapters.host.slow_starts import FIRST_HEARTBEAT_NS, SupervisedStarts
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.start_limit import StartLimit
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.runtime.live.start_wait import wait_for_start


async def start(needed_s: float) -> str:
    await asyncio.sleep(needed_s)
    return "ready"


def test_a_slow_start_is_waited_for_and_said() -> None:
    async def main(_: VirtualClock) -> None:
        lines: list[str] = []
        assert await wait_for_start("host/a", start(3.0), lines.append) == "ready" and not lines
        assert await wait_for_start("host/a", start(55.0), lines.append) == "ready"
        assert lines == [
            "waits for host/a, which has been starting for 10 s, and has 300 s",
            "waits for host/a, which has been starting for 40 s, and has 300 s",
            "host/a is slow to start: 55 s",
        ]

    run_virtual(main)


def test_a_start_that_hangs_ends_at_the_limit() -> None:
    async def main(clock: VirtualClock) -> None:
        begun_ns = clock.now_ns()
        with pytest.raises(TimeoutError):
            await wait_for_start("host/a", start(1e6), lambda _: None, 100.0)
        assert clock.now_ns() - begun_ns == 100 * NS_PER_S

    run_virtual(main)


def test_the_limit_follows_what_starts_needed_within_its_bounds() -> None:
    limit = StartLimit(20 * NS_PER_S, 300 * NS_PER_S)
    for needed_s, limit_s in ((1, 20), (41, 123), (200, 300), (2, 20)):
        limit.note_start(needed_s * NS_PER_S)
        assert limit.limit_ns == limit_s * NS_PER_S
    for limit_s in (40, 80, 160, 300, 300):
        limit.note_end()
        assert limit.limit_ns == limit_s * NS_PER_S


def test_a_host_that_was_killed_for_slowness_gets_more_time_until_it_runs() -> None:
    """Its computer needs 41 s for each start."""

    async def main(clock: VirtualClock) -> None:
        lines: list[str] = []
        announced_ns: list[int] = []
        ended_ns: list[int] = []

        async def announce() -> None:
            announced_ns.append(clock.now_ns())
            try:
                await asyncio.Event().wait()
            finally:
                ended_ns.append(clock.now_ns())

        starts = SupervisedStarts("a", ProcessLog("guardian", "a", clock, lines.append), announce)
        assert starts.limit_ns == FIRST_HEARTBEAT_NS[0]
        kills = await start_until_it_runs(starts, clock, 41.0)
        assert kills == ["20 s", "40 s"] and starts.limit_ns == 3 * 41 * NS_PER_S
        assert "host a is slow to start: 41 s" in lines[-1]
        # It is announced from the first slow moment on, over the kills, until it runs.
        await asyncio.sleep(0.1)
        assert [round(at_ns / NS_PER_S) for at_ns in (*announced_ns, *ended_ns)] == [10, 20 + 40 + 41]
        assert await start_until_it_runs(starts, clock, 50.0) == []

    run_virtual(main)


async def start_until_it_runs(starts: SupervisedStarts, clock: VirtualClock, needed_s: float) -> list[str]:
    """Start a host as a guardian does, which looks each second; return the limits at which it was killed."""
    kills: list[str] = []
    while True:
        begun_ns, limit_ns = clock.now_ns(), starts.limit_ns
        while clock.now_ns() - begun_ns < min(limit_ns, needed_s * NS_PER_S):
            await asyncio.sleep(1.0)
            starts.take_look(None, clock.now_ns() - begun_ns)
        if limit_ns >= needed_s * NS_PER_S:
            starts.take_look(round(needed_s * NS_PER_S), clock.now_ns() - begun_ns)
            return kills
        assert f"its next start has {2 * limit_ns // NS_PER_S} s" in starts.note_killed()
        kills.append(f"{limit_ns // NS_PER_S} s")
