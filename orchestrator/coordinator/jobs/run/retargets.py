"""Other targets for the present move of a job, while it moves or is being started.

A retarget is a feed hold that ends by itself: the axes brake together by their plan, and the step goes on to the new
targets. A controller that follows positions continues to them on the way. Of several requests the newest counts.
"""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.jobs.run.motion_chain import MotionChain
from orchestrator.coordinator.jobs.run.run_state import RunState
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.motion.retarget import (
    AxisTargets,
    continue_motion,
    find_continuation,
    read_infos,
    resolve_retarget,
)
from orchestrator.coordinator.motion.start import FEED_HOLD
from orchestrator.coordinator.motion.step import MotionStep
from orchestrator.coordinator.motion.targets import ResolvedMove
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import JobRetargeted, RetargetJob
from orchestrator.model.report import StepReport, StepRetarget
from orchestrator.model.state import ControllerInfo, RetargetAbility, RetargetWay

CHANGE_AFTER = 0.95  # of the time that a controller states for the change of its set-points
MAX_ENTRIES = 100  # of one step, in its report: the last ones
RETARGETED = "the step before it got other targets"


@dataclass(frozen=True, slots=True)
class _Wish:
    """One request. fleet_ns: when it came. continuation: how its axis continues on the way; None: the axes brake."""

    request: RetargetJob
    resolved: ResolvedMove
    goal: Mapping[str, Fraction]
    fleet_ns: int
    continuation: RetargetAbility | None


