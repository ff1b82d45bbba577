"""Finding references: axes in their order, side by side where nothing forbids it, and none after one that failed."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field

from orchestrator.coordinator.fleet.permits import Permits
from orchestrator.coordinator.fleet.requests import Members
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.motion.targets import Refuse
from orchestrator.model.fleet import Fleet, by_controller
from orchestrator.model.messages import HomeReply, HomeRequest, Refusal, StopMode
from orchestrator.plan.step import Targets

ANSWER_S = 3.0
LOOK_S = 0.05

StopMembers = Callable[[list[str], StopMode, str, str], Awaitable[None]]
Progress = Callable[[float, str], None]
"""Told the part that is done, 0 to 1, and what is being done."""


@dataclass(frozen=True, slots=True)
class Order:
    """entries: axes homed side by side, each entry after all before it. loners: axes that no order names, each by
    itself after the entries, whether the one before it has found its reference or not."""

    entries: list[list[str]]
    loners: list[str]


def homing_order(fleet: Fleet, axes: list[str] | None) -> Order:
    """Those asked for, in their order; else the fleet's `home_order`, and then all that do not stand in it."""
    seen, entries = set[str](), list[list[str]]()
    for entry in fleet.home_order if axes is None else axes:
        fresh = [axis for axis in fleet.expand(entry) if axis not in seen]
        seen.update(fresh)
        if fresh:
            entries.append(fresh)
    return Order(entries, [axis for axis in fleet.axis_names if axis not in seen] if axes is None else [])


def must_wait_for(fleet: Fleet, order: Order) -> dict[str, set[str]]:
    """By axis, those that must be referenced before it begins: all earlier entries, and its `homing.after`.

    Raises `Refuse` where the two contradict each other.
    """
    waits: dict[str, set[str]] = {}
    earlier: set[str] = set()
    for entry in [*order.entries, order.loners]:
        for axis in entry:
            waits[axis] = earlier | set(fleet.axis(axis).homing.after)
        earlier = earlier | set(entry)
    left = dict(waits)
    while free := [axis for axis, others in left.items() if not others & left.keys()]:
        for axis in free:
            del left[axis]
    if left:
        first = min(left)
        raise Refuse(
            "homing-order",
            f"{first} is homed after {', '.join(sorted(left[first] & left.keys()))} (homing.after), which stands "
            "behind it in the order asked for",
            "change the order, or home_order in the fleet file",
        )
    return waits


@dataclass(slots=True)
class _Run:
    """One homing under way. busy: controllers with axes that look for their reference now."""

    holder: str
    actor: str
    waits: dict[str, set[str]]
    loners: list[str]
    homed: list[str] = field(default_factory=list[str])
    failed: dict[str, Refusal] = field(default_factory=dict[str, Refusal])
    busy: dict[str, list[str]] = field(default_factory=dict[str, list[str]])

    def blocked(self) -> dict[str, str]:
        """Axes that can not begin any more, with the one that failed before them."""
        stopped: dict[str, str] = {axis: axis for axis in self.failed}
        while True:
            more = {
                axis: next(stopped[other] for other in sorted(others) if other in stopped)
                for axis, others in self.waits.items()
                if axis not in stopped and others & stopped.keys()
            }
            if not more:
                return {axis: cause for axis, cause in stopped.items() if axis not in self.failed}
            stopped |= more

    def ready(self) -> list[str]:
        """Axes that may begin now."""
        begun = {*self.homed, *self.failed, *(axis for axes in self.busy.values() for axis in axes)}
        ready = [
            axis
            for axis, others in self.waits.items()
            if axis not in begun and axis.partition(".")[0] not in self.busy and others <= set(self.homed)
        ]
        alone = [axis for axis in ready if axis in self.loners]
        together = [axis for axis in ready if axis not in self.loners]
        return together or ([] if self.busy else alone[:1])


