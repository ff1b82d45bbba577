"""Waits for the starts of processes: long ones are said, and end after minutes only, because a computer may be slow."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.owner import running
from orchestrator.clock.start_limit import SLOW_NS

T = TypeVar("T")

START_LIMIT_S = 300.0  # as long as a guardian gives its adapter host
SAY_AGAIN_S = 30.0


async def wait_for_start(
    name: str, start: Coroutine[Any, Any, T], say: Callable[[str], None], limit_s: float = START_LIMIT_S
) -> T:
    """Wait for the start of the process `name`, at most `limit_s`, and say so. Raises `TimeoutError`."""
    loop = asyncio.get_running_loop()
    begun_s, pause_s, is_slow = loop.time(), SLOW_NS / NS_PER_S, False
    async with running(start) as started_task:
        while True:
            left_s = begun_s + limit_s - loop.time()
            await asyncio.wait([started_task], timeout=min(pause_s, left_s))
            lasted_s = loop.time() - begun_s
            if started_task.done():
                if is_slow:
                    say(f"{name} is slow to start: {lasted_s:.0f} s")
                return started_task.result()
            if lasted_s >= limit_s:
                raise TimeoutError
            say(f"waits for {name}, which has been starting for {lasted_s:.0f} s, and has {limit_s:.0f} s")
            pause_s, is_slow = SAY_AGAIN_S, True
