"""What a job does before its first step: it is checked once more, gets its axes, and is published."""

from collections.abc import Iterable
from contextlib import suppress

from orchestrator.bus.base import BusError, Priority
from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.leases import AxesInUse
from orchestrator.coordinator.fleet.requests import ANSWER_S
from orchestrator.coordinator.jobs.check import check_job
from orchestrator.coordinator.jobs.job_plan import PlannedJob, list_written, make_plan
from orchestrator.coordinator.jobs.needs import find_axes
from orchestrator.coordinator.jobs.run.job_axes import JobAxes
from orchestrator.coordinator.jobs.run.sequence import StepSequence
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import DamagedRecord, JobRecord
from orchestrator.model.base import UnknownName
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import CheckSettingsRequest, SettingsChecked
from orchestrator.model.operation.approval import join_changes, list_changes
from orchestrator.model.operation.recording import JobBegun
from orchestrator.model.steps.tree import iterate_steps


class PlanDeviates(Refusal):
    """A proposed job would not begin with the plan that was approved."""

    def __init__(self, changes: str) -> None:
        super().__init__("plan-changed", f"held again: {changes}", "look at the plan again: `tutti job approve`")


class SettingsDiffer(Refusal):
    """A controller of a job has faults, which the comparison of its settings has shown; nothing of it has moved."""


class JobPreparation:
    """Prepares job `row`. positions_used: the named positions of its targets, as they were when it was prepared."""

    def __init__(self, services: JobServices, row: JobRecord, job: Job, steps: StepSequence, axes: JobAxes) -> None:
        self.positions_used: dict[str, dict[str, str]] = {}
        self._services = services
        self._row = row
        self._job = job
        self._steps = steps
        self._axes = axes

    async def prepare(self, needs: frozenset[str]) -> int:
        """Take positions and axes, and check the job; return when the axes were asked for. needs: its controllers.
        Raises `Refusal`, `AxesInUse`."""
        services = self._services
        self._take_positions()
        # Again, because the fleet may have changed since the job was accepted.
        remaining = self._steps.order.list_remaining(self._row.from_step)
        least_s = await check_job(services.view.fleet, remaining, services.motion.plan, services.check)
        services.fleet.certificates.require_until(needs, least_s)
        since_ns = services.clock.now_ns()
        await self._axes.take()
        return since_ns

    async def prepare_approved(self, needs: frozenset[str]) -> int:
        """`prepare`, for a job that may only begin with its approved plan. Its axes are taken before the plan is made:
        nothing else can move them from then on. Raises `PlanDeviates`, `AxesInUse`, `JournalError`."""
        try:
            since_ns = await self.prepare(needs)
            await self._axes.rest.wait_for_rest(since_ns)
            changes = await self._find_deviation(since_ns)
            if changes:
                raise PlanDeviates(changes)
        except AxesInUse:
            raise
        except (Refusal, UnknownName) as error:
            await self._axes.give_back()
            # A part of the plan may be one that cannot even be determined any more.
            raise error if isinstance(error, PlanDeviates) else PlanDeviates(str(error)) from None
        return since_ns

    async def _find_deviation(self, since_ns: int) -> str:
        """What differs from the approved plan, in words; empty: nothing. Raises `Refusal`, `UnknownName`,
        `JournalError`."""
        services, row = self._services, self._row
        try:
            approval = await services.execute(services.journal.approvals.load_approval, row.id)
        except DamagedRecord:
            return "its approval in the journal is damaged"
        if approval is None or approval.void:
            return "no plan of it is approved"
        steps = list_written(self._steps.order, row.from_step)
        planned_job = PlannedJob(self._job, row.repeat, row.from_step, steps, self.positions_used)
        plan = await make_plan(services.view, planned_job, since_ns)
        return "" if plan.hash == approval.plan.hash else join_changes(list_changes(approval.plan, plan))

    async def compare_settings(self) -> None:
        """Have the controllers that the job moves, which are at rest, compare all settings: another client may have
        changed one while nothing of this fleet moved. Raises `SettingsDiffer`; its leases have ended then.

        A controller that does not answer, or cannot compare now, is refused by planning."""
        services, row = self._services, self._row
        steps = self._steps.list_steps(row.from_step)
        if not any(step.moves or step.enables for step in iterate_steps(steps)):
            return
        requests = {
            controller: CheckSettingsRequest(
                **services.fleet.requests.request_fields(row.actor), axes=axes, holder=row.id
            )
            for controller, axes in group_by_controller(find_axes(services.view.fleet, steps)).items()
        }
        asked_ns, timeout_s = services.clock.now_ns(), await self._find_timeout_s(requests)
        replies = await services.fleet.requests.request_all("check-settings", requests, SettingsChecked, timeout_s)
        changed_states = [state for reply in replies.values() if (state := reply.state) is not None and state.faults]
        for state in changed_states:
            services.view.note_answer(state, asked_ns)
        if changed_states:
            await self._axes.give_back()
            first = changed_states[0].faults[0]
            raise SettingsDiffer(first.code, f"{changed_states[0].controller}: {first.text}", first.remedy)

    async def _find_timeout_s(self, members: Iterable[str]) -> float:
        """How long the comparison may take: it is a part of arming."""
        arm_ns = 0
        for member in members:
            with suppress(BusError):
                arm_ns = max(arm_ns, (await self._services.view.infos.query(member)).costs.arm_ns)
        return ANSWER_S + 2 * arm_ns / NS_PER_S

    async def publish_beginning(self) -> None:
        """Publish the job itself, for what records it."""
        services, row = self._services, self._row
        begun_job = JobBegun(
            job_id=row.id,
            name=row.name,
            actor=row.actor,
            utc=services.clock.utc(),
            epoch=services.leadership.epoch,
            repeat=row.repeat,
            from_step=row.from_step,
            positions_used=self.positions_used,
            job=self._job,
        )
        services.bus.put(services.keys.job_begun(row.id), await services.dump_model(begun_job), Priority.EVENT)

    def _take_positions(self) -> None:
        """Take the values of the named positions of its targets, for the whole run. Raises `Refusal`."""
        resolver = self._services.positions.make_resolver()
        order = resolver.resolve_remaining(self._job.steps, self._row.repeat, self._row.from_step)
        self._steps.replace_order(order)
        self.positions_used = resolver.used
