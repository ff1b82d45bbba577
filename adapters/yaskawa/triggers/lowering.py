"""Triggers lowered to a table of samples, with what the interpreter can play beside a motion."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

from adapters.yaskawa.common import lines
from adapters.yaskawa.common.loads import YaskawaLowered
from adapters.yaskawa.common.lowering import LOOP_COMMANDS, LoweringContext, find_chunk_times
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import TABLE
from adapters.yaskawa.triggers.ring import MOST_OF_CHUNK, RING
from adapters.yaskawa.triggers.table import STAMP_DIGITS
from adapters.yaskawa.triggers.traits import TriggerTraits
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import BudgetTerm, OutputTrigger, StartOptions, TriggerDrive
from orchestrator.model.state import ChunkTriggers

CONTOUR_COMMANDS = LOOP_COMMANDS + 1  # of one record, CD with its arrays counted twice
LOAD_EXCHANGES = 10  # allocation, variables, formats
SEPARATORS = 2  # characters of an element besides its digits
ROUNDS = 50  # of the search for the time of a round


@dataclass(frozen=True, slots=True)
class TriggerNeeds:
    """What triggers take from a contour beside them. commands: of theirs before one of its records; elements: of the
    arrays."""

    commands: float = 0.0
    elements: int = 0


NO_TRIGGERS = TriggerNeeds()


def find_needs(start: StartOptions, traits: TriggerTraits) -> TriggerNeeds:
    """What the triggers of a step take from a contour."""
    if not start.triggers:
        return NO_TRIGGERS
    elements = sum(len(trigger.instants_ns) for trigger in start.triggers)
    return TriggerNeeds(traits.contour_commands, elements if start.chunk is None else RING)


def find_chunk_triggers(context: LoweringContext) -> ChunkTriggers | None:
    """How the controller takes triggers with the chunks of a path of all its axes; None without room for both."""
    chunk_s, _ = find_chunk_times(context, context.options.tick_ns)
    if find_chunk_times(replace(context, beside_elements=RING), context.options.tick_ns)[0] < chunk_s:
        return None
    # An element is assigned, read back, and read again when it was played.
    return ChunkTriggers(most=MOST_OF_CHUNK, load_ns=3 * context.options.decode_us * NS_PER_US, shows=True)


def add_triggers(
    lowered: YaskawaLowered,
    context: LoweringContext,
    traits: TriggerTraits,
    start: StartOptions,
    mapping: TickMapping | None,
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
    contour, chunk = lowered.load.contour, start.chunk
    interval = None if contour is None else contour.interval
    pace = TriggerPace(options, traits, mapping.tick_ns, interval, is_ring=chunk is not None)
    _require_rate(trigger, pace)
    loading_ns = _find_loading_ns(trigger, options, traits)
    end_ns = None if chunk is None else round(chunk.end_s * NS_PER_S)
    turns = trigger.pulse_ns == 0
    entry = traits.find_label(turns=turns, is_ring=chunk is not None)
    return replace(
        lowered,
        switches=lines.ProgramTriggers(output, tuple(trigger.instants_ns), turns, end_ns),
        trigger_least_ns={trigger.output: pace.find_round_ns(trigger.pulse_ns)},
        triggers={trigger.output: _make_terms(trigger, pace, start, mapping)},
        gap_ns=None,
        costs=lowered.costs.model_copy(update={"arm_ns": lowered.costs.arm_ns + loading_ns}),
        commands=(
            *lowered.commands,
            f"QD {TABLE}: {len(trigger.instants_ns)} samples; XQ {entry},3  (switches output {output.number} at them)",
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


@dataclass(frozen=True, slots=True)
class TriggerPace:
    """How fast triggers can be played. interval: of the contour beside which they are, if any. is_ring: they come with
    the chunks of a path."""

    options: YaskawaOptions
    traits: TriggerTraits
    tick_ns: float
    interval: int | None
    is_ring: bool = False

    def find_round_ns(self, active_ns: int) -> int:
        """The longest time from one instant to the next that is played in time: the commands of its own thread, and
        those of the host, of the watchdog, of polls and of a contour meanwhile. active_ns: the pulse; 0: a level."""
        command_ns, traits = self.options.decode_us * NS_PER_US, self.traits
        own = (traits.pulse_commands if active_ns else traits.level_commands) + traits.other_commands
        own += traits.ring_commands if self.is_ring else 0
        pulse_ns = math.ceil(active_ns / self.tick_ns) * self.tick_ns
        alone_ns = needs_ns = own * command_ns + pulse_ns
        if self.interval is not None:
            record_ns = self.tick_ns * (1 << self.interval)
            for _ in range(ROUNDS):
                records = math.ceil(needs_ns / record_ns)
                longer_ns = alone_ns + records * CONTOUR_COMMANDS * command_ns
                if longer_ns == needs_ns:
                    break
                needs_ns = longer_ns
        return math.ceil(needs_ns)


def _require_rate(trigger: OutputTrigger, pace: TriggerPace) -> None:
    """Raise `Refusal` for instants that follow faster than the interpreter plays them."""
    needs_ns = pace.find_round_ns(trigger.pulse_ns)
    gaps_ns = [next_ns - instant_ns for instant_ns, next_ns in pairwise(trigger.instants_ns)]
    gap_ns = trigger.least_ns or min(gaps_ns, default=needs_ns)
    if gap_ns < needs_ns:
        contour_text = "" if pace.interval is None else " beside a contour"
        least_ms = math.ceil(needs_ns / NS_PER_MS * 10) / 10
        raise Refusal(
            "trigger-rate",
            f"output {trigger.output}: two triggers are {gap_ns / NS_PER_MS:.3g} ms apart; the controller's program "
            f"plays one in {least_ms:g} ms{contour_text}",
            f"write at least {least_ms:g} ms, or a distance that takes as long at the highest speed, or move slower, "
            "or a shorter `pulse`",
        )


def _make_terms(
    trigger: OutputTrigger, pace: TriggerPace, start: StartOptions, mapping: TickMapping
) -> tuple[BudgetTerm, ...]:
    """The interval of an edge relative to its instant: the sample nearest to it, the commands that may run when its
    wait ends, stamp and OB, and the output itself."""
    tick_ns, options = mapping.tick_ns, pace.options
    half_ns, ahead_ns = math.ceil(tick_ns / 2), round(options.begin_ticks(tick_ns, interleaved=True)[0] * tick_ns)
    last_ns = trigger.instants_ns[-1] if start.chunk is None else round(start.chunk.end_s * NS_PER_S)
    bound_ns = mapping.bound_at_ns(mapping.host_at_ns + start.lead_ns + last_ns)
    # Before the stamp, and before OB.
    beside_us = 2 * pace.traits.beside * options.decode_us
    latest_us = options.begin_max_us + options.interleaved_us + options.decode_us + beside_us
    if pace.interval is not None:
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


def _find_loading_ns(trigger: OutputTrigger, options: YaskawaOptions, traits: TriggerTraits) -> int:
    """How much longer arming takes with the table."""
    count = len(trigger.instants_ns)
    digits = len(str(round(max(trigger.instants_ns, default=0) / options.tick_ns)))
    packets = -(-count // (traits.packet // (digits + SEPARATORS))) - (-count // traits.back)
    characters = count * (digits + STAMP_DIGITS + 2 * SEPARATORS)
    return (LOAD_EXCHANGES + packets) * options.exchange_ns + characters * traits.char_ns
