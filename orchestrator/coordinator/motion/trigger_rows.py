"""What triggers did in a step: fetched from the owners of their outputs after it, a row for each instant.

A row states the interval promised for the edge, and the one in which it happened by evidence of its controller. Where
the axes were is what their plans make of that interval and of the evidence of their starts; of a step that was not done
as planned nothing is claimed about that.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.requests import ANSWER_S
from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import StartState
from orchestrator.model.messages import OutputTrigger, TakeTriggers, TriggerEdges, TriggersTaken, sum_terms
from orchestrator.model.operation.recording import RecordedTriggers
from orchestrator.model.report import AxisPlace, StepReport, TriggerReport, TriggerRow
from orchestrator.model.state import TimeInterval
from orchestrator.plan.triggers import make_range_finder

REPORTED_ROWS = 20
ROWS_AT_ONCE = 500  # in a message
FETCH_S = 0.02  # for each instant, at the slowest
REST_S = 6.0  # for a controller that still brakes

FindPlaces = Callable[[TimeInterval], dict[str, AxisPlace]]


@dataclass(frozen=True, slots=True)
class TriggerRows:
    """Fetches and judges what the triggers of one step did."""

    services: MotionServices
    request: StepRequest
    agreement: StartAgreement
    state: StartState

    async def add_to(self, report: StepReport) -> StepReport:
        """The report of the step with what its triggers did; the rows are published. Raises nothing."""
        asked_outputs = self.agreement.triggers.find_outputs(self.agreement.plan)
        if not asked_outputs:
            return report
        replies = await self._fetch(asked_outputs)
        places = self._make_place_finder(report)
        reports: list[TriggerReport] = []
        for owner, triggers in asked_outputs.items():
            refused_details, outputs = replies[owner].refused, replies[owner].outputs
            for trigger in triggers:
                edges = outputs.get(trigger.output, TriggerEdges())
                rows = self._make_rows(owner, trigger, edges, places)
                self._publish(f"{owner}.{trigger.output}", rows)
                summary = _sum_up(f"{owner}.{trigger.output}", rows, unknown=edges.unknown)
                reports.append(
                    summary if refused_details is None else summary.model_copy(update={"problem": refused_details.text})
                )
        return _judge(report, reports)

    async def _fetch(self, asked: Mapping[str, list[OutputTrigger]]) -> Mapping[str, TriggersTaken]:
        requests = {
            owner: TakeTriggers(
                **self.services.fleet.requests.request_fields(self.request.job.actor),
                job=self.request.job_id,
                step=self.request.index,
            )
            for owner in asked
        }
        most = max(len(trigger.instants_ns) for triggers in asked.values() for trigger in triggers)
        timeout_s = ANSWER_S + REST_S + most * FETCH_S
        return await self.services.fleet.requests.request_all("take-triggers", requests, TriggersTaken, timeout_s)

    def _make_rows(
        self, owner: str, trigger: OutputTrigger, edges: TriggerEdges, places: FindPlaces
    ) -> list[TriggerRow]:
        armed_reply, t0_ns = self.state.armed.get(owner), self.state.t0_fleet_ns
        terms = [] if armed_reply is None else armed_reply.triggers.get(trigger.output, [])
        early_ns, late_ns = sum_terms(terms or self.agreement.proposals[owner].triggers.get(trigger.output, []))
        residual_ns = self.agreement.tick_residual_ns
        rows: list[TriggerRow] = []
        for number, instant_ns in enumerate(trigger.instants_ns):
            planned_ns, interval = t0_ns + instant_ns, None
            if number < len(edges.earliest_ns):
                interval = TimeInterval(earliest_ns=edges.earliest_ns[number], latest_ns=edges.latest_ns[number])
            rows.append(
                TriggerRow(
                    number=number + 1,
                    planned_ns=planned_ns,
                    earliest_ns=planned_ns + early_ns - residual_ns,
                    latest_ns=planned_ns + late_ns + residual_ns,
                    seen=interval,
                    positions={} if interval is None else places(interval),
                )
            )
        return rows

    def _make_place_finder(self, report: StepReport) -> FindPlaces:
        """A function that tells where the axes were in an interval of fleet time."""
        finders: dict[str, Callable[[TimeInterval], AxisPlace]] = {}
        for member, member_report in report.members.items() if report.state == "done" else ():
            proposal = self.agreement.proposals[member]
            for name, evidence in member_report.evidence.items():
                axis = f"{member}.{name}"
                error = proposal.path_error_counts.get(name, 0.0) + 1.0  # a count of rounding
                finders[axis] = self._make_axis_finder(axis, evidence.start_for_verdict, error, proposal.clock_ppm)
        return lambda interval: {axis: find(interval) for axis, find in finders.items()}

    def _make_axis_finder(
        self, axis: str, start: TimeInterval, error_counts: float, ppm: float
    ) -> Callable[[TimeInterval], AxisPlace]:
        config = self.services.fleet.view.fleet.axis(axis)
        find_range = make_range_finder(self.agreement.plan.profiles[axis])

        def find_place(seen: TimeInterval) -> AxisPlace:
            early_s = max(0, seen.earliest_ns - start.latest_ns) / NS_PER_S * (1 - ppm * 1e-6)
            late_s = max(0, seen.latest_ns - start.earliest_ns) / NS_PER_S * (1 + ppm * 1e-6)
            low, high = find_range(early_s, late_s)
            ends = sorted(count / float(config.counts_per_unit) for count in (low - error_counts, high + error_counts))
            return AxisPlace(least=ends[0], most=ends[1])

        return find_place

    def _publish(self, output: str, rows: list[TriggerRow]) -> None:
        for first in range(0, len(rows), ROWS_AT_ONCE):
            part = rows[first : first + ROWS_AT_ONCE]
            message = RecordedTriggers(job_id=self.request.job_id, step=self.request.index, output=output, rows=part)
            self.services.publisher.publish_triggers(message)


def _sum_up(output: str, rows: list[TriggerRow], *, unknown: bool) -> TriggerReport:
    row_spans = [(row, row.seen) for row in rows if row.seen is not None]
    rows_outside = [
        row for row, span in row_spans if span.latest_ns < row.earliest_ns or span.earliest_ns > row.latest_ns
    ]
    return TriggerReport(
        output=output,
        planned=len(rows),
        seen=len(row_spans),
        outside=len(rows_outside),
        widest_ns=max((span.latest_ns - span.earliest_ns for _, span in row_spans), default=0),
        rows=rows[:REPORTED_ROWS],
        problem="of one more edge it is not known whether it happened" if unknown else "",
    )


def _judge(report: StepReport, triggers: list[TriggerReport]) -> StepReport:
    """The report with its triggers. A step that is done although triggers were missed differs from its plan."""
    deviations = list(report.deviations)
    for trigger in triggers if report.state == "done" else ():
        if trigger.seen < trigger.planned:
            text = f"{trigger.output}: {trigger.seen} of {trigger.planned} triggers are known to have happened"
            deviations.append(text + (f" ({trigger.problem})" if trigger.problem else ""))
        if trigger.outside:
            deviations.append(
                f"{trigger.output}: {trigger.outside} of {trigger.planned} triggers were not within the promise"
            )
    worse = deviations != report.deviations and report.verdict != "none"
    update = {"triggers": triggers, "deviations": deviations, "verdict": "red" if worse else report.verdict}
    return report.model_copy(update=update)
