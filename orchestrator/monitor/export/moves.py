"""The table of the moves of a job: one row for each axis of each motion step, with the uncertainty of its instants.

`start_t_lo_ns` and `start_t_hi_ns` are the ends of the interval in which the axis has certainly started, by its
controller's own evidence, and `end_t_…` those of its end: ns of fleet time.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from orchestrator.model.report import JobReport, StepReport
from orchestrator.model.state import AxisEvidence, ControllerEvent, TimeInterval
from orchestrator.monitor.export.table import DataTable, make_table

COLUMNS = (
    "job_id",
    "job",
    "step",
    "step_name",
    "controller",
    "axis",
    "state",
    "verdict",
    "t0_ns",
    "start_t_lo_ns",
    "start_t_hi_ns",
    "end_t_lo_ns",
    "end_t_hi_ns",
    "planned_s",
    "lowered_s",
    "settled_s",
    "start_class",
    "skew_lo_ns",
    "skew_hi_ns",
    "skew_predicted_ns",
    "skew_allowed_ns",
)
UNITS = {column: column.rpartition("_")[2] for column in COLUMNS if column.endswith(("_ns", "_s"))}


def make_moves_table(report: JobReport, events: Sequence[ControllerEvent] = ()) -> DataTable:
    """The moves of a job. events: those recorded of its controllers; with them there are rows for the points of scans,
    of which the report has only a summary."""
    known_steps = {step.index: step for step in report.steps if step.members}
    rows = [row for step in known_steps.values() for row in _list_rows(report, step)]
    rows += _list_event_rows(report, [event for event in events if event.step not in known_steps])
    rows.sort(key=lambda row: (row["step"], row["axis"]))
    return make_table("moves", rows, COLUMNS, UNITS)


def _list_rows(report: JobReport, step: StepReport) -> Iterator[dict[str, Any]]:
    skew, budget = step.narrowest_skew, step.budget
    for controller, member in step.members.items():
        for axis in member.axes:
            yield {
                **_describe_move(report, step.index, controller, axis),
                **_describe_evidence(member.evidence.get(axis)),
                "step_name": step.name,
                "state": step.state,
                "verdict": step.verdict,
                "t0_ns": step.t0_fleet_ns,
                "planned_s": member.planned_s.get(axis),
                "lowered_s": member.lowered_s.get(axis),
                "start_class": member.start_class,
                "skew_lo_ns": None if skew is None else skew.at_least_ns,
                "skew_hi_ns": None if skew is None else skew.at_most_ns,
                "skew_predicted_ns": None if budget is None else budget.predicted_ns,
                "skew_allowed_ns": None if budget is None else budget.allowed_ns,
            }


def _list_event_rows(report: JobReport, events: Sequence[ControllerEvent]) -> Iterator[dict[str, Any]]:
    """Rows of steps that the report has no record of its own of. The last event of a step has the most evidence."""
    last: dict[tuple[int, str, str], AxisEvidence] = {}
    for event in events:
        if event.job == report.job_id and event.step is not None:
            for axis, evidence in event.evidence.items():
                last[event.step, event.controller, axis] = evidence
    for (step, controller, axis), evidence in last.items():
        yield {**_describe_move(report, step, controller, axis), **_describe_evidence(evidence)}


def _describe_move(report: JobReport, step: int, controller: str, axis: str) -> dict[str, Any]:
    name = f"{controller}.{axis}"
    return {"job_id": report.job_id, "job": report.name, "step": step, "controller": controller, "axis": name}


def _describe_evidence(evidence: AxisEvidence | None) -> Mapping[str, Any]:
    if evidence is None:
        return {}
    return {
        **_describe_interval("start", evidence.start_for_verdict),
        **_describe_interval("end", evidence.end),
        "settled_s": evidence.settled_s,
    }


def _describe_interval(what: str, interval: TimeInterval | None) -> Mapping[str, int]:
    if interval is None:
        return {}
    return {f"{what}_t_lo_ns": interval.earliest_ns, f"{what}_t_hi_ns": interval.latest_ns}
