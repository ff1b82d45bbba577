"""The turns of the steps of a job: when each can begin."""

from collections.abc import AsyncGenerator

from orchestrator.coordinator.jobs.run.run_state import RunState
from orchestrator.coordinator.jobs.run.sequence import StepSequence


class StepTurns:
    """The numbers of the steps of a job, each when it can begin. is_open: it waits for steps that it is asked for."""

    def __init__(self, steps: StepSequence, state: RunState, *, is_open: bool) -> None:
        self._steps = steps
        self._state = state
        self._is_open = is_open

    async def iterate(self, first: int) -> AsyncGenerator[int]:
        """The numbers from `first` on. Raises `JobInterrupted`, `JournalError`."""
        number = await self._wait_for_step(first)
        while number is not None:
            yield number
            number = await self._wait_for_step(number + 1)

    async def _wait_for_step(self, index: int) -> int | None:
        """The number of the next step, `index` or behind it; None: there is none any more."""
        if self._is_open and not self._steps.has_step(index):
            await self._state.note_waiting(index)
        number = await self._steps.find_next(index)
        if number is None and self._is_open and self._state.pause.given_up is not None:
            raise self._state.pause.given_up
        return number
