"""Permits: conditions that must hold, and must have held for a settling time, before axes move; their loss stops
motion."""

from collections.abc import Callable, Iterable

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.coordinator.fleet.listening import Remove, add_to
from orchestrator.coordinator.fleet.pairs import PairLoss, PairMonitor
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Permit
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.report import MissingPermit
from orchestrator.model.state import ControllerState


class PermitMonitor:
    """Evaluates the permits of the fleet file with every state that arrives."""

    def __init__(self, view: FleetView, clock: Clock, pairs: PairMonitor) -> None:
        """pairs: a pair that must stop counts as a loss, for all that moves its axes."""
        self._view = view
        self._pairs = pairs
        self._clock = clock
        self._since_ns: dict[str, int | None] = {}
        self._losses: dict[str, int] = {}
        self._listeners: list[Callable[[], None]] = []
        self.on_change: Callable[[], None] = _ignore_change
        """Called when a permit is lost or holds again."""
        view.add_state_listener(self._take_state)
        pairs.add_loss_listener(lambda pair, loss: self._notify_listeners())

    def add_loss_listener(self, listener: Callable[[], None]) -> Remove:
        """Call `listener` when a permit or a pair is lost; the result removes the listener."""
        return add_to(self._listeners, listener)

    def find_missing(self, axes: Iterable[str]) -> str | None:
        """The first permit of `axes` that does not hold, or has not settled yet, in words."""
        for name, permit in self._view.fleet.permits_of(axes).items():
            text = self._describe_missing(name, permit)
            if text is not None:
                return text
        return None

    def require(self, axes: Iterable[str]) -> None:
        """Raise `Refusal` unless all permits of `axes` hold, and have settled."""
        _refuse_without(self.find_missing(axes))

    def asks(self, axes: Iterable[str]) -> bool:
        """Whether a job that waits for permits of `axes` begins only by a word once they hold: one of those that do
        not asks for it."""
        fleet = self._view.fleet
        missing_permits = [
            permit
            for name, permit in fleet.permits_of(axes).items()
            if self._describe_missing(name, permit) is not None
        ]
        return any((permit.on_clear or fleet.queue.on_clear) == "ask" for permit in missing_permits)

    def list_missing(self) -> list[MissingPermit]:
        """All permits that do not hold, or have not settled yet, with their axes."""
        fleet, permits = self._view.fleet, list[MissingPermit]()
        for name, permit in fleet.permits.items():
            text = self._describe_missing(name, permit)
            if text is not None:
                axes = [axis for axis in fleet.axis_names if name in fleet.permits_of([axis])]
                permits.append(MissingPermit(name=name, axes=axes, text=text))
        return permits

    def _describe_missing(self, name: str, permit: Permit) -> str | None:
        words = self._describe_broken(name, permit)
        if words is not None:
            return f"permit {name} does not hold: {words}"
        if permit.settle:
            since_ns = self._since_ns.get(name)
            held_ns = 0 if since_ns is None else self._clock.now_ns() - since_ns
            if held_ns < permit.settle:
                settle_s = permit.settle / NS_PER_S
                return f"permit {name} ({held_ns / NS_PER_S:.1f} of {settle_s:g} s): it has not settled yet"
        return None

    def watch_losses(self, axes: Iterable[str]) -> "PermitWatch":
        """Watch the permits of `axes` for losses from now on."""
        axes = tuple(axes)
        return PermitWatch(self, self._pairs, axes, self.count_losses(axes), self._pairs.count_losses(axes))

    def count_losses(self, axes: Iterable[str]) -> int:
        """The number of times that permits of `axes` have been lost since the start; a flicker counts too."""
        return sum(self._losses.get(name, 0) for name in self._view.fleet.permits_of(axes))

    def find_broken(self, axes: Iterable[str]) -> str | None:
        """The first permit of `axes` that does not hold now, in words."""
        for name, permit in self._view.fleet.permits_of(axes).items():
            words = self._describe_broken(name, permit)
            if words is not None:
                return f"permit {name} is lost: {words}"
        return None

    def _describe_broken(self, name: str, permit: Permit) -> str | None:
        controller, point = split_name(permit.input)
        state = self._view.last_state(controller)
        is_known = state is not None and not self._view.is_silent(controller) and state.mode != "offline"
        if is_known and state is not None and state.inputs.get(point) == permit.value:
            return None
        if not is_known:
            return f"input {permit.input} is unknown: its controller is silent"
        return f"input {permit.input} is {'inactive' if permit.value else 'active'}"

    def _take_state(self, state: ControllerState) -> None:
        is_lost = False
        for name, permit in self._view.fleet.permits.items():
            if controller_of(permit.input) != state.controller:
                continue
            was_held = self._since_ns.get(name) is not None
            holds = self._describe_broken(name, permit) is None
            if holds and not was_held:
                now_ns = self._since_ns[name] = self._clock.now_ns()
                self._clock.call_at_ns(now_ns + permit.settle + 1, self.on_change)
            elif was_held and not holds:
                self._since_ns[name] = None
                self._losses[name] = self._losses.get(name, 0) + 1
                is_lost = True
            if holds != was_held:
                self.on_change()
        if is_lost:
            self._notify_listeners()

    def _notify_listeners(self) -> None:
        for listener in list(self._listeners):
            listener()


def _ignore_change() -> None:
    return None


class PermitWatch:
    """Reports whether permits, or pairs of axes, have been lost since it was made."""

    def __init__(
        self, permits: PermitMonitor, pairs: PairMonitor, axes: tuple[str, ...], losses: int, pair_losses: int
    ) -> None:
        self._permits = permits
        self._pairs = pairs
        self._axes = axes
        self._losses = losses
        self._pair_losses = pair_losses

    def describe_loss(self) -> str | None:
        """A description of what was lost, also if it holds again; None if all have held."""
        broken_permit = self._permits.find_broken(self._axes)
        if broken_permit is not None:
            return broken_permit
        if self._permits.count_losses(self._axes) != self._losses:
            return "a permit was lost for a moment"
        loss = self._find_pair_loss()
        return None if loss is None else loss.text

    def make_refusal(self, activity: str) -> Refusal:
        """The refusal of what was lost. activity: what to do again then, in words."""
        loss, text = self._find_pair_loss(), self.describe_loss() or ""
        if loss is not None and loss.text == text:
            return Refusal("pair", text, f"{loss.remedy}, then {activity} again")
        return Refusal("permit", text, f"satisfy the permit, then {activity} again")

    def _find_pair_loss(self) -> PairLoss | None:
        is_lost = self._pairs.count_losses(self._axes) != self._pair_losses
        return self._pairs.find_last_loss(self._axes) if is_lost else None

    def require_held(self) -> None:
        """Raise `Refusal` unless all have held."""
        _refuse_without(self.describe_loss())


def _refuse_without(missing_permit: str | None) -> None:
    if missing_permit is not None:
        raise Refusal("permit", missing_permit, "satisfy the permit, then resubmit the job")