class StepRetargets:
    """The retargets of the present step. entries: for its report."""

    def __init__(self, services: JobServices, state: RunState, chain: MotionChain) -> None:
        self._services = services
        self._state = state
        self._chain = chain
        self._lock = asyncio.Lock()
        self._wanted: Mapping[str, Fraction] = {}
        """The newest targets, which may wait for their turn."""
        self._asked = 0
        self._replaced = 0
        self.entries: list[StepRetarget] = []

    def begin_step(self) -> None:
        """Another step is the present one."""
        self._wanted, self._replaced, self.entries = {}, 0, []

    async def retarget(self, request: RetargetJob) -> JobRetargeted:
        """Send the axes of the present move to other targets; returns once these count. Raises `Refusal`: nothing has
        changed."""
        asked_fleet_ns, step = self._services.leadership.fleet_now_ns(), self._require_step()
        motion = self._services.motion
        infos = await read_infos(motion, step.request.axes)
        present_goal = self._wanted or step.goal
        resolved_move = resolve_retarget(motion, step.request, AxisTargets(request.to, request.by), present_goal, infos)
        goal = {axis: exact for axis, (exact, _) in resolved_move.exact.items()}
        continuation = find_continuation(self._services.view.fleet, infos, step.request.axes)
        reply = JobRetargeted(
            step=step.request.index,
            way="brake" if continuation is None else continuation.way,
            within_s=_find_brake_s(infos) if continuation is None else continuation.within_s,
        )
        if goal == present_goal:
            return reply.model_copy(update={"outcome": "same"})
        self._wanted = goal
        self._asked += 1
        number = self._asked
        async with self._lock:
            if number < self._asked:
                self._replaced += 1
                return reply.model_copy(update={"outcome": "replaced"})
            wish = _Wish(request, resolved_move, goal, asked_fleet_ns, continuation)
            try:
                way = await self._apply(step, wish)
                if way != reply.way:
                    reply = reply.model_copy(update={"way": way, "within_s": _find_brake_s(infos)})
                return reply
            finally:
                if number == self._asked:
                    self._wanted = {}

    async def continue_step(self, report: StepReport) -> bool:
        """Whether the present step, which has come to rest with `report`, goes on to other targets."""
        step = self._state.motion_step
        if step is None or not step.is_retargeted:
            return False
        async with self._lock:  # what is being unloaded for it is unloaded
            return report.state == "done" or (report.refused is not None and report.refused.code == FEED_HOLD)

    def note_start(self, t0_fleet_ns: int) -> None:
        """The present step starts at T0."""
        step = self._state.motion_step
        if step is None or step.is_retargeted or not self.entries or self.entries[-1].started_ns is not None:
            return
        self._change_last(started_ns=t0_fleet_ns - self.entries[-1].asked_fleet_ns)

    def _require_step(self) -> MotionStep:
        """The present motion. Raises `Refusal`."""
        step, pause = self._state.motion_step, self._state.pause
        if step is None:
            raise Refusal("not-moving", "the job moves no axis now", "a retarget is for a move that is under way")
        if pause.paused_by is not None:
            raise Refusal("paused", f"the job is being paused by {pause.paused_by}", "resume it first")
        return step

    def _require_present(self, step: MotionStep) -> None:
        if self._state.motion_step is not step:
            raise Refusal("not-moving", "the move has ended", "a retarget is for a move that is under way")

    async def _apply(self, step: MotionStep, wish: _Wish) -> RetargetWay:
        """Have the present step go to other targets, and return by which way. Raises `Refusal`."""
        chain, actor = self._chain, wish.request.actor
        if self._require_step() is step and chain.starts_behind(step):
            self._change_goal(step, wish)
            await chain.feed_hold(actor)
            return "brake"
        chain.prevent_release(RETARGETED)
        await chain.settle_pause()
        self._require_present(step)
        if chain.is_decided:
            raise Refusal("not-moving", "the move ends, and the next one starts behind it", "ask again for that one")
        await chain.drop(RETARGETED, actor)
        if wish.continuation is not None and await self._continue(step, wish, wish.continuation):
            return wish.continuation.way
        self._require_present(step)
        self._change_goal(step, wish)
        is_begun = step.motion is not None and step.motion.start.state.decided
        await step.feed_hold(actor)
        if is_begun:
            self._change_last(changed_ns=self._services.leadership.fleet_now_ns() - wish.fleet_ns)
        return "brake"

    async def _continue(self, step: MotionStep, wish: _Wish, ability: RetargetAbility) -> bool:
        """Have the present motion continue to its new targets on the way; whether it does."""
        motion = step.motion
        if motion is None or step.is_retargeted or motion.start.state.paused_by is not None:
            return False
        begin_ns = wish.fleet_ns + round(CHANGE_AFTER * ability.within_s * NS_PER_S)
        old_goal = step.goal
        try:
            continued_motion = await continue_motion(
                self._services.motion, motion, wish.resolved, begin_ns, ability.way
            )
            step.take_motion(motion, continued_motion)
        except Refusal as refusal:
            self._services.log.info(f"braked for its other target: {refusal}", job=wish.request.job_id)
            return False
        self._note(old_goal, wish, ability.way)
        after_ns = begin_ns - wish.fleet_ns
        self._change_last(changed_ns=after_ns, started_ns=after_ns)
        self._state.note_start(continued_motion.start.state.t0_fleet_ns, continued_motion.duration_s)
        self._chain.look_ahead(continued_motion)
        return True

    def _change_goal(self, step: MotionStep, wish: _Wish) -> None:
        """Have the step take its new targets with its next plan."""
        self._note(step.goal, wish, "brake")
        step.retarget(wish.goal)

    def _note(self, old_goal: Mapping[str, Fraction], wish: _Wish, way: RetargetWay) -> None:
        """Note a retarget for the report; one whose motion has not started yet is replaced by it."""
        last = self.entries[-1] if self.entries else None
        number = 1 if last is None else last.number + 1
        replaced_count, old_targets = self._replaced, self._as_user(old_goal)
        if last is not None and last.started_ns is None:
            replaced_count, old_targets = replaced_count + last.replaced + 1, last.before
            self.entries.pop()
        self._replaced = 0
        entry = StepRetarget(
            number=number,
            by=wish.request.actor,
            utc=self._services.clock.utc(),
            before=old_targets,
            to=self._as_user(wish.goal),
            way=way,
            replaced=replaced_count,
            asked_fleet_ns=wish.fleet_ns,
        )
        self.entries = [*self.entries, entry][-MAX_ENTRIES:]
        self._services.log.info(f"other targets, by {entry.by}: {entry.to}", job=wish.request.job_id)

    def _as_user(self, goal: Mapping[str, Fraction]) -> dict[str, float]:
        axes = {axis: self._services.view.axis_now(axis) for axis in goal}
        return {axis: float(goal[axis] + (0 if state is None else state.offset)) for axis, state in axes.items()}

    def _change_last(self, **fields: int) -> None:
        self.entries[-1] = self.entries[-1].model_copy(update=fields)


def _find_brake_s(infos: Mapping[str, ControllerInfo]) -> float:
    """The longest time of a stop of these controllers, s."""
    return max((info.costs.stop_ns / NS_PER_S for info in infos.values()), default=0.0)
