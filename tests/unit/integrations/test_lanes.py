"""Stops of a lane when the coordinator does not answer."""

import asyncio
from collections.abc import Iterable
from typing import Any, cast

import pytest

from integrations.epics.lanes import Lane
from tutti import Refusal, Tutti


class SilentFleet:
    """A fleet whose coordinator refuses to cancel, or is away."""

    def __init__(self, code: str) -> None:
        self.code = code
        self.stopped: list[str] = []

    async def cancel_job(self, _: str) -> None:
        raise Refusal(self.code, "no")

    async def stop(self, *, known: Iterable[str]) -> dict[str, Any]:
        self.stopped += known
        return {}


@pytest.mark.parametrize(
    ("code", "stopped"), [("no-coordinator", ["gantry"]), ("no-answer", ["gantry"]), ("ended", [])]
)
def test_without_a_coordinator_a_stop_goes_to_the_controllers(code: str, stopped: list[str]) -> None:
    fleet = SilentFleet(code)

    async def main() -> None:
        await Lane(cast("Tutti", fleet), "s", 0.0, lambda _: None)._cancel("gantry.x", "job")

    asyncio.run(main())
    assert fleet.stopped == stopped
