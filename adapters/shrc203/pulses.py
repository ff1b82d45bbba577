"""Which triggers of a step the trigger output can give, and the interval of each: a pulse every whole number of drive
pulses of one axis (T:P, L5388-L5411).

The manual states no instant from which the others count. T:T (L5366) pulses in time, but from when it is set, which is
before the start, and it cannot be ended while an axis moves (L5386, L5430): pulses would come before the start, and on
after a stop. T:E (L5449) follows a scale, whose distance to the plan is not known beforehand.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from adapters.shrc203.fleetaxes import OUTPUTS, TRIGGER_NUMBER, motor_number
from adapters.shrc203.options import ShrcOptions
from adapters.toolkit.wired_points import find_driven_output
from orchestrator.clock.base import NS_PER_S, NS_PER_US
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.messages import BudgetTerm, OutputTrigger, TriggerDrive
from orchestrator.model.numbers import format_ns
from orchestrator.model.profile import Profile

INTERVAL_LEAST, INTERVAL_MOST = 2, 30_000  # drive pulses (L5404)
SPEED_MOST = 56_000  # pls/s; above it a trigger may be missing (L5394)
GRAIN = 1.0  # drive pulses: the manual does not state where within its last one a trigger comes
_ROUNDED = 0.5  # of a drive pulse: targets are rounded to whole ones

Legs = Sequence[tuple[float, float, float]]
"""Duration (s), speed at its start (pls/s) and acceleration (pls/s²) of each leg, by the controller's crystal."""


@dataclass(frozen=True, slots=True)
class PulseTrigger:
    """The trigger of a step: a pulse of `output` every `interval` drive pulses of `axis`.

    spans_s: by trigger, when the drive pulse comes at the earliest and at the latest, after the start, by the
    controller's crystal. duration_s: of the move.
    """

    output: str
    axis: str
    motor: int
    interval: int
    spans_s: tuple[tuple[float, float], ...]
    duration_s: float

    @property
    def command(self) -> str:
        """The command that sets it."""
        return f"T:P{self.motor}P{self.interval}"

    @property
    def loaded_reply(self) -> str:
        """The answer to `?:T` when it is set (L2149-L2177)."""
        return f"0,{self.motor},{self.interval}"

    def find_terms(
        self, instants_ns: Sequence[int], factor: float, ppm: float, options: ShrcOptions
    ) -> tuple[BudgetTerm, ...]:
        """The interval of a pulse relative to its instant, beside that of the start: the executed move and its drive
        pulses against the plan, the crystal, and the output. factor: seconds of the crystal per host second."""
        pairs = list(zip(self.spans_s, instants_ns, strict=True))
        clock_ns = math.ceil(self.duration_s / factor * NS_PER_S * ppm * 1e-6)
        return (
            BudgetTerm(
                name="quantisation",
                earliest_ns=min(math.floor(early / factor * NS_PER_S) - at_ns for (early, _), at_ns in pairs),
                latest_ns=max(math.ceil(late / factor * NS_PER_S) - at_ns for (_, late), at_ns in pairs),
            ),
            BudgetTerm(name="clock", earliest_ns=-clock_ns, latest_ns=clock_ns),
            BudgetTerm(name="output", earliest_ns=0, latest_ns=options.trigger_delay_us * NS_PER_US),
        )


def require_trigger(
    config: Controller, options: ShrcOptions, profiles: Mapping[str, Profile], triggers: Sequence[OutputTrigger]
) -> str:
    """Return the axis whose drive pulses the one trigger of a step follows. Raises `Refusal` for a trigger that the
    output cannot give, whatever the move."""
    trigger, *more = triggers
    if more:
        raise Refusal(
            "trigger-many",
            f"outputs {trigger.output} and {more[0].output}: the SHRC-203 has one trigger output",
            "leave one trigger, and wire its output to both devices",
        )
    drive = TriggerDrive(output=trigger.output, active_ns=trigger.pulse_ns)
    if (number := find_driven_output(config, drive).number) != TRIGGER_NUMBER:
        raise Refusal(
            "no-triggers",
            f"output {trigger.output} is OUT{number}: the SHRC-203 switches OUT1 to OUT{OUTPUTS[-1]} by commands only",
            f"connect the device to its trigger output, `number: {TRIGGER_NUMBER}` in the fleet file; or use an output "
            "of an SMC-4000, or of an SMC-2000 with a port of its own",
        )
    _require_width(trigger, options)
    axis = trigger.axis
    if axis is None:
        raise Refusal(
            "trigger-time",
            f"output {trigger.output}: the SHRC-203 has triggers at positions of its own axes only; those in time "
            "would begin before the start, and could not be ended while an axis moves",
            "write `every: DISTANCE` with `of:` an axis of this controller, or use an output of an SMC-4000 or an "
            "SMC-2000",
        )
    profile = profiles.get(axis)
    if profile is None or profile.end_counts == profile.start_counts:
        raise Refusal("trigger-axis", f"output {trigger.output}: axis {axis} does not move", "name an axis that moves")
    return axis


