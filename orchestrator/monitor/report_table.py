"""A job's report as tables for a terminal, readable at 80 columns."""

from collections.abc import Mapping, Sequence
from statistics import median

from rich.console import Group, RenderableType
from rich.text import Text

from orchestrator.model.report import JobReport, ProbeReport, SkewInterval, StepReport, SyncBudget, TriggerReport
from orchestrator.model.state import AxisEvidence
from orchestrator.model.steps.numbers import name_step, number_step
from orchestrator.monitor.path_words import describe_bounds, describe_path
from orchestrator.monitor.tables import make_plain_table
from orchestrator.monitor.times import format_time, localize_times

_VERDICT_STYLE = {"green": "bold green", "amber": "bold yellow", "red": "bold red", "none": "dim"}
MAX_STEPS_SHOWN = 14  # of a short report
MAX_DEVIATIONS = 4
MAX_CHAIN_LINES = 4
_MAX_STEP_NAME = 14  # characters of a step's name that fit into the row with all figures


def make_report_tables(report: JobReport, *, detailed: bool = False) -> RenderableType:
    """Build a report: the outcome with the worst verdict, the table of steps, and what deviates.

    detailed: all steps, and the members of each move with their budgets. Otherwise it fits a terminal of 24 lines.
    """
    shown_steps = list(report.steps) if detailed else _select_steps(report.steps)
    steps = make_plain_table(["#>", "step", "planned>", "actual>", "start skew>", "predicted>", "end skew>", "verdict"])
    for step in shown_steps:
        steps.add_row(*_make_step_row(step))
    used = describe_used(report.parameters_used, report.positions_used)
    parts: list[RenderableType] = [_make_head(report), *(Text(line) for line in used), "", steps]
    if len(shown_steps) < len(report.steps):
        parts.append(
            Text(f"and {len(report.steps) - len(shown_steps)} more steps, which are done as planned", style="dim")
        )
    parts += [Text(line) for step in report.steps for line in _describe_scan(step)]
    chain_lines = _describe_chain(report.steps)
    parts += [Text(line) for line in (chain_lines if detailed else chain_lines[:MAX_CHAIN_LINES])]
    deviations = [f"{name_step(step.index)}: {line}" for step in report.steps for line in step.deviations]
    parts += [Text(line, style="red") for line in (deviations if detailed else deviations[:MAX_DEVIATIONS])]
    reasons = [line for step in report.steps if detailed or step.verdict != "green" for line in _explain_verdict(step)]
    parts += [Text(line) for line in (reasons if detailed else reasons[:MAX_DEVIATIONS])]
    if not any(step.members for step in report.steps):
        return Group(*parts)
    if detailed:
        return Group(*parts, *_make_details(report))
    return Group(*parts, Text(f"members and budgets: `tutti job report {report.job_id} -v`", style="dim"))


def describe_used(parameters: Mapping[str, str], positions: Mapping[str, Mapping[str, str]]) -> list[str]:
    """What a job was made with: the values of its parameters, and of the named positions of its targets."""
    lines = [f"parameters: {', '.join(f'{name} {value}' for name, value in parameters.items())}"] if parameters else []
    for name, axes in positions.items():
        lines.append(f"position {name}: {', '.join(f'{axis} {value}' for axis, value in axes.items())}")
    return lines


def _make_head(report: JobReport) -> Text:
    """The outcome in one line: state, worst verdict, reason."""
    style = "bold green" if report.state == "done" else "bold red"
    head = Text.assemble(f"job {report.name!r} ", (report.job_id, "bold"), ": ", (report.state, style))
    # Judged here: a report of an older version in the journal has no verdict on the job.
    verdict = report.judge().verdict
    if verdict is not None:
        head.append_text(Text.assemble(", verdict ", (verdict, _VERDICT_STYLE[verdict])))
    if report.reason:
        head.append(f" ({localize_times(report.reason)})")
    return head


def _select_steps(steps: Sequence[StepReport]) -> list[StepReport]:
    """The steps that a short report shows: all, or of many the conspicuous ones, filled up by the first ones."""
    if len(steps) <= MAX_STEPS_SHOWN:
        return list(steps)
    plain = [step for step in steps if step.state == "done" and step.verdict in ("none", "green")]
    conspicuous = [step for step in steps if step not in plain][:MAX_STEPS_SHOWN]
    chosen_reports = conspicuous + plain[: MAX_STEPS_SHOWN - len(conspicuous)]
    return sorted(chosen_reports, key=lambda step: step.index)


def _make_details(report: JobReport) -> list[RenderableType]:
    """The members of each move, and its budget term by term."""
    members = make_plain_table(["#>", "member", "starts by", "axes", "armed in>", "start after T0>", "clock>", "rate>"])
    budgets = make_plain_table(["#>", "member", "by its", "predicted>", "all together>", "measured>"])
    for step in report.steps:
        for row in _make_member_rows(step):
            members.add_row(*row)
        for row in _make_budget_rows(step):
            budgets.add_row(*row)
    texts_later = [Text(line) for step in report.steps for line in _describe_deviations(step)]
    return ["", members, "", "Start after T0: predicted by term and all together, and measured:", budgets, *texts_later]


