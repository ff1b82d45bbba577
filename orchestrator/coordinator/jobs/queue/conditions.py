"""Conditions that the world decides before a job begins: e-stop, permits, controllers, references, motors.

The world makes a job wait; only its own file and the fleet file make it fail.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.view import SLOW_REMEDY
from orchestrator.coordinator.jobs.needs import find_needed_controllers
from orchestrator.coordinator.leadership.copies import CopyWatch
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import EPOCH_REMEDY, MAX_EPOCH_STEP
from orchestrator.model.names import split_name
from orchestrator.model.state import AxisState, ControllerState, EstopLatch
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.tree import iterate_steps

ADOPTION_NS = 3 * NS_PER_S  # for a new leader to receive the states of all controllers, and to adopt them
ESTOP_VISIBLE_NS = NS_PER_S  # after an e-stop, for every adapter to publish its latch
_SAFE = "make the machine safe, then `tutti reset`"


@dataclass(frozen=True, slots=True)
class Obstacle:
    """What keeps a job from beginning now. code: for programs. remedy: what a person can do about it."""

    code: str
    text: str
    remedy: str = ""
    asks: bool = True
    """Once it is gone, the job begins only by a word."""

    def describe(self) -> str:
        return f"{self.text}; {self.remedy}" if self.remedy else self.text


@dataclass(frozen=True, slots=True)
class ReceivedEstop:
    """An e-stop that was received. unseen: controllers whose states have not shown that latch yet; until then, and at
    most until `until_ns`, their states of before it count for nothing."""

    latch: EstopLatch
    until_ns: int
    unseen: set[str]


@dataclass(frozen=True, slots=True)
class JobNeeds:
    """What a job needs before its first step.

    controllers: those that no other job may use. moved: axes that it moves. enabled_before, referenced_before: axes
    that must be enabled, or referenced, before it begins, because no step of the job does that first. moves: it moves
    something, or switches a motor on.
    """

    controllers: frozenset[str]
    moved: tuple[str, ...] = ()
    enabled_before: frozenset[str] = frozenset()
    referenced_before: frozenset[str] = frozenset()
    moves: bool = False


def find_needs(fleet: Fleet, steps: list[Step]) -> JobNeeds:
    """What `steps` need before the first of them. Raises `UnknownName`."""
    enabled_axes, referenced_axes, moved_axes = set[str](), set[str](), dict[str, None]()
    enabled_before, referenced_before = set[str](), set[str]()
    for step in iterate_steps(steps):
        in_order = step.find_axes(fleet)
        axes = set(in_order)
        if step.enables:
            enabled_axes |= axes
        elif step.moves:
            moved_axes |= dict.fromkeys(in_order)
            if step.is_open:
                continue  # what it is asked for may enable and home them
            manual = {axis for axis in axes if fleet.axis(axis).enable == "manual"}
            enabled_before |= manual - enabled_axes
            if step.searches:
                referenced_axes |= axes
            else:
                referenced_before |= axes - referenced_axes
    return JobNeeds(
        find_needed_controllers(fleet, steps),
        tuple(moved_axes),
        frozenset(enabled_before),
        frozenset(referenced_before),
        any(step.moves or step.enables for step in iterate_steps(steps)),
    )


class WorldConditions:
    """Finds what the world must change before a job can begin."""

    def __init__(self, fleet: FleetAccess, copies: CopyWatch) -> None:
        self._copies = copies
        self._view = fleet.view
        self._leadership = fleet.requests.leadership
        self._permits = fleet.permits
        self._clock = fleet.clock
        self._estop: ReceivedEstop | None = None
        fleet.view.add_state_listener(self._note_latch)
        self._since_ns = fleet.clock.now_ns()

    @property
    def _asks(self) -> bool:
        """Whether the fleet file asks for a word once a cause is gone."""
        return self._view.fleet.queue.on_clear == "ask"

    def note_estop(self, latch: EstopLatch) -> None:
        """An e-stop was received: adapters publish that they have latched it a moment later."""
        until_ns = self._clock.now_ns() + ESTOP_VISIBLE_NS
        self._estop = ReceivedEstop(latch, until_ns, set(self._view.fleet.controllers))
        for state in self._view.arrived_states.values():  # of an e-stop that is sent again
            self._note_latch(state)

    def _note_latch(self, state: ControllerState) -> None:
        if self._estop is not None and state.estop is not None and state.estop.event == self._estop.latch.event:
            self._estop.unseen.discard(state.controller)

    def find_obstacle(self, needs: JobNeeds) -> Obstacle | None:
        """The first condition that does not hold; None: the job can begin."""
        missing_copy = self._copies.find_obstacle()
        if missing_copy is not None:
            # What would begin now is not known to the copy that may have to take over.
            return Obstacle("journal-copies", *missing_copy, asks=False)
        obstacle = self._find_obstacle(needs)
        if obstacle is None or obstacle.code == "permit":
            return obstacle
        # For a moment after the change of a leader it has not received every state, and adopts: that is no cause.
        is_new = self._clock.now_ns() < self._since_ns + ADOPTION_NS and obstacle.code in ("absent", "not-adopted")
        return replace(obstacle, asks=self._asks and not is_new and obstacle.code != "not-adopted")

    def _find_obstacle(self, needs: JobNeeds) -> Obstacle | None:
        estop = self._estop
        if needs.moves and estop and self._clock.now_ns() < estop.until_ns and needs.controllers & estop.unseen:
            return Obstacle("estop-latched", estop.latch.describe(), _SAFE)
        for controller in sorted(needs.controllers):
            obstacle = self._find_controller_obstacle(controller, moves=needs.moves)
            if obstacle is not None:
                return obstacle
        missing_permit = self._permits.find_missing(needs.moved)
        if missing_permit is not None:
            asks = self._permits.asks(needs.moved)
            return Obstacle("permit", missing_permit, "satisfy the permit", asks=asks)
        return self._find_axis_obstacle(needs.enabled_before, needs.referenced_before)

    def _find_controller_obstacle(self, controller: str, *, moves: bool) -> Obstacle | None:
        state = self._view.last_state(controller)
        slow_start = self._view.describe_slow_start(controller)
        if slow_start is not None:
            return Obstacle("absent", f"{controller}: {slow_start}", SLOW_REMEDY)
        if state is None or self._view.is_silent(controller):
            return Obstacle("absent", f"{controller}: its adapter does not answer", "is its adapter host running?")
        if moves and state.estop is not None:
            return Obstacle("estop-latched", state.estop.describe(), _SAFE)
        if state.mode == "offline":
            return Obstacle("offline", f"{controller} is offline{_first_fault(state)}", "check power and cable")
        epoch = self._leadership.epoch
        if self._view.adopted.get(controller) != state.instance or state.epoch != epoch:
            refusal = self._view.find_refusal(controller)
            if refusal is not None:
                return Obstacle(refusal.code, refusal.text, refusal.remedy)
            # For a moment, as a rule: after a change of the leader, or a restart of the adapter.
            is_far = abs(state.epoch - epoch) > MAX_EPOCH_STEP
            remedy = EPOCH_REMEDY if is_far else "wait; if it stays so, the coordinator's log says why"
            return Obstacle("not-adopted", f"{controller} is not adopted by this coordinator yet", remedy)
        if moves and state.faults:
            first = state.faults[0]
            return Obstacle("fault", f"{controller}: {first.text}", first.remedy)
        return None

    def _find_axis_obstacle(self, enabled: Iterable[str], referenced: Iterable[str]) -> Obstacle | None:
        # All of them at once: one command is enough.
        off = [axis for axis in sorted(enabled) if not (axis_now := self._find_axis(axis)) or not axis_now.enabled]
        if off:
            return Obstacle("not-enabled", _join(off, "not enabled"), f"enable: `tutti axis enable {' '.join(off)}`")
        lost_axes = [
            axis for axis in sorted(referenced) if not (axis_now := self._find_axis(axis)) or not axis_now.referenced
        ]
        if lost_axes:
            names = dict.fromkeys(map(self._view.fleet.virtual_axes.name_whole, lost_axes))
            return Obstacle(
                "not-referenced", _join(lost_axes, "not referenced"), f"home: `tutti axis home {' '.join(names)}`"
            )
        return None

    def _find_axis(self, axis: str) -> AxisState | None:
        controller, name = split_name(axis)
        state = self._view.last_state(controller)
        return None if state is None else state.axes.get(name)


def _join(axes: list[str], state: str) -> str:
    return f"{', '.join(axes)} {'is' if len(axes) == 1 else 'are'} {state}"


def _first_fault(state: ControllerState) -> str:
    return f" ({state.faults[0].text})" if state.faults else ""
