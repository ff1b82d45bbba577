"""The trigger output in a step: lowered with it, set before it, ended after it, and what it did in between.

It is set and ended at rest only (L5411, L5430). So a stop leaves it set until the axes stand: while they brake, pulses
come on. Whatever moves an axis next ends it first.
"""

from dataclasses import replace
from math import floor

from adapters.contract import HostInterval, SwitchedOutput
from adapters.shrc203.costs import trigger_cost_ns
from adapters.shrc203.loaded import ArmedMove
from adapters.shrc203.lowering import ConnectionTraits, ShrcLowered
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.pulses import GRAIN, PulseTrigger, fit_trigger
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import NOT_SET, STATUS, parse_status
from orchestrator.clock.base import NS_PER_US, Clock
from orchestrator.clock.inferred import InferredClock
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import OutputTrigger
from orchestrator.model.profile import Profile


def add_trigger(
    lowered: ShrcLowered,
    config: Controller,
    options: ShrcOptions,
    traits: ConnectionTraits,
    pulsed: tuple[OutputTrigger, Profile],
) -> ShrcLowered:
    """Return the lowered step with its trigger, and the interval of its pulses. pulsed: with the profile of its axis,
    `traits.pulsed`. Raises `Refusal`."""
    trigger_request, profile = pulsed
    if lowered.wait is not None or lowered.drive is not None:
        raise Refusal(
            "start-class", "a step with triggers starts by a command, not by a trigger line", "remove `start`"
        )
    move = next(move for move in lowered.moves if move.name == trigger_request.axis)
    if move.motor in traits.closed_loop:
        raise Refusal(
            "trigger-loop",
            f"axis {trigger_request.axis} is in closed loop, where corrections are drive pulses, too",
            "set `loop: open` in the options of the controller",
        )
    trigger = fit_trigger(config, options, profile, trigger_request, move.running_shape.motion_legs)
    terms = trigger.find_terms(trigger_request.instants_ns, traits.known.rate.clock_factor, lowered.clock_ppm, options)
    arm_ns = lowered.costs.arm_ns + trigger_cost_ns(options, traits.char_ns)
    return replace(
        lowered,
        trigger=trigger,
        triggers={trigger.output: (*lowered.terms, *terms)},
        costs=lowered.costs.model_copy(update={"arm_ns": arm_ns}),
        commands=(trigger.command, *lowered.commands),
    )


class ShrcTriggers:
    """The trigger output in the steps of one connection."""

    def __init__(self, options: ShrcOptions, clock: Clock, crystal: InferredClock, unit: ShrcState) -> None:
        self._delay_ns = options.trigger_delay_us * NS_PER_US
        self._clock = clock
        self._crystal = crystal
        self._unit = unit
        self._last: tuple[PulseTrigger, ArmedMove] | None = None

    async def begin(self, trigger: PulseTrigger, move: ArmedMove) -> None:
        """Set the output at rest, and read it back: it counts from here. Raises `Refusal`."""
        self._last = (trigger, move)
        self._unit.trigger_set = True
        self._unit.readings.clear()
        await self._unit.session.send_setting(trigger.command)
        reply = await self._unit.session.send_query("?:T", NOT_SET)
        if reply != trigger.loaded_reply:
            raise Refusal(
                "not-loaded", f"the trigger output is set to {reply} instead of {trigger.loaded_reply}", "arm it again"
            )

    def forget(self) -> None:
        """Forget the last step with a trigger: another one is armed."""
        self._last = None

    async def take(self) -> dict[str, SwitchedOutput]:
        """Return what the output did in the last step, from its start and from where the axis came to rest. Raises
        `Refusal`."""
        if self._last is None:
            return {}
        trigger, move = self._last
        states = parse_status(await self._unit.session.send_query("Q:SPC", STATUS), self._unit.controllable)
        if await self._unit.is_restarted():
            return {trigger.output: SwitchedOutput((), unknown=move.released)}
        axis, end = (
            states[trigger.motor],
            next(axis_move for axis_move in move.lowered.moves if axis_move.motor == trigger.motor),
        )
        if axis.is_busy:
            raise Refusal("moving", f"axis {trigger.axis} is still moving", "wait for the end of the motion")
        if axis.counts == end.end_counts and move.started is not None:
            return {trigger.output: SwitchedOutput([self._find_edge(move.start, span_s) for span_s in trigger.spans_s])}
        travelled_counts = (axis.counts - end.start_counts) * end.sign
        sure, possible = (max(0, floor((travelled_counts + grain) / trigger.interval)) for grain in (-GRAIN, GRAIN))
        edges = [self._find_slow_edge(trigger, move, number) for number in range(min(sure, len(trigger.spans_s)))]
        return {trigger.output: SwitchedOutput(edges, unknown=possible > sure)}

    def _find_edge(self, start: HostInterval, span_s: tuple[float, float]) -> HostInterval:
        """Return the interval of a pulse of a move that was not disturbed: its start, and the time of the drive pulse
        by the crystal."""
        rate, now_ns = self._crystal.crystal_rate, self._clock.now_ns()
        early_ns, _ = rate.host_duration_ns(span_s[0], now_ns)
        _, late_ns = rate.host_duration_ns(span_s[1], now_ns)
        return HostInterval(start.earliest_ns + early_ns, start.latest_ns + late_ns + self._delay_ns)

    def _find_slow_edge(self, trigger: PulseTrigger, move: ArmedMove, number: int) -> HostInterval:
        """Return the interval of a pulse of a move that came to rest early: from some instant on it was slower than
        planned. The pulse is between the readings that show the axis before it and behind it."""
        axis = next(axis_move for axis_move in move.lowered.moves if axis_move.motor == trigger.motor)
        # Where the start itself was not seen, it is at least no earlier than promised.
        first_ns, last_ns = move.lowered.window_ns
        start = move.started or HostInterval(move.t0_ns + first_ns, move.t0_ns + last_ns)
        earliest_ns = self._find_edge(start, trigger.spans_s[number]).earliest_ns
        latest_ns, position = self._clock.now_ns(), (number + 1) * trigger.interval
        for reading in self._unit.readings:
            travelled_counts = (reading.counts[trigger.motor] - axis.start_counts) * axis.sign
            if travelled_counts <= position - GRAIN:
                earliest_ns = max(earliest_ns, reading.asked_ns)
            elif travelled_counts >= position + GRAIN:
                latest_ns = min(latest_ns, reading.at_ns + self._delay_ns)
        return HostInterval(min(earliest_ns, latest_ns), latest_ns)