def _require_width(trigger: OutputTrigger, options: ShrcOptions) -> None:
    width_ns = options.trigger_width_us * NS_PER_US
    if not trigger.pulse_ns or trigger.pulse_ns > width_ns:
        pulse_text = f"pulses of {format_ns(trigger.pulse_ns)}" if trigger.pulse_ns else "a level"
        raise Refusal(
            "trigger-pulse",
            f"output {trigger.output}: {pulse_text} asked for; the trigger output gives pulses of {format_ns(width_ns)}"
            " (memory switch TRG WIDTH, option `trigger_width_us`)",
            f"write `pulse: {format_ns(width_ns)}`, or have the device take the edge",
        )


def fit_trigger(
    config: Controller, options: ShrcOptions, profile: Profile, trigger: OutputTrigger, legs: Legs
) -> PulseTrigger:
    """Return the trigger that gives a pulse at each instant of `trigger`, for an axis that moves by `legs`. Raises
    `Refusal`."""
    assert trigger.axis is not None
    axis = config.axes[trigger.axis]
    peak = max(max(speed, speed + duration * a) for duration, speed, a in legs)
    if peak > SPEED_MOST:
        most = axis.to_length(SPEED_MOST)
        raise Refusal(
            "trigger-speed",
            f"output {trigger.output}: axis {trigger.axis} moves at {peak:.0f} pulses/s, and the trigger output works "
            f"up to {SPEED_MOST}",
            f"move slower, at {abs(most):g} {axis.unit}/s at most (`speed`)",
        )
    interval = _find_interval(axis, profile, trigger)
    if interval / peak * NS_PER_S <= options.trigger_width_us * NS_PER_US:
        raise Refusal(
            "trigger-rate",
            f"output {trigger.output}: a pulse every {interval} drive pulses would be one in "
            f"{interval / peak * 1e6:.3g} µs, and each lasts {options.trigger_width_us} µs",
            "write a longer `every`, or move slower",
        )
    places = [(number + 1) * interval for number in range(len(trigger.instants_ns))]
    early = list(_find_times(legs, [position - GRAIN for position in places]))
    late = list(_find_times(legs, [position + GRAIN for position in places]))
    spans = tuple(zip(early, late, strict=True))
    return PulseTrigger(
        output=trigger.output,
        axis=trigger.axis,
        motor=motor_number(axis),
        interval=interval,
        spans_s=spans,
        duration_s=sum(duration for duration, _, _ in legs),
    )


def _find_interval(axis: Axis, profile: Profile, trigger: OutputTrigger) -> int:
    """Return the drive pulses between two triggers. Raises `Refusal` unless the positions are all those, and no others,
    that the output pulses at: the multiples of one whole number from the start to the end."""
    at, length = profile.make_evaluator(), abs(profile.end_counts - profile.start_counts)
    places = [abs(at(instant_ns / NS_PER_S).position) for instant_ns in trigger.instants_ns]
    exact = places[-1] / len(places)
    interval = round(exact)
    if any(abs(position - number * exact) > _ROUNDED for number, position in enumerate(places, 1)):
        raise _refuse_places(axis, trigger, "the positions are not equally far apart from the start of the axis on")
    if any(abs(position - number * interval) > _ROUNDED for number, position in enumerate(places, 1)):
        raise _refuse_places(axis, trigger, f"they are {exact:.6g} pulses apart, which is no whole number", exact)
    if not INTERVAL_LEAST <= interval <= INTERVAL_MOST:
        text = f"they are {interval} pulses apart; {INTERVAL_LEAST} to {INTERVAL_MOST} are possible"
        raise _refuse_places(axis, trigger, text, min(max(exact, INTERVAL_LEAST), INTERVAL_MOST))
    if (len(places) + 1) * interval <= length:
        raise _refuse_places(axis, trigger, "it would go on behind the last of the positions, to the end of the move")
    return interval


def _refuse_places(axis: Axis, trigger: OutputTrigger, why: str, exact: float = 0.0) -> Refusal:
    fitting = list(dict.fromkeys((math.floor(exact), math.ceil(exact)))) if exact else []
    lengths = " or ".join(f"`every: {abs(axis.to_length(length)):g} {axis.unit}`" for length in fitting if length)
    return Refusal(
        "trigger-positions",
        f"output {trigger.output}: the trigger output pulses every whole number of pulses of axis {trigger.axis}, from "
        f"its start to its end; {why}",
        f"write {lengths or '`every` with one distance'}, or divide the step at other positions",
    )


def _find_times(legs: Legs, places: Iterable[float]) -> Iterator[float]:
    """Yield when the axis has moved so far, s; places: growing, pls. The end of the move for one behind it."""
    remaining, clock_s, covered_length = iter(legs), 0.0, 0.0
    duration, speed, a = next(remaining)
    for position in places:
        while (length := duration * (speed + duration * a / 2)) + covered_length < position:
            following = next(remaining, None)
            if following is None:
                break
            clock_s, covered_length = clock_s + duration, covered_length + length
            duration, speed, a = following
        yield clock_s + min(duration, _time_to_cover(max(0.0, position - covered_length), speed, a))


def _time_to_cover(distance: float, speed: float, a: float) -> float:
    """Return when `distance` is covered, s: 2 d / (v + root), which has no difference of near numbers in it."""
    if distance == 0.0:
        return 0.0
    return 2 * distance / (speed + math.sqrt(max(0.0, speed * speed + 2 * a * distance)))
