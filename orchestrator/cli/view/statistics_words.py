"""Statistics in a terminal, and as lines of a table."""

from collections.abc import Iterator, Mapping

from rich.console import RenderableType
from rich.text import Text

from orchestrator.model.numbers import format_ns
from orchestrator.model.operation.statistics import ControllerFigures, PeriodFigures
from orchestrator.monitor.tables import make_plain_table

Line = tuple[str, str, str, str, float, str]
"""Day, kind, subject, figure, value, unit."""


def make_tables(figures: PeriodFigures, title: str) -> Iterator[RenderableType]:
    """The tables of a period, each only if it has rows."""
    yield Text(title, "bold")
    if not any((figures.axes, figures.controllers, figures.jobs)):
        yield Text("nothing was counted", "dim")
    if figures.axes:
        axes = make_plain_table(["axis", "moves>", "reversals>", "distance>", "moving>"])
        for axis in figures.axes:
            way = f"{axis.distance:,.4g} {axis.unit}" if axis.distance < 1e4 else f"{axis.distance:,.0f} {axis.unit}"
            axes.add_row(axis.axis, f"{axis.moves:,}", f"{axis.reversals:,}", way, format_time_span(axis.moving_s))
        yield from ("", axes)
    if figures.controllers:
        table = make_plain_table(["controller", "available>", "online>", "fault>", "offline>", "faults by code"])
        for axis in figures.controllers:
            part = "-" if axis.availability is None else f"{axis.availability:.2%}"
            times = [format_time_span(value) for value in (axis.online_s, axis.fault_s, axis.offline_s)]
            table.add_row(axis.controller, part, *times, describe_counts(axis.faults))
        yield from ("", table)
    if figures.pairs:
        pairs = make_plain_table(["start skew", "moves>", "mean>", "p50>", "p99>", "worst>"])
        for axis in figures.pairs:
            skews = (axis.mean_ns, axis.p50_ns, axis.p99_ns, axis.worst_ns)
            pairs.add_row(" - ".join(axis.pair), f"{axis.moves:,}", *(format_ns(skew) for skew in skews))
        yield from ("", pairs)
    for name, counts in (("jobs", figures.jobs), ("failures", figures.failures)):
        if counts:
            yield from ("", f"{name}: {describe_counts(counts)}")
    yield ""


def describe_counts(counts: Mapping[str, int]) -> str:
    """Counts in words, the largest first: `12 done, 1 failed`."""
    entries = sorted(counts.items(), key=lambda entry: (-entry[1], entry[0]))
    return ", ".join(f"{count:,} {name}" for name, count in entries)


def format_time_span(seconds: float) -> str:
    """A time in the fitting unit, e.g. `3.5 h`."""
    for size, unit in ((3600, "h"), (60, "min")):
        if seconds >= size:
            return f"{seconds / size:,.1f} {unit}"
    return f"{seconds:.1f} s"


def list_figures(figures: PeriodFigures) -> Iterator[Line]:
    """All figures of a day, one by one."""
    day = figures.day or ""
    for axis in figures.axes:
        for name, value, unit in (
            ("moves", axis.moves, ""),
            ("reversals", axis.reversals, ""),
            ("distance", axis.distance, axis.unit),
            ("moving", axis.moving_s, "s"),
        ):
            yield day, "axis", axis.axis, name, value, unit
    for controller in figures.controllers:
        yield from _list_controller(day, controller)
    for pair in figures.pairs:
        subject = "+".join(pair.pair)
        yield day, "pair", subject, "moves", pair.moves, ""
        for name in ("mean", "p50", "p99", "worst"):
            yield day, "pair", subject, f"start skew {name}", getattr(pair, f"{name}_ns"), "ns"
    for name, count in figures.jobs.items():
        yield day, "jobs", "", name, count, ""
    for name, count in figures.failures.items():
        yield day, "failures", "", name, count, ""


def _list_controller(day: str, each: ControllerFigures) -> Iterator[Line]:
    for name, value in (("online", each.online_s), ("fault", each.fault_s), ("offline", each.offline_s)):
        yield day, "controller", each.controller, name, value, "s"
    for code, count in each.faults.items():
        yield day, "controller", each.controller, f"faults {code}", count, ""
