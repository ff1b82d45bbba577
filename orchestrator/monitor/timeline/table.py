"""A timeline as tables for a terminal: one a step, a row for each stage."""

from rich.console import Group, RenderableType
from rich.text import Text

from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.state import TimeInterval
from orchestrator.model.steps.numbers import name_step
from orchestrator.monitor.tables import make_plain_table
from orchestrator.monitor.timeline.stages import JobTimeline, StepTimeline, TimelineAxis, TimelineStage
from orchestrator.monitor.times import format_time, localize_times


def make_timeline_tables(timeline: JobTimeline) -> RenderableType:
    """Build the tables; times relative to T0 of the step."""
    parts: list[RenderableType] = []
    for step in timeline.steps:
        parts += [Text(_describe_step(step)), *(Text(line, style="dim") for line in _list_remarks(step))]
        parts += [_make_table(step), ""]
    return Group(*parts[:-1])


def _describe_step(step: StepTimeline) -> str:
    name = f" {step.name}" if step.name else ""
    verdict = "" if step.verdict == "none" else f", {step.verdict}"
    return f"{name_step(step.step)}{name}: {step.state}{verdict}; 0 ms is T0, fleet time {step.t0_fleet_ns / 1e9:.6f} s"


def _list_remarks(step: StepTimeline) -> list[str]:
    holds = [f"paused by {hold.by} at {format_time(hold.utc)}: this is the last part" for hold in step.feed_holds]
    breaks = [f"from rest: {localize_times(step.chain.broken)}"] if step.chain and step.chain.broken else []
    return [*breaks, *holds, *step.remarks]


def _make_table(step: StepTimeline) -> RenderableType:
    table = make_plain_table(["of", "stage", "begin>", "took>"])
    for number, stage in enumerate(step.coordinator):
        table.add_row("coordinator" if number == 0 else "", *_make_cells(stage))
    for name, member in step.members.items():
        for number, stage in enumerate(member.stages):
            table.add_row(f"{name}, by {member.start_class}" if number == 0 else "", *_make_cells(stage))
        for axis, went in member.axes.items():
            table.add_row("", f"start {axis}", _format_interval(went.modelled or went.start), "")
            if went.end is not None:
                table.add_row("", f"end {axis}", _format_interval(went.end), _format_settled(went))
    return table


def _make_cells(stage: TimelineStage) -> tuple[str, str, str]:
    return stage.name, f"{stage.begin_ns / NS_PER_MS:+.1f} ms", f"{(stage.end_ns - stage.begin_ns) / NS_PER_MS:.1f} ms"


def _format_interval(interval: TimeInterval) -> str:
    return f"{interval.earliest_ns / NS_PER_MS:+.2f} … {interval.latest_ns / NS_PER_MS:+.2f} ms"


def _format_settled(axis: TimelineAxis) -> str:
    return "" if axis.settled_s is None else f"settled in {axis.settled_s * 1e3:.1f} ms"
