"""A motion of a live job that is loaded in its controllers, and waits for `go`."""

from typing import Protocol

from orchestrator.client.steps import StepRequests
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.report import ArmedState, StepReport


class StepWaiter(Protocol):
    """Waits for the report of a step of a live job."""

    async def wait_for(self, number: int) -> StepReport: ...


class ArmedMove:
    """Step `number` of live job `job_id`, which waits armed: planned, agreed on, and loaded in all its controllers."""

    def __init__(
        self, requests: StepRequests, live: StepWaiter, job_id: str, number: int, state: ArmedState | None
    ) -> None:
        """state: on which terms it waits; None: its input has started it at once."""
        self.number = number
        self._requests = requests
        self._live = live
        self._job_id = job_id
        self._state = state

    def __repr__(self) -> str:
        return f"<ArmedMove {self.number} of job {self._job_id}, {self.lead_s * 1e3:.0f} ms from go to T0>"

    @property
    def lead_s(self) -> float:
        """From `go` to the start of the axes, s, as things were when it was armed."""
        return 0.0 if self._state is None else self._state.lead_ns / NS_PER_S

    @property
    def most_lead_s(self) -> float:
        """The same at most: `go` comes while the controllers are being loaded anew."""
        return 0.0 if self._state is None else self._state.most_lead_ns / NS_PER_S

    @property
    def until_fleet_ns(self) -> int:
        """The end of the wait, fleet time, ns; 0: it has ended already."""
        return 0 if self._state is None else self._state.until_fleet_ns

    async def go(self) -> int:
        """Start it as soon as all controllers can; return T0, fleet time in ns, once it is agreed. Raises `Refusal`:
        codes `not-armed` after the end of its wait, with what has ended it as the reason of its report, and `begun`."""
        return await self._go(None)

    async def go_at(self, fleet_ns: int) -> int:
        """Start it at an instant of fleet time, ns, which is agreed shortly before it. Raises `Refusal`: codes
        `too-near`, with the nearest that is possible, `too-late`, `not-armed`, `begun`."""
        return await self._go(fleet_ns)

    async def wait(self) -> StepReport:
        """Wait until it is done, however it was started; `waited_armed` of its report says how. Raises as
        `LiveJob.wait_for` does."""
        return await self._live.wait_for(self.number)

    async def _go(self, at_fleet_ns: int | None) -> int:
        try:
            return await self._requests.go_job(self._job_id, at_fleet_ns)
        except Refusal as error:
            if error.code != "ended":
                raise
            text = f"the wait has ended: {error.text}"
            raise Refusal("not-armed", text, "arm it again, in another live job") from None
