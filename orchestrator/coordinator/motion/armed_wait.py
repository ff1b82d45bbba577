"""The wait of a motion that is loaded: for a request or an input, as long as everything stays as it was armed."""

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.fleet.permits import PermitWatch
from orchestrator.coordinator.motion.planning import PlannedStep
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.model.errors import Refusal
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.numbers import format_ns
from orchestrator.model.state import AxisState, ControllerEvent, ControllerState
from orchestrator.model.steps.armed_terms import ArmedTerms

LOOK_NS = 50 * NS_PER_MS  # between two looks at members that may have fallen silent
ARRIVING_NS = 5 * NS_PER_MS  # a state may have been made this much before the answer that it is armed was sent
PUSHED_COUNTS = 10  # by which an axis may stand elsewhere: a motor that holds its place is not still
REMEDY = "find the cause, then submit the job again"


@dataclass(frozen=True, slots=True)
class GoOrder:
    """What ends a wait with a start. go_fleet_ns: when it came. at_fleet_ns: T0 that it asks for; None: as soon as all
    members can. settled: T0, once it is agreed, or the refusal."""

    by: Literal["input", "request"]
    go_fleet_ns: int
    at_fleet_ns: int | None = None
    settled: "asyncio.Future[int]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class ArmedWait:
    """The wait of one armed step. wake: of a change that ends it or may end it."""

    def __init__(
        self, services: MotionServices, planned: PlannedStep, members: Iterable[str], permit_watch: PermitWatch
    ) -> None:
        assert planned.request.wait is not None
        self.terms: ArmedTerms = planned.request.wait
        self.order: GoOrder | None = None
        self._view = services.fleet.view
        self._leadership = services.leadership
        self._planned = planned
        self._members = frozenset(members)
        self._permit_watch = permit_watch
        self._permits = services.fleet.permits
        self._changed = asyncio.Event()
        self._cause: Refusal | None = None
        self._armed_ns: int | None = None
        self.began_ns = 0
        self._before: dict[str, AxisState] = {}
        self._input_active: bool | None = None
        self._removals: list[Callable[[], None]] = []

    # The wait

    def begin(self) -> None:
        """The wait begins now. Raises `Refusal` for an input that has its level already, or is not known."""
        self.began_ns = self._leadership.fleet_now_ns()
        inputs = [] if self.terms.input is None else [controller_of(self.terms.input)]
        self._removals = [
            self._view.add_event_listener(self._take_event),
            self._view.add_state_listener(self._take_state, self._members.union(inputs)),
            self._permits.add_loss_listener(self._changed.set),
        ]
        self._input_active = self._read_input()
        if self.terms.input is None or self._input_active != self.terms.value:
            return
        if not self.terms.level:
            level = "active" if self.terms.value else "inactive"
            text = f"input {self.terms.input} is {level} already when the wait begins"
            raise Refusal("input-active", text, "switch it back before, or allow it with `level: true`")
        self._give_order("input", self.began_ns)

    def close(self) -> None:
        """Listen to nothing any more."""
        for remove in self._removals:
            remove()
        self._removals = []
        if self.order is not None and not self.order.settled.done():
            self.order.settled.set_exception(Refusal("not-armed", "the wait has ended before the start", REMEDY))
            self.order.settled.exception()  # an input does not wait for it

    @property
    def ends_ns(self) -> int:
        """The end of the wait, fleet time."""
        return self.began_ns + self.terms.timeout_ns

    @property
    def words(self) -> str:
        """What it waits for."""
        return "waits for go" if self.terms.input is None else f"waits for input {self.terms.input}, or go"

    def give_go(self, at_fleet_ns: int | None) -> GoOrder:
        """A request to start. Raises `Refusal`."""
        if self.order is not None:
            raise Refusal("begun", "the step was started already", "")
        self._give_order("request", self._leadership.fleet_now_ns(), at_fleet_ns)
        assert self.order is not None
        return self.order

    def note_pause(self) -> None:
        """The step was paused: the caller has recorded by what."""
        self._changed.set()

    def note_armed(self) -> None:
        """All members are armed; what they report from now on counts."""
        self._armed_ns = self._leadership.fleet_now_ns()

    def note_unloading(self) -> None:
        """The members are about to be unloaded, and armed again."""
        self._armed_ns = None

    async def wait_for_order(self, find_due_ns: Callable[[], int]) -> GoOrder | None:
        """The order to start; None when it is due that the members are armed anew. find_due_ns: returns until when to
        wait, fleet time; an order with an instant changes that. Raises `Refusal` as soon as anything is not as it was
        armed, and at the end of the wait."""
        while True:
            self._changed.clear()
            self._require_unchanged()
            now_ns, until_ns = self._leadership.fleet_now_ns(), find_due_ns()
            if self.order is not None and (self.order.at_fleet_ns is None or now_ns >= until_ns):
                return self.order
            if self.order is None and now_ns >= self.ends_ns:
                text = f"{self.words}: that did not come within {format_ns(self.terms.timeout_ns)}"
                raise Refusal("wait-timeout", text, "allow more with `timeout`, or submit the job again")
            if now_ns >= until_ns:
                return None
            ends_ns = until_ns if self.order is not None else min(until_ns, self.ends_ns)
            try:
                async with asyncio.timeout(min(LOOK_NS, ends_ns - now_ns) / NS_PER_S):
                    await self._changed.wait()
            except TimeoutError:
                continue

    # Causes

    def _require_unchanged(self) -> None:
        if self._cause is not None:
            raise self._cause
        self._permit_watch.require_held()
        if self._leadership.over:
            raise Refusal("leadership-lost", "another coordinator has taken over")
        for member in sorted(self._members):
            absence = self._view.describe_absence(member, self._planned.instances.get(member))
            if absence is not None:
                raise Refusal("absent", f"{member}: {absence}, while the step waited armed", REMEDY, member)
        if self.terms.input is not None and self.order is None:
            self._read_input()

    def _note_cause(self, code: str, member: str, text: str) -> None:
        if self._cause is None:
            self._cause = Refusal(code, f"{member}: {text}, while the step waited armed", REMEDY, member)
        self._changed.set()

    def _take_event(self, event: ControllerEvent) -> None:
        request = self._planned.request
        if (event.job, event.step) != (request.job_id, request.index) or self._armed_ns is None:
            return
        is_stale = event.kind == "disarmed" and event.fleet_ns is not None and event.fleet_ns < self._armed_ns
        if event.kind in ("failed", "stopped", "disarmed") and not is_stale:
            self._note_cause("stopped", event.controller, event.text)

    def _take_state(self, state: ControllerState) -> None:
        if self.terms.input is not None and controller_of(self.terms.input) == state.controller:
            self._take_input(state)
        if state.controller not in self._members or self._armed_ns is None:
            return
        if state.fleet_ns is None or state.fleet_ns < self._armed_ns + ARRIVING_NS:
            return
        if state.estop is not None:
            self._note_cause("estop-latched", state.controller, f"e-stop by {state.estop.actor}")
        elif state.faults:
            self._note_cause(state.faults[0].code, state.controller, state.faults[0].text)
        elif state.mode not in ("armed", "committed", "moving"):
            self._note_cause("not-armed", state.controller, f"it is {state.mode}, not armed any more")
        for name, axis in state.axes.items():
            full_name = f"{state.controller}.{name}"
            if full_name in self._planned.plan.profiles:
                self._compare_axis(full_name, self._before.setdefault(full_name, axis), axis)

    def _compare_axis(self, name: str, before: AxisState, now: AxisState) -> None:
        config = self._view.fleet.axis(name)
        off_counts = max(abs(now.commanded_counts - before.commanded_counts), abs(now.raw_counts - before.raw_counts))
        window = 0.0 if config.in_position_window is None else config.in_position_window * abs(float(config.scale))
        allowed_counts = max(PUSHED_COUNTS, window)
        if off_counts > allowed_counts:
            text = f"axis {name} was moved by {config.to_length(off_counts):g} {config.unit}"
        elif now.limit not in ("none", before.limit):
            text = f"axis {name} is at its {now.limit} limit switch"
        elif before.enabled and not now.enabled:
            text = f"the motor of axis {name} was switched off"
        elif before.referenced and not now.referenced:
            text = f"axis {name} has lost its reference"
        else:
            return
        self._note_cause("axis-changed", controller_of(name), text)

    # The input

    def _read_input(self) -> bool | None:
        """The level of the input; None without one. Raises `Refusal` when it is not known."""
        if self.terms.input is None:
            return None
        controller, point = split_name(self.terms.input)
        state = self._view.last_state(controller)
        if state is None or state.mode == "offline" or self._view.is_silent(controller) or point not in state.inputs:
            text = f"input {self.terms.input} is unknown: its controller is silent or offline"
            raise Refusal("absent", text, "check its link, then submit the job again", controller)
        return state.inputs[point]

    def _take_input(self, state: ControllerState) -> None:
        assert self.terms.input is not None
        is_active = state.inputs.get(split_name(self.terms.input)[1])
        if is_active is None:
            return
        was_active, self._input_active = self._input_active, is_active
        if self.order is None and is_active == self.terms.value and was_active not in (None, is_active):
            self._give_order("input", state.read_fleet_ns or self._leadership.fleet_now_ns())

    def _give_order(self, by: Literal["input", "request"], go_ns: int, at_fleet_ns: int | None = None) -> None:
        self.order = GoOrder(by, go_ns, at_fleet_ns)
        self._changed.set()
