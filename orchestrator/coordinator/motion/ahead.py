"""A motion step that is prepared while the one before it moves, and started behind it."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Literal

from orchestrator.clock.base import sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.motion.chain import BetweenSteps
from orchestrator.coordinator.motion.immediate_start import ImmediateStart
from orchestrator.coordinator.motion.planning import plan_following
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.step import MotionStep, PlannedMotion
from orchestrator.model.errors import Refusal

Stage = Literal["planning", "arming", "armed", "releasing", "released", "refused"]


class StepAhead:
    """Prepares `step` behind `before`, which is released, in a task of its own.

    between: what happens between the two; where outputs are switched, the step is decided only after `allow_release`.
    on_released: called once all members will start it. Members have room for one step beside the present one: it is
    armed only after `allow_arming`, when `before` is the present one.
    """

    def __init__(
        self,
        services: MotionServices,
        step: MotionStep,
        before: PlannedMotion,
        between: BetweenSteps,
        on_released: Callable[["StepAhead", PlannedMotion], None],
    ) -> None:
        self.step = step
        self._services = services
        self._before = before
        self.between = between
        self._on_released = on_released
        self._may_arm = asyncio.Event()
        self._motion: PlannedMotion | None = None
        self._stage: Stage = "planning"
        self._prevented = ""
        self._withdrawals = TaskOwner()
        self._may_release = asyncio.Event()
        if not between.acts:
            self._may_release.set()
        self._task = asyncio.get_running_loop().create_task(self._prepare())
        self._task.add_done_callback(_note_result)

    @property
    def is_decided(self) -> bool:
        """Whether it starts, or may start, whatever the job does now."""
        return self._motion is not None and self._motion.start.state.decided

    @property
    def released(self) -> PlannedMotion | None:
        """The step, once all members will start it."""
        return self._motion if self._stage == "released" else None

    def allow_arming(self) -> None:
        """The step before is the present one."""
        self._may_arm.set()

    def prevent_release(self, reason: str) -> None:
        """Let the step not start behind the present one, unless that is decided; one that starts at once is withdrawn
        while it waits."""
        self._prevented = reason
        if self._motion is None:
            return
        start = self._motion.start
        start.state.withdrawn = reason
        if self._stage == "releasing" and isinstance(start, ImmediateStart):
            self._withdrawals.spawn(start.withdraw_waiting())

    async def settle(self) -> None:
        """Wait until a withdrawal that was begun has its result: whether the step starts."""
        if self._withdrawals.pending:
            await asyncio.wait(self._withdrawals.pending)
        if self._prevented and self._stage == "releasing":
            await asyncio.wait({self._task})

    def allow_release(self) -> None:
        """What happens between the two steps is done."""
        self._may_release.set()

    async def wait_until_released(self) -> PlannedMotion:
        """The step, which all members will start. Raises `Refusal`: none of it is loaded, and nothing of it moves."""
        self.allow_release()
        return await asyncio.shield(self._task)

    async def withdraw(self, reason: str, actor: str) -> None:
        """Unload the step; a released one is stopped. Returns when that is done."""
        motion = self._motion
        if self._stage == "releasing" and motion is not None:
            # The exchange under way must not be cut off: it ends with a release, or with all members unloaded.
            self.prevent_release(reason)
            if isinstance(motion.start, ImmediateStart):
                await motion.start.disarm()  # the member does not start the step any more: its answer comes at once
            with suppress(Refusal, JournalError):
                await asyncio.shield(self._task)
        self._task.cancel()
        # A journal that cannot be used does not keep the members from being unloaded.
        with suppress(asyncio.CancelledError, Refusal, JournalError):
            await self._task
        if motion is None or self._stage == "refused":
            return
        motion.watch.close()
        if self._stage == "released":
            await self._services.fleet.stop_members(motion.agreement.movers, "decelerate", actor, reason)
        elif self._stage != "planning":
            await motion.start.disarm()
        self._stage = "refused"

    async def feed_hold(self, actor: str) -> None:
        """Brake the step if it moves already, or prevent its start."""
        if self._motion is not None:
            await self._motion.feed_hold(self._services.fleet, actor, begun=self._stage in ("releasing", "released"))

    # Inside

    async def _prepare(self) -> PlannedMotion:
        try:
            return await self._prepare_stages()
        except Exception:
            self._stage = "refused"
            if self._motion is not None:
                self._motion.watch.close()
            raise

    async def _prepare_stages(self) -> PlannedMotion:
        services, motion_before = self._services, self._before
        planned_following = await plan_following(services, self.step.request, motion_before.planned)
        if not planned_following.plan.profiles:
            raise Refusal("no-motion", "the step moves no axis")
        present = motion_before.make_present(self.between)
        motion = self._motion = await PlannedMotion.agree(services, planned_following, present)
        await self._may_arm.wait()
        motion.start.state.withdrawn = self._prevented
        self._stage = "arming"
        await motion.start.arm_following()
        self._stage = "armed"
        await self._wait_for_release(motion)
        self._stage = "releasing"
        await motion.start.release_following()
        self._stage = "released"
        self._on_released(self, motion)
        return motion

    async def _wait_for_release(self, motion: PlannedMotion) -> None:
        """Wait until the step must be decided, and may be."""
        services = self._services
        wait_ns = motion.start.release_due_ns - services.leadership.fleet_now_ns()
        await sleep_ns(services.fleet.clock, max(0, wait_ns))
        await self._may_release.wait()


def _note_result(task: "asyncio.Task[PlannedMotion]") -> None:
    """A refusal is raised where the step is waited for; a step that was withdrawn is not waited for."""
    if not task.cancelled():
        task.exception()
