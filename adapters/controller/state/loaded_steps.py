"""The steps that a controller has: the present one and the one behind it, and what has interrupted them."""

import asyncio
from collections import deque

from adapters.contract import Driver
from adapters.controller.state.armed_step import ArmedStep, PastStep, StepPhase
from adapters.controller.state.next_step import NextStepSlot
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.latency import MAX_STARTS
from orchestrator.model.messages import StepRequest

# A participant is not polled for this long before T0: its commit reads the controller, while other participants are
# still being committed. Polling 16 controllers in this window made `go` miss its deadline.
QUIET_BEFORE_T0_NS = 300 * NS_PER_MS
# A participant is not polled for this long after a request of a step: arming reads the controller as well, and the
# fleet waits for it.
QUIET_AFTER_REQUEST_NS = 250 * NS_PER_MS
# From this long before the end of a step a controller is not polled, if another step follows: a poll would delay that.
QUIET_TURN_NS = 40 * NS_PER_MS
# While an adapter loads a step behind the end of another one, a poll would delay it. A controller that is not read for
# 0.7 s counts as silent.
QUIET_LOADING_NS = 450 * NS_PER_MS


class LoadedSteps:
    """The steps of one controller.

    present: in its phase; None if there is none. following: the place of the one behind it. interruptions: how often
    something has withdrawn a step; a transition that finds it changed after a wait unloads what it has loaded.
    followed_steps: whose ends the driver has not reached yet. followed_ns: when it has last reached one.
    reading_is_old: the last reading is from before the end of a step that another one follows. ended_ns: when the
    present step should have ended, at the latest, host time. requested_ns: when the last request of a step came.
    polled_ns: when the last poll ended, or the last loading behind a step. poll_takes_ns: how long a poll took, with
    the wait for its turn. past_steps: as
    many as starts are learned from. stop_pending: a released step has failed, and its stop could not be sent yet.
    stop_ns: longest time that a stop of the last step takes; its ramps may be gentler than the steepest ramps of the
    axes.
    """

    def __init__(self, driver: Driver) -> None:
        self.slots = driver.slots
        self.present: ArmedStep | None = None
        self.following = NextStepSlot(driver.slots)
        self.transition_lock = asyncio.Lock()
        self.loading_lock = asyncio.Lock()
        self.interruptions = 0
        self.followed_steps = 0
        self.followed_ns = 0
        self.reading_is_old = False
        self.ended_ns = 0
        self.requested_ns = -QUIET_AFTER_REQUEST_NS
        self.polled_ns = self.poll_takes_ns = 0
        self.past_steps: deque[PastStep] = deque(maxlen=MAX_STARTS)
        self.stop_pending = False
        self.stop_ns = 0

    @property
    def is_loading(self) -> bool:
        """Whether a step is being loaded at this moment, possibly without a link by now."""
        return self.loading_lock.locked()

    @property
    def has_step(self) -> bool:
        """Whether a step is loaded, or being loaded: its exchanges must not be delayed."""
        return self.present is not None or self.is_loading

    @property
    def is_followed(self) -> bool:
        """Whether the driver has not yet reached the end of a step, possibly a stopped one."""
        return self.followed_steps > 0

    @property
    def may_move(self) -> bool:
        """Whether something is loaded that may move, or moves. A move that waits for a trigger line waits before its
        participant is armed."""
        return self.has_step or self.is_followed or self.stop_pending

    @property
    def ordered_axes(self) -> tuple[str, ...]:
        """The axes that may move now: those of the moving step, and of a following one that is released."""
        present, following = self.present, self.following.armed_step
        if present is None or present.phase is not StepPhase.MOVING:
            return ()
        is_released = following is not None and following.phase is StepPhase.RELEASED
        return (*present.axes, *following.axes) if following is not None and is_released else present.axes

    def find_step(self, request: StepRequest) -> ArmedStep | None:
        """The present or the following step, if it is the one of the request."""
        for step in (self.present, self.following.armed_step):
            if step is not None and step.is_for(request):
                return step
        return None

    async def wait_until_loaded(self) -> None:
        """Wait until no step is being loaded: on a line that is shared with other controllers, loading continues
        without a link."""
        async with self.loading_lock:
            pass

    def quiet_until_ns(self, now_ns: int) -> int | None:
        """Return until when the controller must not be polled; None if it may be."""
        armed_step = self.present
        until_ns = self.requested_ns + QUIET_AFTER_REQUEST_NS
        if armed_step is not None:
            if armed_step.phase is StepPhase.MOVING:
                return self._quiet_turn_until_ns(armed_step, now_ns)
            if armed_step.phase is StepPhase.LOADING:
                until_ns = min(armed_step.t0_host_ns, self._quiet_loading_until_ns)
            elif armed_step.t0_host_ns - QUIET_BEFORE_T0_NS <= now_ns <= armed_step.t0_host_ns:
                until_ns = armed_step.t0_host_ns
        return until_ns if now_ns <= until_ns else None

    @property
    def _quiet_loading_until_ns(self) -> int:
        return self.polled_ns + QUIET_LOADING_NS

    def _quiet_turn_until_ns(self, present: ArmedStep, now_ns: int) -> int | None:
        """Return until when a moving controller is not polled because the following step is near: it begins that by its
        own program, or this adapter loads it."""
        following = self.following.armed_step
        if following is None:
            return None
        ends_ns = present.ends_host_ns
        from_ns = ends_ns - QUIET_TURN_NS - self.poll_takes_ns
        turn_ns = ends_ns + QUIET_TURN_NS if self.following.in_controller else self._quiet_loading_until_ns
        until_ns = min(turn_ns, following.t0_host_ns)
        return until_ns if from_ns <= now_ns <= until_ns else None