def _make_step_row(step: StepReport) -> list[str | Text]:
    name = step.name or step.do
    if len(name) > _MAX_STEP_NAME:
        name = name[: _MAX_STEP_NAME - 1] + "…"
    verdict = Text("" if step.verdict == "none" else step.verdict, style=_VERDICT_STYLE[step.verdict])
    return [
        str(number_step(step.index)),
        name,
        _format_seconds(step.planned_s),
        _format_seconds(step.actual_s),
        _format_skew(step.start_skew),
        _format_budget(step.budget),
        _format_skew(step.end_skew),
        verdict if step.state == "done" else Text(step.state, style="bold red"),
    ]


def _make_member_rows(step: StepReport) -> list[list[str]]:
    rows: list[list[str]] = []
    t0_ns = step.t0_fleet_ns or 0
    for name, member in step.members.items():
        starts = {axis: _format_start(evidence, t0_ns) for axis, evidence in member.evidence.items()}
        # One command or one timer starts all axes of most controllers: show it once.
        if len(set(starts.values())) == 1:
            starts = {", ".join(member.axes): next(iter(starts.values()))}
        mapping = member.mapping
        for index, (axes, start) in enumerate(starts.items() or [(", ".join(member.axes), "")]):
            first = index == 0
            rows.append(
                [
                    str(number_step(step.index)) if first else "",
                    name if first else "",
                    member.start_class if first else "",
                    axes,
                    f"{member.armed_in_ns / 1e6:.0f} ms" if first else "",
                    start,
                    f"±{mapping.bound_ns / 1e6:.1f} ms" if mapping and first else "",
                    f"{mapping.rate_ppm:+.0f} ppm" if mapping and first else "",
                ]
            )
    return rows


def _make_budget_rows(step: StepReport) -> list[list[str]]:
    """Build the rows of a step's budget, term by term, each with the measured value."""
    rows: list[list[str]] = []
    budget, t0_ns = step.budget, step.t0_fleet_ns or 0
    for name, member in (budget.members if budget is not None else {}).items():
        evidence = step.members[name].evidence if name in step.members else {}
        proof = ", ".join(dict.fromkeys(_format_start(axis_evidence, t0_ns) for axis_evidence in evidence.values()))
        promise = _format_interval(member.earliest_ns, member.latest_ns)
        for index, term in enumerate(member.terms):
            first = index == 0
            columns = [promise, proof] if first else ["", ""]
            head = [str(number_step(step.index)), name] if first else ["", ""]
            rows.append([*head, term.name, _format_interval(term.earliest_ns, term.latest_ns), *columns])
    return rows


def _describe_deviations(step: StepReport) -> list[str]:
    """Describe a path with its bound, triggers, feed holds inside the step, and predicted end and path skew."""
    budget = step.budget
    lines = [f"{name_step(step.index)}: {text}" for text in ([] if step.path is None else describe_path(step.path))]
    lines += [
        f"{name_step(step.index)}: {name} is off its line by at most {bound.most:.3g} {bound.unit} on the way"
        for name, bound in step.virtual.items()
    ]
    lines += [f"{name_step(step.index)}: {text}" for text in describe_bounds(step)]
    lines += [f"{name_step(step.index)}: {_describe_triggers(trigger)}" for trigger in step.triggers]
    latch = step.latch
    if latch is not None:
        lines.append(
            f"{name_step(step.index)}: {latch.axis} was at {latch.position:g} {latch.unit} when {latch.input} came"
        )
    lines += [f"{name_step(step.index)}: {_describe_probe(probe)}" for probe in step.probed_axes]
    lines += [
        f"{name_step(step.index)}: feed hold by {hold.by} at {format_time(hold.utc)}; its axes came to rest "
        f"within {_format_skew(hold.rest_skew) or 'an unknown time'}"
        for hold in step.feed_holds
    ]
    for skew_name, skew in (("end", budget.end), ("path", budget.path)) if budget is not None else ():
        if skew is not None and len(step.members) > 1:
            limit_text = "" if skew.allowed_ns is None else f", allowed {skew.allowed_ns / 1e6:g} ms"
            lines.append(
                f"{name_step(step.index)}: predicted {skew_name} skew at most {skew.predicted_ns / 1e6:.1f} ms"
                f"{limit_text}; worst is {skew.worst_member}"
            )
    return lines


def _describe_probe(probe: ProbeReport) -> str:
    """Where an axis was at a contact, and how far it went on."""
    if not probe.touched:
        return f"{probe.until} was not touched; {probe.axis} is at {probe.rest:g} {probe.unit}"
    text = (
        f"{probe.axis} was between {probe.least:.9g} and {probe.most:.9g} {probe.unit} when {probe.until} changed, and "
        f"went on by at most {probe.overtravel:.3g} {probe.unit} ({probe.stated:.3g} stated)"
    )
    return f"{text}; it has changed back since" if probe.released else text


