"""Calls in a process of its own: results, refusals, and what ends it."""

import asyncio
import os
import signal

import pytest

from orchestrator.clock.executor import MAX_CALLS, READING, ProcessExecutor
from orchestrator.model.errors import Refusal

pytestmark = pytest.mark.live


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
