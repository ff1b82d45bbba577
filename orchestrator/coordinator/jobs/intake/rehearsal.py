"""Dry runs: jobs are run forward on paper, and the controllers asked what they would be sent."""

import asyncio
from collections.abc import Awaitable
from contextlib import suppress
from typing import Literal

from orchestrator.bus.base import BusError
from orchestrator.coordinator.jobs.check import forecast_at_once, forecast_step
from orchestrator.coordinator.jobs.needs import find_needed_controllers
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.motion.path_chunks import make_chunk_ability
from orchestrator.coordinator.motion.planning import PlannedStep, StepRequest
from orchestrator.coordinator.motion.step import rehearse_step
from orchestrator.coordinator.motion.targets import ResolvedMove
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.forecast import AxisForecast, StepForecast, StepProblem
from orchestrator.model.jobs.parts import find_long_paths
from orchestrator.model.jobs.service import DryRun, DryRunDone
from orchestrator.model.steps.tree import as_motion
from orchestrator.plan.curved_move import straighten
from orchestrator.plan.flying.path import ChunkAbility
from orchestrator.plan.forecast.job import JobForecaster
from orchestrator.plan.probes import ProbeAbilities
from orchestrator.plan.racks import bound_racks
from orchestrator.plan.virtual_bound import bound_virtual_axes

REHEARSALS_AT_ONCE = 3
"""Steps for which the members are asked at the same time, so that they work while messages are under way. Few, because
a running job's step waits for as many lowerings before it can be armed."""

# What a controller refuses because of the state of the world now, which may be another one when the job runs.
_WORLD = {"absent", "offline", "no-answer", "start-skew", "no-scale"}


class JobRehearsal:
    """Dry runs. A client sends the steps of a job in parts, each with the forecast after the part before."""

    def __init__(self, services: JobServices) -> None:
        self._services = services

    async def dry_run(self, request: DryRun) -> DryRunDone:
        """Check some steps of a job and ask each controller what it would be sent. Raises `Refusal`."""
        view = self._services.view
        axes = request.begin if request.begin is not None else self._look_at_axes()
        orders: dict[str, Literal[2, 3]] = {}
        chunks: dict[str, ChunkAbility] = {}
        probes: dict[str, ProbeAbilities] = {}
        alone_times: dict[str, float | None] = {}
        await view.infos.prefetch(view.fleet.controllers)
        for name in view.fleet.controllers:
            # A controller that does not answer is planned by the fleet file.
            with suppress(BusError):
                info = await view.infos.query(name)
                orders[name], chunks[name] = max(info.orders), make_chunk_ability(info)
                probes[name] = ProbeAbilities.of(info)
                alone_times[name] = info.alone_s
        forecaster = JobForecaster(view.fleet, axes, orders, chunks, probes)
        forecaster.alone = alone_times
        steps: list[StepForecast] = []
        rehearsals: list[Awaitable[StepForecast]] = []
        for number, step in enumerate(self._services.positions.make_resolver().resolve_steps(request.job.steps)):
            index = request.first + number
            if find_long_paths([step]):  # by a process, which returns another forecaster
                await _finish_rehearsals(rehearsals, steps, request.first)
                forecaster, forecast = await self._services.check(forecast_at_once, forecaster, index, step)
            else:
                forecast = await forecast_step(forecaster, index, step, self._services.motion.plan)
            motion = forecaster.motion
            asked_step = as_motion(step) if motion is None or motion.line is None else motion.line
            steps.append(forecast)
            if asked_step is not None and motion is not None and motion.plan.profiles:
                asked_move, axes = straighten(view.fleet, asked_step), asked_step.find_axes(view.fleet)
                asked_request = StepRequest("dry-run", request.job, index, asked_move, axes)
                resolved_move = ResolvedMove(motion.moves, dict(motion.exact))
                planned_step = PlannedStep(
                    asked_request,
                    resolved_move,
                    motion.plan,
                    {},
                    rehearsal=True,
                    path=motion.path,
                    triggers=motion.triggers,
                )
                rehearsals.append(self._rehearse(planned_step, forecast, forecaster.problems))
            if len(rehearsals) == REHEARSALS_AT_ONCE or number == len(request.job.steps) - 1:
                await _finish_rehearsals(rehearsals, steps, request.first)
        self._check_certificates(request, steps, forecaster)
        return DryRunDone(forecast=forecaster.finish(steps), end=forecaster.axes)

    def _check_certificates(self, request: DryRun, steps: list[StepForecast], forecaster: JobForecaster) -> None:
        """Add the first step that would outlive a certificate to the problems, if these steps began now."""
        if forecaster.problems:
            return
        fleet, certificates = self._services.view.fleet, self._services.fleet.certificates
        members, least_s = find_needed_controllers(fleet, request.job.steps), 0.0
        for step in steps:
            least_s += step.least_s
            try:
                certificates.require_until(members, least_s)
            except Refusal as error:
                forecaster.add_refusal(step.index, error)
                return

    async def _rehearse(
        self, planned: PlannedStep, forecast: StepForecast, problems: list[StepProblem]
    ) -> StepForecast:
        """What the members make of a step; what they refuse is added to `problems`, or is a condition."""
        try:
            agreement = await rehearse_step(self._services.motion, planned)
        except Refusal as error:
            if error.code in _WORLD:
                return forecast.model_copy(update={"conditions": [*forecast.conditions, error.text]})
            problems.append(
                StepProblem(
                    place=["steps", forecast.index],
                    code=error.code,
                    text=error.text,
                    remedy=error.remedy,
                    controller=error.controller,
                )
            )
            return forecast
        duration_s = round(agreement.plan.duration_s, 6)
        is_line = forecast.do == "scan"  # of which that is the first line
        return forecast.model_copy(
            update={
                "least_s": forecast.least_s if is_line else duration_s,
                "most_s": forecast.most_s if is_line else duration_s,
                "path": agreement.path,
                "virtual": bound_virtual_axes(self._services.view.fleet, planned.request.move, agreement, planned.line),
                "racks": bound_racks(self._services.view.fleet, agreement.plan),
                "budget": agreement.budget.to_plain() if agreement.budget else None,
                "commands": {member: proposal.commands for member, proposal in agreement.proposals.items()},
            }
        )

    def _look_at_axes(self) -> dict[str, AxisForecast]:
        """All axes as they are now; those of silent controllers are unknown."""
        view, targets = self._services.view, self._services.motion.targets
        axes: dict[str, AxisForecast] = {}
        for name in view.fleet.axis_names:
            state_now, axis = view.axis_now(name), view.fleet.axis(name)
            if state_now is None:
                continue
            axes[name] = AxisForecast(
                motor=targets.exact_position(name, state_now.commanded_counts, axis.to_position(state_now.axis_counts)),
                known=True,
                offset=state_now.offset,
                enabled=state_now.enabled or axis.enable != "manual",
                referenced=state_now.referenced,
                play=state_now.play,
            )
        return axes


async def _finish_rehearsals(rehearsals: list[Awaitable[StepForecast]], steps: list[StepForecast], first: int) -> None:
    """Await rehearsals that were begun, and put their forecasts among those of the steps. first: the index of those."""
    for done_forecast in await asyncio.gather(*rehearsals):
        steps[done_forecast.index - first] = done_forecast
    rehearsals.clear()