def _describe_triggers(triggered: TriggerReport) -> str:
    """What an output did on the way."""
    text = f"{triggered.output}: {triggered.seen} of {triggered.planned} triggers seen"
    if triggered.seen:
        text += f", each within {triggered.widest_ns / 1e6:.2f} ms"
    if triggered.outside:
        text += f", {triggered.outside} not within the promise"
    return text + (f"; {triggered.problem}" if triggered.problem else "")


def _describe_scan(step: StepReport) -> list[str]:
    """What the points of a scan did together, and those that are not green."""
    scan = step.scan
    if scan is None:
        return []
    point = "move" if step.do == "live" else "point"
    line = f"{name_step(step.index)}: {scan.done} of {scan.points} {point}s"
    if scan.mean_s is not None:
        line += f", {scan.mean_s:.3f} s a {point} ({scan.least_s:.3f} to {scan.most_s:.3f} s)"
    if scan.start_skew_p50_ns is not None and scan.start_skew_p99_ns is not None:
        line += f", start skew at most {scan.start_skew_p50_ns / 1e6:.1f} ms in half of them"
        line += f", {scan.start_skew_p99_ns / 1e6:.1f} ms in 99 %"
    other_count = sum(number for verdict, number in scan.verdicts.items() if verdict in ("amber", "red"))
    lines = [line + (f"; {other_count} not green" if other_count else "")]
    return lines + [
        f"{name_step(step.index)}, {point} {finding.point}: {finding.verdict}"
        + (f", {finding.text}" if finding.text else "")
        for finding in scan.not_green
    ]


def _describe_chain(steps: Sequence[StepReport]) -> list[str]:
    """How closely motion steps followed each other, and why others began from rest."""
    gaps_ms = [
        report.chain.gap_s * 1e3 for report in steps if report.chain and report.chain.kept and report.chain.gap_s
    ]
    lines: list[str] = []
    if gaps_ms:
        lines = [
            f"begun right behind the motion before: {len(gaps_ms)} of "
            f"{sum(report.chain is not None for report in steps)} steps, {median(gaps_ms):.1f} ms after its end in the "
            f"median, {max(gaps_ms):.1f} ms at most"
        ]
    for step in steps:
        chain = step.chain
        if chain is not None and not chain.kept and chain.broken:
            gap_text = "" if chain.gap_s is None else f", {chain.gap_s:.3f} s after {name_step(chain.step)}"
            lines.append(f"{name_step(step.index)} from rest{gap_text}: {localize_times(chain.broken)}")
    return lines


def describe_gap(step: StepReport) -> str:
    """How a motion step followed the one before it, in words; empty for any other step."""
    chain = step.chain
    if chain is None or (chain.kept and chain.gap_s is None):
        return ""
    if chain.kept and chain.gap_s is not None:
        return f"{chain.gap_s * 1e3:.1f} ms after {name_step(chain.step)}"
    return "from rest" + (f": {localize_times(chain.broken)}" if chain.broken else "")


def _explain_verdict(step: StepReport) -> list[str]:
    """Both figures of the start skew where evidence and promises differ, and how late hosts were."""
    lines: list[str] = []
    proved_interval, promised_interval = step.start_skew, step.promised_skew
    if proved_interval is not None and promised_interval is not None:
        lines.append(
            f"{name_step(step.index)}: start skew {_format_skew(proved_interval)} by the controllers' evidence, "
            f"{_format_skew(promised_interval)} by the promises"
        )
    for name, member in step.members.items():
        late_ns = max((evidence.late_ns for evidence in member.evidence.values()), default=0)
        if late_ns:
            lines.append(f"{name_step(step.index)}: the host was late by {late_ns / 1e6:.1f} ms at the start of {name}")
    return lines


def _format_interval(earliest_ns: int, latest_ns: int) -> str:
    return f"{earliest_ns / 1e6:+.2f} … {latest_ns / 1e6:+.2f} ms"


def _format_seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.{3 if value < 10 else 2}f} s"


def _format_skew(value: SkewInterval | None) -> str:
    """The interval that is certain: usually only an upper bound, rarely also a lower one."""
    if value is None:
        return ""
    most = f"{value.at_most_ns / 1e6:.1f} ms"
    return f"≤ {most}" if value.at_least_ns == 0 else f"{value.at_least_ns / 1e6:.1f} to {most}"


def _format_budget(budget: SyncBudget | None) -> str:
    """The predicted skew, and the limit that the job allows."""
    return f"{budget.predicted_ns / 1e6:.1f} of {budget.allowed_ns / 1e6:g} ms" if budget else ""


def _format_start(evidence: AxisEvidence, t0_ns: int) -> str:
    start = evidence.start_for_verdict
    earliest_ns, latest_ns = start.earliest_ns - t0_ns, start.latest_ns - t0_ns
    return f"{earliest_ns / 1e6:+.1f} … {latest_ns / 1e6:+.1f} ms"
