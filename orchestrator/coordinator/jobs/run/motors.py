"""Motors of a job's axes: switched on before it and off after it, where the fleet file says so."""

from orchestrator.coordinator.jobs.needs import find_axes
from orchestrator.coordinator.jobs.run.sequence import StepSequence
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.coordinator.steps.context import StepContext
from orchestrator.coordinator.steps.motors import switch_motors
from orchestrator.model.errors import Refusal
from orchestrator.model.names import split_name
from orchestrator.model.steps.tree import iterate_steps


class JobMotors:
    """Switches the motors of the axes that job `row` moves."""

    def __init__(self, services: JobServices, row: JobRecord, steps: StepSequence) -> None:
        self._services = services
        self._row = row
        self._steps = steps

    def _moved_axes(self) -> list[str]:
        """Axes that it moves, and that are enabled for it if the fleet file says so."""
        moves = [step for step in iterate_steps(self._steps.list_steps(self._row.from_step)) if step.moves]
        return find_axes(self._services.view.fleet, moves)

    async def enable_by_policy(self, context: StepContext) -> bool:
        """Enable axes with `enable: per_job` that are not enabled; return whether there were any. Raises `Refusal`."""
        fleet = self._services.view.fleet
        off = [
            axis for axis in self._moved_axes() if fleet.axis(axis).enable != "manual" and not self._is_enabled(axis)
        ]
        if off:
            await switch_motors(context, off, on=True)
        return bool(off)

    async def disable_by_policy(self, context: StepContext) -> None:
        """Disable axes with `enable: per_job`. An axis that still ramps down stays enabled, and that is logged."""
        services = self._services
        per_job = [axis for axis in self._moved_axes() if services.view.fleet.axis(axis).enable == "per_job"]
        if per_job:
            try:
                await switch_motors(context, per_job, on=False)
            except Refusal as error:
                services.log.warning(f"left enabled after the job: {error.text}", job=self._row.id)

    def _is_enabled(self, axis: str) -> bool:
        controller, name = split_name(axis)
        state = self._services.view.last_state(controller)
        return state is not None and state.axes[name].enabled
