"""One step of a controller, from its loading to its end."""

import asyncio
from dataclasses import dataclass, field

from adapters.contract import HostInterval, TimedWrite
from adapters.smc30.lowering import Smc30Lowered
from adapters.smc30.slots import StartSlot
from orchestrator.clock.base import Clock
from orchestrator.clock.timed import TimedMove


@dataclass(slots=True)
class LoadedStep:
    """A loaded step.

    behind: it was loaded right behind another one.
    order, slot: of its starting command, from `go` on.
    started: the interval of the start, when known.
    arrived_ns: for a start by the host, the earliest arrival of the end of its command at the controller.
    answered_ns: the latest instant at which its answer was sent.
    timed: observations of the motion, where they provide information about the crystal."""

    lowered: Smc30Lowered
    t0_ns: int
    behind: bool = False
    order: TimedWrite | None = None
    slot: StartSlot | None = None
    started: HostInterval | None = None
    running: bool = False
    """Its program has been started."""
    followed: bool = False
    """A task waits for its start or its end."""
    stopped_ns: int | None = None
    arrived_ns: int = 0
    answered_ns: int | None = None
    timed: TimedMove | None = None
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def start(self) -> HostInterval:
        """The interval of the start, known once `started` is set."""
        if self.started is None:
            raise RuntimeError("the step has not started")
        return self.started

    async def sleep_until(self, clock: Clock, at_ns: int) -> None:
        """Wait until that instant, or a stop."""
        if self.stopped_ns is not None:
            return
        timer = clock.call_at_ns(at_ns, self.changed.set)
        try:
            if clock.now_ns() < at_ns:
                await self.changed.wait()
        finally:
            timer.cancel()
        self.changed.clear()


def passive_commands(lowered: Smc30Lowered) -> tuple[str, ...]:
    """Return the commands that make the driven output passive."""
    drive = lowered.drive
    return () if drive is None else (f"{'C' if drive.high else 'A'}{drive.number}",)
