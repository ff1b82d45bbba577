"""Triggers lowered to a table of samples, with what the interpreter can play beside a motion."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

from adapters.yaskawa.common import lines
from adapters.yaskawa.common.arrays import count_exchanges
from adapters.yaskawa.common.lowering import LOOP_COMMANDS, ContourLoad, LoweringContext, YaskawaLowered
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import LEVEL_LABEL, PULSE_LABEL, TABLE
from adapters.yaskawa.triggers.table import UPLOAD_ELEMENTS
from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import BudgetTerm, OutputTrigger, StartOptions, TriggerDrive

# Of one round of its thread, the wait with its expression counted twice.
PULSE_COMMANDS, LEVEL_COMMANDS = 8, 7
# A command of the host before each of its lines, and those of the watchdog.
OTHER_COMMANDS = 5
CONTOUR_COMMANDS = LOOP_COMMANDS + 1  # of one record, CD with its arrays counted twice
LINE_COMMANDS = 2  # that its longest line takes after its wait
LOAD_EXCHANGES = 10  # allocation, variables, formats
ROUNDS = 50  # of the search for the time of a round


@dataclass(frozen=True, slots=True)
class TriggerNeeds:
    """What triggers take from a contour beside them. commands: of theirs before one of its records; elements: of the
    arrays."""

    commands: float = 0.0
    elements: int = 0


NO_TRIGGERS = TriggerNeeds()


def find_needs(start: StartOptions) -> TriggerNeeds:
    """What the triggers of a step take from a contour."""
    if not start.triggers:
        return NO_TRIGGERS
    # The contour's own commands are counted at twice their time; these contain no expression.
    return TriggerNeeds(LINE_COMMANDS / 2, sum(len(trigger.instants_ns) for trigger in start.triggers))


def add_triggers(
    lowered: YaskawaLowered, context: LoweringContext, start: StartOptions, mapping: TickMapping | None
) -> YaskawaLowered:
    """The lowered step with the triggers that are asked for. Raises `Refusal` with what would fit."""
    if not start.triggers or mapping is None:
        return lowered
    options, (trigger, *more) = context.options, start.triggers
    if more:
        raise Refusal(
            "trigger-many",
            f"outputs {trigger.output} and {more[0].output}: the controller plays one table of triggers at a time",
            "leave one trigger, and wire its output to both devices",
        )
    if lowered.waits is not None or lowered.drives is not None:
        raise Refusal("start-class", "a step with triggers starts by the controller's own clock", "remove `start`")
    pulse = TriggerDrive(output=trigger.output, active_ns=trigger.pulse_ns)
    output = lines.resolve_driven_output(context.config, pulse, mapping.tick_ns)
    if output.number > lines.LOCAL_POINTS:
        text = f"output {trigger.output} is number {output.number}; triggers switch outputs 1 to {lines.LOCAL_POINTS}"
        raise Refusal("trigger-output", text, "connect the device to one of these outputs")
    _require_room(trigger, options)
    _require_rate(trigger, lowered, options, mapping.tick_ns)
    loading_ns = _find_loading_ns(trigger, options)
    return replace(
        lowered,
        switches=lines.ProgramTriggers(output, tuple(trigger.instants_ns), turns=trigger.pulse_ns == 0),
        triggers={trigger.output: _make_terms(trigger, lowered, options, start, mapping)},
        gap_ns=None,
        costs=lowered.costs.model_copy(update={"arm_ns": lowered.costs.arm_ns + loading_ns}),
        commands=(
            *lowered.commands,
            f"QD {TABLE}: {len(trigger.instants_ns)} samples; XQ {PULSE_LABEL if trigger.pulse_ns else LEVEL_LABEL},3  "
            f"(switches output {output.number} at them)",
        ),
    )


def _require_room(trigger: OutputTrigger, options: YaskawaOptions) -> None:
    count = len(trigger.instants_ns)
    if count > options.array_elements:
        raise Refusal(
            "trigger-room",
            f"output {trigger.output}: {count} triggers; the arrays have {options.array_elements} elements",
            f"at most {options.array_elements} in a step: write a longer `every`, or divide the step",
        )


def _require_rate(trigger: OutputTrigger, lowered: YaskawaLowered, options: YaskawaOptions, tick_ns: float) -> None:
    """Raise `Refusal` for instants that follow faster than the interpreter plays them."""
    needs_ns = find_round_ns(trigger, lowered, options, tick_ns)
    gap_ns = min((after - before for before, after in pairwise(trigger.instants_ns)), default=needs_ns)
    if gap_ns < needs_ns:
        beside = " beside a contour" if isinstance(lowered.load, ContourLoad) else ""
        least_ms = math.ceil(needs_ns / NS_PER_MS * 10) / 10
        raise Refusal(
            "trigger-rate",
            f"output {trigger.output}: two triggers are {gap_ns / NS_PER_MS:.3g} ms apart; the controller's program "
            f"plays one in {least_ms:g} ms{beside}",
            f"write at least {least_ms:g} ms, or a distance that takes as long at the highest speed, or move slower, "
            "or a shorter `pulse`",
        )


def find_round_ns(trigger: OutputTrigger, lowered: YaskawaLowered, options: YaskawaOptions, tick_ns: float) -> int:
    """The longest time from one instant to the next that is played in time: the commands of its own thread, and those
    of the host, of the watchdog and of a contour meanwhile."""
    command_ns = options.decode_us * NS_PER_US
    own = (PULSE_COMMANDS if trigger.pulse_ns else LEVEL_COMMANDS) + OTHER_COMMANDS
    pulse_ns = math.ceil(trigger.pulse_ns / tick_ns) * tick_ns
    alone_ns = needs_ns = own * command_ns + pulse_ns
    if isinstance(lowered.load, ContourLoad):
        record_ns = tick_ns * (1 << lowered.load.contour.interval)
        for _ in range(ROUNDS):
            records = math.ceil(needs_ns / record_ns)
            longer_ns = alone_ns + records * CONTOUR_COMMANDS * command_ns
            if longer_ns == needs_ns:
                break
            needs_ns = longer_ns
    return math.ceil(needs_ns)


def _make_terms(
    trigger: OutputTrigger,
    lowered: YaskawaLowered,
    options: YaskawaOptions,
    start: StartOptions,
    mapping: TickMapping,
) -> tuple[BudgetTerm, ...]:
    """The interval of an edge relative to its instant: the sample nearest to it, the commands that may run when its
    wait ends, stamp and OB, and the output itself."""
    tick_ns = mapping.tick_ns
    half_ns, ahead_ns = math.ceil(tick_ns / 2), round(options.begin_ticks(tick_ns, interleaved=True)[0] * tick_ns)
    bound_ns = mapping.bound_at_ns(mapping.host_at_ns + start.lead_ns + trigger.instants_ns[-1])
    latest_us = options.begin_max_us + options.interleaved_us + options.decode_us
    if isinstance(lowered.load, ContourLoad):
        latest_us += CONTOUR_COMMANDS * options.decode_us
    delays_us = (options.output_on_us, options.output_off_us)
    return (
        BudgetTerm(name="clock", earliest_ns=-bound_ns, latest_ns=bound_ns),
        BudgetTerm(name="quantisation", earliest_ns=-half_ns, latest_ns=half_ns),
        BudgetTerm(
            name="firmware",
            earliest_ns=2 * options.decode_min_us * NS_PER_US - ahead_ns,
            latest_ns=latest_us * NS_PER_US - ahead_ns,
        ),
        BudgetTerm(name="output", earliest_ns=0, latest_ns=max(delays_us) * NS_PER_US),
    )


def _find_loading_ns(trigger: OutputTrigger, options: YaskawaOptions) -> int:
    """How much longer arming takes with the table."""
    count = len(trigger.instants_ns)
    digits = len(str(round(trigger.instants_ns[-1] / options.tick_ns)))
    exchanges = LOAD_EXCHANGES + count_exchanges(count, [digits]) + count // UPLOAD_ELEMENTS
    return exchanges * options.exchange_ns
