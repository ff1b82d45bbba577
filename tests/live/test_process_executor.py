"""Calls in a process of its own: results, refusals, and what ends it."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from orchestrator.clock.executor import MAX_CALLS, PLANNING, READING, ProcessExecutor
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.jobs.job import Job
from orchestrator.plan.path_step import PathStart, plan_path_step
from orchestrator.runtime.examples import find_example

pytestmark = pytest.mark.live

PIECES = 10_000
TURN_S = 0.06  # of a processor, in one turn of the loop


def refuse() -> None:
    raise Refusal("bad-request", "no", "yes")


def take_memory() -> int:
    return len(bytearray(READING.max_bytes))


def reach_the_limit() -> None:
    """The alarm of the kernel, as after the longest time: no handler of Python runs."""
    signal.raise_signal(signal.SIGALRM)


def test_calls_in_another_process() -> None:
    async def main() -> None:
        run = ProcessExecutor()
        try:
            pid = await run(os.getpid)
            assert pid not in (os.getpid(), 0)
            with pytest.raises(Refusal, match="no") as refused:
                await run(refuse)
            assert refused.value.remedy == "yes"
            with pytest.raises(Refusal, match="was not read within 20 s"):
                await run(take_memory)
            with pytest.raises(Refusal, match="was not read within 20 s"):
                await run(reach_the_limit)
            assert await run(os.getpid) != pid
            calls = [asyncio.ensure_future(run(os.getpid)) for _ in range(MAX_CALLS + 2)]
            answers = await asyncio.gather(*calls, return_exceptions=True)
            assert [type(answer) for answer in answers] == [int] * MAX_CALLS + [Refusal] * 2
        finally:
            run.close()

    asyncio.run(main())


def read_memory_mb(pid: int) -> int:
    """The resident memory of a process."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) // 1000


def plan_long_path() -> None:
    """Plan a long path, and print the most processor time of this process from a turn of its loop to the next, s."""
    fleet = load_fleet(find_example("demo.fleet.yaml"))
    axes = ("gantry.x", "gantry.y")
    points = [[90 + number * 0.01, 50 + number % 2 * 0.01] for number in range(1, PIECES + 1)]
    path: dict[str, Any] = {"do": "path", "axes": axes, "start": [90, 50], "tolerance": "0.1 mm", "speed": "50 mm/s"}
    path |= {"corner": {"within": "0.05 mm"}, "pieces": [{"piece": "line", "to": point} for point in points]}
    (step,) = Job.model_validate({"schema": "tutti.job/1", "name": "p", "steps": [path]}).steps
    starts = [
        PathStart(name, fleet.axis(name), Fraction(at), at * 1000, Fraction(0), 3)
        for name, at in zip(axes, (90, 50), strict=True)
    ]
    turns: list[float] = []

    async def note_turns() -> None:
        while True:
            turns.append(time.process_time())
            await asyncio.sleep(0.005)

    async def main() -> None:
        plan = ProcessExecutor(PLANNING)
        try:
            pid = await plan(os.getpid)
            before_mb, noting = read_memory_mb(os.getpid()), asyncio.ensure_future(note_turns())
            planned = await plan(plan_path_step, step, starts, fleet.frames)
            noting.cancel()
            assert planned.report.duration_s > 1.0
            assert read_memory_mb(os.getpid()) - before_mb < 50
            await plan(os.getpid)
            assert read_memory_mb(pid) < 150
            with pytest.raises(Refusal, match="the path begins at 90 mm"):
                await plan(
                    plan_path_step,
                    step,
                    [starts[0]._replace(start_counts=0, here=Fraction(0)), starts[1]],
                    fleet.frames,
                )
        finally:
            plan.close()

    asyncio.run(main())
    longest_s = max(late - early for early, late in pairwise(turns))
    sys.stdout.write(f"{longest_s:.6f}")


def test_a_long_path_is_planned_beside_the_loop_and_its_memory_is_returned() -> None:
    """A thread was silent for 133 ms with 100,000 pieces, and 0.7 GB stayed.

    Processor time of a process of its own: planning in a thread of it counts; work of others on a busy machine does
    not, nor threads and objects that earlier tests have left.
    """
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True, check=False, timeout=110)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < TURN_S


if __name__ == "__main__":
    plan_long_path()
