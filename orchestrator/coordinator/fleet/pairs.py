"""The watch on pairs: two axes that carry one beam are stopped when they are farther apart than they may be."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.coordinator.fleet.view import FleetView, find_answering_states
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.operation.pair_state import PairState, observe_pair
from orchestrator.model.state import AxisState, ControllerState
from orchestrator.model.virtual_maps import Pair
from orchestrator.plan.pairs import find_homing_speed

BEYOND_READINGS = 4
"""So many times in succession the best estimate is beyond `max_deviation`: then the pair is stopped although it might
still be within it. They are of two polls of each axis: an estimate that is wrong while the pair accelerates is right
again when the next reading of the other axis comes."""
AGAIN_NS = NS_PER_S  # after which a pair that still moves is stopped again
ROUNDED_COUNTS = 2


@dataclass(frozen=True, slots=True)
class PairLoss:
    """Why a pair was stopped. remedy: what to do about it."""

    text: str
    remedy: str


@dataclass(slots=True)
class _PairWatch:
    """What is known of a pair. rest: its deviation when both were at rest last. base: the deviation from which it
    counts while the axes are not referenced. last: the last reading of each axis, with its instant. beyond: how many
    estimates in succession were beyond the limit."""

    rest: float | None = None
    base: float | None = None
    last: dict[str, tuple[int, AxisState]] = field(default_factory=dict[str, tuple[int, AxisState]])
    beyond: int = 0
    stopped_ns: int | None = None
    losses: int = 0
    loss: PairLoss | None = None

    def find_limit(self, observed: PairState) -> float:
        """How far the pair may be apart while it moves: farther where it was racked at rest, so that it can be
        squared."""
        rest_rack = abs(self.rest) if observed.known and self.rest is not None else 0.0
        return observed.max_deviation + (rest_rack if rest_rack > observed.max_deviation else 0.0)


class PairMonitor:
    """Looks at a pair with every state of one of its controllers that arrives.

    A pair that moves is lost when its deviation is surely beyond `max_deviation`, or probably for `BEYOND_READINGS`
    readings; or when one of its axes has a fault, or does not answer, while the other one moves. One that was racked
    farther at rest may move as far again, so that it can be squared. While its axes are not referenced, both count
    from where they stood when they were at rest last: the ways of a homing may differ by `max_deviation`.
    """

    def __init__(self, view: FleetView, clock: Clock) -> None:
        self._view = view
        self._clock = clock
        self._watches: dict[str, _PairWatch] = {}
        self._listeners: list[Callable[[Pair, PairLoss], None]] = []
        view.add_state_listener(self._take_state)

    def add_loss_listener(self, listener: Callable[[Pair, PairLoss], None]) -> None:
        """Call `listener` when a pair must stop."""
        self._listeners.append(listener)

    def count_losses(self, axes: Iterable[str]) -> int:
        """How often pairs of `axes` have been lost since the start."""
        return sum(watch.losses for watch in self._find_watches(axes))

    def find_last_loss(self, axes: Iterable[str]) -> PairLoss | None:
        """Why a pair of `axes` was stopped last."""
        return next((watch.loss for watch in self._find_watches(axes) if watch.loss is not None), None)

    def _find_watches(self, axes: Iterable[str]) -> list[_PairWatch]:
        pair_of = self._view.fleet.virtual_axes.pair_of
        groups = dict.fromkeys(pair_of[axis].group for axis in axes if axis in pair_of)
        return [self._watches[group] for group in groups if group in self._watches]

    def _take_state(self, state: ControllerState) -> None:
        for pair in self._view.fleet.virtual_axes.find_pairs(state.controller):
            self._look(pair)

    def _look(self, pair: Pair) -> None:
        watch = self._watches.setdefault(pair.group, _PairWatch())
        states = find_answering_states(self._view, pair.real)
        text, observed_pair = _describe_lost(pair, states), observe_pair(self._view.fleet, pair, states)
        if observed_pair is not None:
            self._follow(pair, watch, states)
            text = text or self._describe_apart(pair, watch, states, observed_pair)
        if text is not None:
            is_counted = observed_pair is not None and observed_pair.known
            remedy = pair.square_remedy if is_counted else f"find out why; then home {pair.middle} again"
            self._lose(pair, watch, PairLoss(text, remedy))

    def _follow(self, pair: Pair, watch: _PairWatch, states: dict[str, ControllerState]) -> None:
        """Keep the base where a controller has set a counter to another value: a homing does."""
        row = self._view.fleet.virtual_axes.maps[pair.group].find_rows((0.0, 0.0))[1]
        for name, factor in zip(pair.real, row, strict=True):
            controller, axis_name = split_name(name)
            state, ends = states[controller].axes[axis_name], states[controller].read_within
            assert ends is not None, "the pair was observed"
            read_ns = (ends.earliest_ns + ends.latest_ns) // 2
            if name in watch.last and watch.base is not None:
                last_ns, last_state = watch.last[name]
                config = self._view.fleet.axis(name)
                fastest = max(abs(last_state.velocity), abs(state.velocity), find_homing_speed(config))
                seconds = max(read_ns - last_ns, 0) / NS_PER_S
                change = state.position - last_state.position
                jump = change - (last_state.velocity + state.velocity) / 2 * seconds
                if abs(jump) > fastest * seconds + abs(config.to_length(ROUNDED_COUNTS)):
                    watch.base += jump * factor
            watch.last[name] = read_ns, state

    def _describe_apart(
        self, pair: Pair, watch: _PairWatch, states: dict[str, ControllerState], observed: PairState
    ) -> str | None:
        """Why the pair must stop by where its axes are; None: it need not."""
        axes = [states[controller_of(name)].axes[split_name(name)[1]] for name in pair.real]
        if watch.base is None or not any(axis.moving or axis.homing for axis in axes):
            watch.base = observed.deviation
        if not any(axis.moving for axis in axes):
            watch.rest, watch.beyond = (observed.deviation if observed.known else None), 0
            return None
        base = 0.0 if observed.known else watch.base
        limit = watch.find_limit(observed)
        watch.beyond = watch.beyond + 1 if abs(observed.deviation - base) > limit else 0
        if not observed.is_beyond(limit, base) and watch.beyond < BEYOND_READINGS:
            return None
        places = " and ".join(
            f"{name} at {axis.position:.4g} {axis.unit}" for name, axis in zip(pair.real, axes, strict=True)
        )
        since_text = "" if observed.known else " since they began to search for their references"
        return (
            f"{pair.group}: {places} came {abs(observed.deviation - base):.3g} {pair.unit} apart{since_text}; at most "
            f"{limit:.3g} are allowed (max_deviation)"
        )

    def _lose(self, pair: Pair, watch: _PairWatch, loss: PairLoss) -> None:
        now_ns = self._clock.now_ns()
        if watch.stopped_ns is not None and now_ns < watch.stopped_ns + AGAIN_NS:
            return
        watch.stopped_ns, watch.loss = now_ns, loss
        watch.losses += 1
        for listener in list(self._listeners):
            listener(pair, loss)


def _describe_lost(pair: Pair, states: dict[str, ControllerState]) -> str | None:
    """Why the pair must stop because one of its axes cannot be watched, or stands by a fault, while the other one
    moves."""
    for name, partner in (pair.real, pair.real[::-1]):
        controller, axis = split_name(partner)
        if controller not in states or states[controller].mode == "offline":
            continue
        if axis not in states[controller].axes or not states[controller].axes[axis].moving:
            continue
        cause = _find_cause(name, states.get(controller_of(name)))
        if cause is not None:
            return f"{pair.group}: {cause} while {partner} moves"
    return None


def _find_cause(name: str, state: ControllerState | None) -> str | None:
    controller, axis_name = split_name(name)
    if state is None:
        return f"{controller} is silent"
    if state.mode == "offline" or axis_name not in state.axes:
        return f"{controller} is offline"
    axis = state.axes[axis_name]
    if state.faults:
        return f"{controller} has a fault ({state.faults[0].text})"
    if axis.fault is not None or not axis.enabled:
        return f"{name} is off ({axis.fault or 'not enabled'})"
    return None
