"""The wait of a step for a keep-out zone: until the jobs that have axes of the same rules have moved on or ended."""

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.coordinator.fleet.zone_reservations import WAIT_S, ZoneReservations
from orchestrator.coordinator.jobs.run.run_state import RunState


class ZoneWait:
    """Waits for the steps of a job. holder: of its leases. now: it was submitted not to wait."""

    def __init__(
        self, reservations: ZoneReservations, state: RunState, clock: Clock, holder: str, *, now: bool = False
    ) -> None:
        self._reservations = reservations
        self._state = state
        self._clock = clock
        self._holder = holder
        self._limit_s = 0.0 if now else WAIT_S
        self._began_ns: int | None = None
        self._cause = ""

    async def wait(self, cause: str) -> str:
        """Wait until another step or job has ended, or for a moment, and return nothing; or return why the step waits
        no longer."""
        now_ns = self._clock.now_ns()
        if self._began_ns is None:
            self._began_ns = now_ns
        waited_s = (now_ns - self._began_ns) / NS_PER_S
        if waited_s >= self._limit_s:
            return f"it has waited for {waited_s:.0f} s" if self._limit_s else "it was submitted not to wait"
        circle = self._reservations.begin_wait(self._holder)
        if circle is not None:
            return f"job {circle} waits for this one: each is in the way of the other"
        try:
            if cause != self._cause:
                self._cause = cause
                await self._state.change_state("planning", f"waits {self._state.describe_place()} for a zone: {cause}")
            await self._reservations.wait_for_change()
        finally:
            self._reservations.end_wait(self._holder)
        return ""

    def end(self, index: int) -> None:
        """A step is over."""
        self._began_ns, self._cause = None, ""
        self._reservations.end(self._holder, index)
