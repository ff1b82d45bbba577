"""A job's report as tables for a terminal."""

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from orchestrator.model.duration import format_ns
from orchestrator.model.report import JobReport, Skew, StepReport

_VERDICT_STYLE = {"green": "bold green", "amber": "bold yellow", "red": "bold red", "none": "dim"}


def report_tables(report: JobReport) -> RenderableType:
    """The steps of a job, and for each move its members and its budget."""
    style = "bold green" if report.state == "done" else "bold red"
    head = Text.assemble(
        ("job ", ""), (report.job_id, "bold"), (f" {report.name!r}: ", ""), (report.state, style), (_reason(report), "")
    )
    steps = Table(title="steps", title_justify="left", header_style="bold")
    for name in ("#", "step", "state", "planned", "actual", "start skew", "budget", "allowed", "end skew", "verdict"):
        steps.add_column(name, justify="left" if name in ("step", "state", "verdict") else "right")
    for step in report.steps:
        steps.add_row(*_step_row(step))
    members = Table(title="members", title_justify="left", header_style="bold")
    for name in ("step", "member", "start", "axes", "armed in", "start after T0", "clock ±", "rate"):
        members.add_column(name, justify="left" if name in ("member", "start", "axes") else "right")
    for step in report.steps:
        for row in _member_rows(step):
            members.add_row(*row)
    return Group(head, steps, members) if members.row_count else Group(head, steps)


def _reason(report: JobReport) -> str:
    return f" ({report.reason})" if report.reason else ""


def _step_row(step: StepReport) -> list[str | Text]:
    budget = step.budget
    state = Text(step.state, style="green" if step.state == "done" else "red")
    return [
        str(step.index),
        f"{step.do} {step.name}".strip(),
        state if not step.reason or step.state == "done" else Text.assemble(state, f": {step.reason}"),
        _seconds(step.planned_s),
        _seconds(step.actual_s),
        _skew(step.start_skew),
        f"≤ {format_ns(budget.predicted_ns)}" if budget else "",
        f"{format_ns(budget.allowed_ns)}" if budget else "",
        _skew(step.end_skew),
        Text("" if step.verdict == "none" else step.verdict, style=_VERDICT_STYLE[step.verdict]),
    ]


def _member_rows(step: StepReport) -> list[list[str]]:
    rows: list[list[str]] = []
    for name, member in step.members.items():
        t0_ns = step.t0_fleet_ns or 0
        starts = [
            f"{axis} {_around(each.start.earliest_ns - t0_ns, each.start.latest_ns - t0_ns)}"
            for axis, each in member.evidence.items()
        ]
        rows.append(
            [
                str(step.index),
                name,
                member.start_class,
                ", ".join(member.axes),
                format_ns(member.armed_in_ns),
                "\n".join(starts),
                format_ns(member.mapping.bound_ns) if member.mapping else "",
                f"{member.mapping.rate_ppm:+.1f} ppm" if member.mapping else "",
            ]
        )
    return rows


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.4f} s"


def _skew(value: Skew | None) -> str:
    return "" if value is None else f"{value.at_least_ns / 1e6:.2f} … {value.at_most_ns / 1e6:.2f} ms"


def _around(earliest_ns: int, latest_ns: int) -> str:
    return f"{earliest_ns / 1e6:+.2f} … {latest_ns / 1e6:+.2f} ms"
