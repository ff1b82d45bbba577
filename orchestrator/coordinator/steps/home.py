"""Homing: axes in their order, in parallel where nothing forbids it, and none after one that failed."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field

from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.zones import ZoneGuard
from orchestrator.coordinator.steps.context import ProgressCallback, ReportFields, StepContext
from orchestrator.coordinator.steps.search_requests import SearchRequest
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.messages import HomeReply, HomeRequest, RefusalDetails
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.state import ControllerState
from orchestrator.model.steps.home import Home
from orchestrator.plan.homing_order import find_partners, find_prerequisites, homing_order
from orchestrator.plan.step import ExactTargets


@dataclass(slots=True)
class _HomingRun:
    """One homing in progress. busy: controllers with axes that are searching for their reference now. partners: by axis
    of a pair, the other one, which begins at the same time."""

    holder: str
    actor: str
    waits: dict[str, set[str]]
    loners: frozenset[str]
    partners: Mapping[str, str]
    homed: list[str] = field(default_factory=list[str])
    failed: dict[str, RefusalDetails] = field(default_factory=dict[str, RefusalDetails])
    busy: dict[str, list[str]] = field(default_factory=dict[str, list[str]])

    def find_blocked(self) -> dict[str, str]:
        """Axes that cannot begin any more, with the axis before them that failed."""
        stopped_axes: dict[str, str] = {axis: axis for axis in self.failed}
        while True:
            more = {
                axis: next(
                    stopped_axes[predecessor] for predecessor in sorted(predecessors) if predecessor in stopped_axes
                )
                for axis, predecessors in self.waits.items()
                if axis not in stopped_axes and predecessors & stopped_axes.keys()
            }
            if not more:
                return {axis: cause for axis, cause in stopped_axes.items() if axis not in self.failed}
            stopped_axes |= more

    def find_ready(self) -> list[str]:
        """Axes that may begin now."""
        started_axes = {*self.homed, *self.failed, *(axis for axes in self.busy.values() for axis in axes)}
        homed_axes = set(self.homed)
        ready = [
            axis
            for axis, predecessors in self.waits.items()
            if axis not in started_axes and controller_of(axis) not in self.busy and predecessors <= homed_axes
        ]
        ready = [axis for axis in ready if self.partners.get(axis, axis) in ready]
        single_axes = [axis for axis in ready if axis in self.loners]
        group_axes = [axis for axis in ready if axis not in self.loners]
        return group_axes or ([] if self.busy else self._join_partner(single_axes[:1]))

    def _join_partner(self, axes: list[str]) -> list[str]:
        """Axes with those that are pairs with them."""
        return [*axes, *(self.partners[axis] for axis in axes if axis in self.partners)]


class HomingSequence:
    """Homes axes of the fleet."""

    def __init__(self, fleet: FleetAccess, targets: ExactTargets, zones: ZoneGuard) -> None:
        self._fleet = fleet
        self._targets = targets
        self._zones = zones

    async def run(self, axes: list[str] | None, holder: str, actor: str, progress: ProgressCallback) -> None:
        """Home `axes`, or the fleet. Raises `Refusal`: the axes that failed and why, and those that were skipped
        because of it."""
        fleet = self._fleet.view.fleet
        order = homing_order(fleet, axes)
        waits = find_prerequisites(fleet, order)
        run = _HomingRun(holder, actor, waits, frozenset(order.loners), find_partners(fleet))
        for axis in [
            predecessor
            for predecessors in waits.values()
            for predecessor in sorted(predecessors)
            if predecessor not in waits
        ]:
            self._require_referenced(axis, waits)
            run.homed.append(axis)
        total, count_before = len(waits), len(run.homed)
        self._fleet.permits.require(waits)
        await self._zones.require_homing(order, holder)
        guard, woken = self._fleet.permits.watch_losses(waits), asyncio.Event()
        unlisten = self._fleet.permits.add_loss_listener(woken.set)
        tasks: dict[asyncio.Task[HomeReply], str] = {}
        wake_task = asyncio.get_running_loop().create_task(woken.wait())
        try:
            while True:
                for controller, names in group_by_controller(run.find_ready()).items():
                    run.busy[controller] = [f"{controller}.{name}" for name in names]
                    ask = self._request_homing(run, controller, names)
                    tasks[asyncio.get_running_loop().create_task(ask)] = controller
                if not tasks:
                    break
                busy_axes = sorted(axis for axes in run.busy.values() for axis in axes)
                progress((len(run.homed) - count_before) / total, f"homing {', '.join(busy_axes)}")
                await asyncio.wait([*tasks, wake_task], return_when=asyncio.FIRST_COMPLETED)
                loss = guard.describe_loss()
                if loss is not None:
                    await self._fleet.stop_members(list(run.busy), "decelerate", actor, loss)
                    raise guard.make_refusal("home")
                for task in [candidate for candidate in tasks if candidate.done()]:
                    self._take_reply(run, tasks.pop(task), task.result())
        finally:
            unlisten()
            wake_task.cancel()
            for task in tasks:
                task.cancel()
        if run.failed:
            raise self._make_failure(run)

    def _require_referenced(self, axis: str, waits: Mapping[str, set[str]]) -> None:
        controller, name = split_name(axis)
        state = self._fleet.view.last_state(controller)
        if state is None or not state.axes[name].referenced:
            waiting_axis = next(follower for follower, predecessors in waits.items() if axis in predecessors)
            raise Refusal(
                "not-referenced",
                f"{waiting_axis} must be homed after {axis} (homing.after), which is not referenced",
                f"home {axis} first, or both together",
                controller,
            )

    async def _request_homing(self, run: _HomingRun, controller: str, names: list[str]) -> HomeReply:
        try:
            # Those before them stand where they have found their references, and not where these were expected.
            await self._zones.require_search([axis for axes in run.busy.values() for axis in axes], run.holder)
        except Refusal as error:
            return HomeReply(refused=RefusalDetails.of(error))
        for name in names:
            self._targets.forget_target(f"{controller}.{name}")
        timeout_s = max(self._fleet.view.fleet.controllers[controller].axes[name].homing.timeout_s for name in names)
        request = HomeRequest(**self._fleet.requests.request_fields(run.actor), axes=names, holder=run.holder)

        def is_homing(state: ControllerState) -> bool:
            return any(state.axes[name].homing for name in names)

        search = SearchRequest(controller, "home", request, HomeReply, timeout_s, is_homing, "home")
        return await search.send(self._fleet)

    def _take_reply(self, run: _HomingRun, controller: str, reply: HomeReply) -> None:
        axes = run.busy.pop(controller)
        for axis in axes:
            name = split_name(axis)[1]
            if reply.refused is not None:
                run.failed[axis] = reply.refused
            elif name in reply.homed:
                run.homed.append(axis)
            else:
                missing_details = RefusalDetails(
                    code="homing-failed", text=f"axis {name}: the adapter has not reported a result"
                )
                run.failed[axis] = reply.failed.get(name, missing_details)

    def _make_failure(self, run: _HomingRun) -> Refusal:
        first, failure = next(iter(run.failed.items()))
        # The refusal of a whole controller is reported once.
        texts = list(dict.fromkeys(f"{axis.partition('.')[0]}: {details.text}" for axis, details in run.failed.items()))
        blocked_axes = run.find_blocked()
        if blocked_axes:
            causes = ", ".join(sorted(set(blocked_axes.values())))
            texts.append(f"not homed because they come after {causes}: {', '.join(sorted(blocked_axes))}")
        return Refusal(failure.code, "; ".join(texts), failure.remedy, controller_of(first))


async def run_home(context: StepContext, step: Home) -> ReportFields:
    """Home the axes of a step, or the fleet. Raises `Refusal`."""
    sequence = HomingSequence(context.fleet, context.targets, context.zones)
    await sequence.run(step.axes, context.holder, context.actor, context.progress)
    return {}
