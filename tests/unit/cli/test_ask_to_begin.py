"""The word for a job at a terminal: Enter, after what moves first was shown."""

# pyright: reportPrivateUsage=false

import asyncio
import os
import pty
import sys

import pytest

from orchestrator.cli.jobs import follow
from orchestrator.model.jobs.restart import FirstMotion, StartPreview

PREVIEW = StartPreview.of([FirstMotion(job_id="j", name="scan", text="step 1: move to gantry.x=5")], [])


def test_an_enter_from_before_counts_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()

    async def ask() -> None:
        os.write(master, b"\n")  # typed while the cause lasted
        await asyncio.sleep(0)
        asking = asyncio.ensure_future(follow._ask_to_begin(PREVIEW))
        _, pending = await asyncio.wait([asking], timeout=0.3)
        assert pending == {asking}
        os.write(master, b"\n")
        assert await asyncio.wait_for(asking, 5.0) is True

    try:
        with os.fdopen(slave) as stdin:
            monkeypatch.setattr(sys, "stdin", stdin)
            asyncio.run(ask())
    finally:
        os.close(master)