class Homing:
    """Homes axes of the fleet. stop: stops members, all at once (members, mode, actor, reason)."""

    def __init__(
        self, view: FleetView, members: Members, permits: Permits, targets: Targets, stop: StopMembers
    ) -> None:
        self._view = view
        self._members = members
        self._permits = permits
        self._targets = targets
        self._stop = stop

    async def run(self, axes: list[str] | None, holder: str, actor: str, progress: Progress) -> None:
        """Home `axes`, or the fleet. Raises `Refuse`: which failed and why, and which were left because of it."""
        fleet = self._view.fleet
        order = homing_order(fleet, axes)
        waits = must_wait_for(fleet, order)
        run = _Run(holder, actor, waits, order.loners)
        for axis in [other for others in waits.values() for other in others if other not in waits]:
            self._require_referenced(axis, waits)
            run.homed.append(axis)
        total, before = len(waits), len(run.homed)
        missing = self._permits.missing(waits)
        if missing is not None:
            raise Refuse("permit", missing, "bring it about, then submit again")
        guard, woken = self._permits.guard(waits), asyncio.Event()
        unlisten = self._permits.listen(woken.set)
        tasks: dict[asyncio.Task[HomeReply], str] = {}
        waiting = asyncio.get_running_loop().create_task(woken.wait())
        try:
            while True:
                for controller, names in by_controller(run.ready()).items():
                    run.busy[controller] = [f"{controller}.{name}" for name in names]
                    ask = self._ask(run, controller, names)
                    tasks[asyncio.get_running_loop().create_task(ask)] = controller
                if not tasks:
                    break
                now = sorted(axis for axes in run.busy.values() for axis in axes)
                progress((len(run.homed) - before) / total, f"homing {', '.join(now)}")
                await asyncio.wait([*tasks, waiting], return_when=asyncio.FIRST_COMPLETED)
                lost = guard.lost()
                if lost is not None:
                    await self._stop(list(run.busy), "decelerate", actor, lost)
                    raise Refuse("permit", lost, "bring it about, then home again")
                for task in [each for each in tasks if each.done()]:
                    self._take(run, tasks.pop(task), task.result())
        finally:
            unlisten()
            waiting.cancel()
            for task in tasks:
                task.cancel()
        if run.failed:
            raise self._failure(run)

    def _require_referenced(self, axis: str, waits: Mapping[str, set[str]]) -> None:
        controller, _, name = axis.partition(".")
        state = self._view.state(controller)
        if state is None or not state.axes[name].referenced:
            waiting = next(each for each, others in waits.items() if axis in others)
            raise Refuse(
                "not-referenced",
                f"{waiting} is homed after {axis} (homing.after), which is not referenced",
                f"home {axis} first, or both together",
                controller,
            )

    async def _ask(self, run: _Run, controller: str, names: list[str]) -> HomeReply:
        for name in names:
            self._targets.forget(f"{controller}.{name}")
        timeout_s = max(self._view.fleet.controllers[controller].axes[name].homing.timeout_s for name in names)
        request = HomeRequest(**self._members.fields(run.actor), axes=names, holder=run.holder)
        state = self._view.state(controller)
        instance = None if state is None else state.instance
        ask = self._members.ask(controller, "home", request, HomeReply, timeout_s + ANSWER_S)
        asked = asyncio.get_running_loop().create_task(ask)
        try:
            while True:
                await asyncio.wait([asked], timeout=LOOK_S)
                if asked.done():
                    return asked.result()
                # Its answer may take as long as its axes may look: nobody waits for it who knows that it will not come.
                gone = self._view.gone(controller, instance)
                if gone is not None:
                    await self._stop([controller], "decelerate", run.actor, gone)
                    remedy = "look at its adapter host (`tutti status`), then home again"
                    return HomeReply(refused=Refusal(code="absent", text=gone, remedy=remedy, member=controller))
        finally:
            asked.cancel()

    def _take(self, run: _Run, controller: str, reply: HomeReply) -> None:
        axes = run.busy.pop(controller)
        for axis in axes:
            name = axis.partition(".")[2]
            if reply.refused is not None:
                run.failed[axis] = reply.refused
            elif name in reply.homed:
                run.homed.append(axis)
            else:
                missing = Refusal(code="homing-failed", text=f"axis {name}: nothing was said of it")
                run.failed[axis] = reply.failed.get(name, missing)

    def _failure(self, run: _Run) -> Refuse:
        first, why = next(iter(run.failed.items()))
        # What a whole controller has refused is said once.
        texts = list(dict.fromkeys(f"{axis.partition('.')[0]}: {each.text}" for axis, each in run.failed.items()))
        blocked = run.blocked()
        if blocked:
            causes = ", ".join(sorted(set(blocked.values())))
            texts.append(f"not homed because they come after {causes}: {', '.join(sorted(blocked))}")
        return Refuse(why.code, "; ".join(texts), why.remedy, first.partition(".")[0])
