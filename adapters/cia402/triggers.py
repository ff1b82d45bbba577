"""Triggers lowered to the SYNCs of a stream: the outputs change with the SYNC next to each instant."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import ceil

from adapters.cia402.canopen.objects import point_bit
from adapters.cia402.costs import full_frame_ns, sync_ns
from adapters.cia402.lowering import BusTimes, Cia402Lowered
from adapters.cia402.options import Cia402Options
from adapters.cia402.shapes.switching import EdgeGrid, EdgeTimes, OutputSchedule, SwitchedPoint
from adapters.contract import PathChunk
from adapters.toolkit.wired_points import find_driven_output
from orchestrator.clock.base import NS_PER_US
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import BudgetTerm, OutputTrigger, StartOptions, TriggerDrive, sum_terms
from orchestrator.model.numbers import format_ns


def add_triggers(
    lowered: Cia402Lowered, config: Controller, options: Cia402Options, bus: BusTimes, start: StartOptions
) -> Cia402Lowered:
    """Return the lowered step with the triggers that are asked for. Raises `Refusal` with what would fit."""
    if not start.triggers:
        return lowered
    if lowered.drive is not None:
        raise Refusal("start-class", "a step with triggers drives no trigger line", "remove `start`")
    course, name = lowered.trajectory, lowered.axis
    if course is None:
        output = start.triggers[0].output
        has_jerk = config.axes[name].limits.jerk is not None
        moves = "does not move in this step" if has_jerk else "has no limit of `jerk`, so that none are streamed to it"
        raise Refusal(
            "trigger-axis",
            f"output {output}: a CiA 402 drive switches outputs with the positions that are streamed to it, and its "
            f"axis {name} {moves}",
            f"move {name} in the step, too" if has_jerk else f"add a `jerk` limit to {name}, and move it in the step",
        )
    sync_terms = find_edge_terms(options, bus)
    middle_ns = sum(sum_terms(sync_terms)) // 2
    grid = EdgeGrid(course.period_ns, middle_ns)
    points: list[SwitchedPoint] = []
    terms: dict[str, tuple[BudgetTerm, ...]] = {}
    least_ns: dict[str, int] = {}
    for trigger in start.triggers:
        edges = grid.find_edges(trigger.instants_ns)
        pulse = _fit_pulse(trigger, course.period_ns)
        least = max(pulse, 1) + 1
        _require_rate(trigger, edges, least, course.period_ns)
        least_ns[trigger.output] = least * course.period_ns
        points.append(_make_point(config, trigger, edges, pulse, course.point_count))
        off_ns = [edge * course.period_ns - instant for edge, instant in zip(edges, trigger.instants_ns, strict=True)]
        if lowered.chunk is not None:  # of the instants of later chunks the same is promised
            off_ns += grid.most_off_ns
        rounding = BudgetTerm(name="quantisation", earliest_ns=min(off_ns), latest_ns=max(off_ns))
        terms[trigger.output] = (*sync_terms, rounding)
    return replace(
        lowered,
        switched=OutputSchedule(tuple(points)),
        grid=grid,
        triggers=terms,
        trigger_least_ns=least_ns,
        commands=(
            *lowered.commands,
            *(
                f"60FEh bit {point.bit.bit_length() - 1} {'on' if point.high else 'off'} with {len(point.edges)} SYNCs"
                for point in points
            ),
        ),
    )


def continue_triggers(lowered: Cia402Lowered, chunk: PathChunk, point_count: int) -> OutputSchedule:
    """Return what the outputs of a path do when it goes on with `chunk`. point_count: positions of the stream then.
    Raises `Refusal`."""
    if not lowered.triggers:
        return lowered.switched
    points: list[SwitchedPoint] = []
    for point in lowered.switched.points:
        part = chunk.triggers.get(point.name)
        if part is None or part.first > len(point.edges):
            text = f"output {point.name}: instants are missing before those of chunk {chunk.number}"
            raise Refusal("trigger-gap", text, "")
        edges = (*point.edges[: part.first], *lowered.grid.find_edges(part.instants_ns))
        newest = edges[max(0, part.first - 1) :]
        if any(next_edge - edge <= max(point.pulse, 1) for edge, next_edge in pairwise(newest)):
            text = f"output {point.name}: triggers of chunk {chunk.number} follow faster than the drive switches"
            raise Refusal("trigger-rate", text, "move slower")
        points.append(point.with_edges(edges, point_count))
    return OutputSchedule(tuple(points))


def find_edge_terms(options: Cia402Options, bus: BusTimes) -> tuple[BudgetTerm, ...]:
    """Return the terms of an edge relative to T0 and the periods up to its SYNC, which is written so that it would
    start a motion then."""
    return (
        options.host_term(),
        BudgetTerm(
            name="wire",
            earliest_ns=-(sync_ns(bus.bitrate) // 2),  # it may have no stuff bits
            latest_ns=options.wire_jitter_us * NS_PER_US + full_frame_ns(bus.bitrate),
        ),
        BudgetTerm(name="tick", earliest_ns=0, latest_ns=options.cycle_us * NS_PER_US),
        BudgetTerm(name="output", earliest_ns=-bus.start_ns, latest_ns=options.output_us * NS_PER_US - bus.start_ns),
    )


def find_edge_times(options: Cia402Options, bitrate: int) -> EdgeTimes:
    """Return the bounds of an edge by the SYNC that was written and answered."""
    wire_ns = options.wire_jitter_us * NS_PER_US + full_frame_ns(bitrate) + sync_ns(bitrate)
    after_ns = (options.cycle_us + options.output_us) * NS_PER_US
    return EdgeTimes(sync_ns(bitrate) // 2, wire_ns + after_ns, after_ns)


def _fit_pulse(trigger: OutputTrigger, period_ns: int) -> int:
    """Return the length of a pulse in periods; 0 for a level."""
    if trigger.pulse_ns and trigger.pulse_ns < period_ns:
        raise Refusal(
            "trigger-pulse",
            f"output {trigger.output}: pulses of {format_ns(trigger.pulse_ns)} asked for; the outputs of a CiA 402 "
            f"drive change with the SYNCs of its stream, every {format_ns(period_ns)}",
            f"write `pulse: {format_ns(period_ns)}`, or set a shorter `period_ms` for the drives of the bus",
        )
    return ceil(trigger.pulse_ns / period_ns)


def _require_rate(trigger: OutputTrigger, edges: Sequence[int], least: int, period_ns: int) -> None:
    """Raise `Refusal` for edges that follow faster than the SYNCs allow. least: periods from one to the next."""
    # Of a path in chunks the shortest distance is known, and may lie anywhere between two SYNCs.
    is_close = trigger.least_ns and trigger.least_ns < least * period_ns
    if is_close or any(next_edge - edge < least for edge, next_edge in pairwise(edges)):
        gaps_ns = [next_ns - instant_ns for instant_ns, next_ns in pairwise(trigger.instants_ns)]
        gap_ns = trigger.least_ns or min(gaps_ns)
        raise Refusal(
            "trigger-rate",
            f"output {trigger.output}: two triggers are {format_ns(gap_ns)} apart; a CiA 402 drive with a SYNC every "
            f"{format_ns(period_ns)} switches one in {format_ns(least * period_ns)}",
            f"write at least {format_ns(least * period_ns)}, or a distance that takes as long at the highest speed, or "
            "move slower, or set a shorter `period_ms`",
        )


def _make_point(
    config: Controller, trigger: OutputTrigger, edges: Sequence[int], pulse: int, point_count: int
) -> SwitchedPoint:
    """Return the output with all its changes. pulse: in periods; 0: a level."""
    point = find_driven_output(config, TriggerDrive(output=trigger.output, active_ns=trigger.pulse_ns))
    passive_point = SwitchedPoint(trigger.output, point_bit(point.number), point.active == "high", (), pulse=pulse)
    return passive_point.with_edges(tuple(edges), point_count)
