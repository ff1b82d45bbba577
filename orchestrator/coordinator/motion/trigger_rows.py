"""What triggers did in a step: fetched from the owners of their outputs after it, a row for each instant.

A row states the interval promised for the edge, and the one in which it happened by evidence of its controller. Where
the axes were is what their plans make of that interval; of a motion that was not done as planned nothing is claimed
about that.
"""

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from orchestrator.coordinator.fleet.requests import ANSWER_S
from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.coordinator.motion.path_feed import PathFeed
from orchestrator.coordinator.motion.planning import PlannedStep
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import StartState
from orchestrator.coordinator.motion.trigger_places import FindPlaces, PlaceFinder, know_no_places
from orchestrator.coordinator.switching.chunked import ChunkedOutput
from orchestrator.coordinator.switching.totals import TriggerTotals, judge_triggers
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import (
    MAX_EDGES_PART,
    BudgetTerm,
    TakeTriggers,
    TriggerEdges,
    TriggersTaken,
    sum_terms,
)
from orchestrator.model.names import split_name
from orchestrator.model.operation.recording import RecordedTriggers
from orchestrator.model.report import StepReport, TriggerRow
from orchestrator.model.state import TimeInterval
from orchestrator.plan.triggers import MAX_INSTANTS

ROWS_AT_ONCE = 500  # in a message
FETCH_S = 0.02  # for each instant, at the slowest
REST_S = 6.0  # for a controller that still brakes


@dataclass(frozen=True, slots=True)
class AskedOutput:
    """An output and its instants, ns from T0. find_terms: what its owner has promised for one of them later than for
    the start. skipped_ns: instants that are passed without switching. left: instants of the plan that follow."""

    name: str
    instants_ns: Sequence[int]
    find_terms: Callable[[int], list[BudgetTerm]] = lambda _: []
    skipped_ns: Sequence[int] = ()
    left: int = 0


def ask_chunked_output(output: ChunkedOutput) -> AskedOutput:
    """An output of a path in chunks, with what was released of it up to now."""
    trigger = output.given
    name = trigger.trigger.resolved.output
    return AskedOutput(name, trigger.instants_ns, output.find_terms, trigger.skipped_ns, trigger.remaining_count)


def make_window_finder(
    output: AskedOutput, agreement: StartAgreement, state: StartState
) -> Callable[[int], tuple[int, int]]:
    """A function that tells the promised window of an edge around its instant, by its number."""
    owner, name = split_name(output.name)
    armed_reply, residual_ns = state.armed.get(owner), agreement.tick_residual_ns
    armed_terms = [] if armed_reply is None else armed_reply.triggers.get(name, [])
    armed_terms = armed_terms or agreement.proposals[owner].triggers.get(name, [])

    def find_window(number: int) -> tuple[int, int]:
        early_ns, late_ns = sum_terms(output.find_terms(number) or armed_terms)
        return early_ns - residual_ns, late_ns + residual_ns

    return find_window


@dataclass(frozen=True, slots=True)
class TriggerRows:
    """Fetches and judges what the triggers of one motion did. feed: of a path in chunks. totals: by output, of the
    step so far; the rows of a motion are added."""

    services: MotionServices
    planned: PlannedStep
    agreement: StartAgreement
    state: StartState
    feed: PathFeed | None
    totals: dict[str, TriggerTotals]

    async def add_to(self, report: StepReport, *, is_as_planned: bool) -> StepReport:
        """The report of the step with what its triggers did; the rows are published. Raises nothing.

        is_as_planned: as far as the motion came, it was; only then places of axes are stated."""
        asked_outputs = self._list_outputs()
        if not asked_outputs:
            return report
        edges, refusals = await self._fetch(asked_outputs)
        places = self._make_place_finder(report) if is_as_planned else know_no_places
        for output in asked_outputs:
            owner = split_name(output.name)[0]
            totals = self.totals.setdefault(output.name, TriggerTotals(output.name))
            output_edges = edges.get(output.name, TriggerEdges())
            for rows in self._make_parts(output, output_edges, places, totals.rows):
                self._publish(output.name, rows)
                for row in rows:
                    totals.add_row(row)
                await asyncio.sleep(0)  # other tasks have their turn
            totals.skipped += len(output.skipped_ns)
            totals.left, totals.unknown = output.left, totals.unknown or output_edges.unknown
            totals.refused = str(refusals[owner].text) if owner in refusals else ""
        return judge_triggers(report, [self.totals[output.name].make_report() for output in asked_outputs])

    def _make_place_finder(self, report: StepReport) -> FindPlaces:
        whole_plan = (self.agreement if self.feed is None else self.planned).plan
        view = self.services.fleet.view
        return PlaceFinder(view, self.agreement, whole_plan.profiles, self.feed).make_finder(report.members)

    def _list_outputs(self) -> list[AskedOutput]:
        if self.feed is not None:
            return [ask_chunked_output(output) for output in self.feed.triggers.outputs]
        triggers_by_owner = self.agreement.triggers.find_outputs(self.agreement.plan)
        return [
            AskedOutput(f"{owner}.{trigger.output}", trigger.instants_ns)
            for owner, triggers in triggers_by_owner.items()
            for trigger in triggers
        ]

    async def _fetch(self, outputs: Sequence[AskedOutput]) -> tuple[dict[str, TriggerEdges], dict[str, Refusal]]:
        """What the outputs did, by their names, in several parts; and by owner why it cannot be fetched."""
        edges: dict[str, TriggerEdges] = {}
        refusals: dict[str, Refusal] = {}
        owners = list(dict.fromkeys(split_name(output.name)[0] for output in outputs))
        most = min(MAX_INSTANTS, max(len(output.instants_ns) for output in outputs))
        first, timeout_s = 0, ANSWER_S + REST_S + most * FETCH_S
        while owners:
            replies = await self._fetch_part(owners, first, timeout_s)
            for owner, reply in replies.items():
                if reply.refused is not None:
                    refusals[owner] = reply.refused.as_error()
                for name, part in reply.outputs.items():
                    all_edges = edges.setdefault(f"{owner}.{name}", TriggerEdges(unknown=part.unknown))
                    all_edges.earliest_ns.extend(part.earliest_ns)
                    all_edges.latest_ns.extend(part.latest_ns)
            owners = [owner for owner, reply in replies.items() if reply.more and reply.refused is None]
            first, timeout_s = first + MAX_EDGES_PART, ANSWER_S
        return edges, refusals

    async def _fetch_part(self, owners: Sequence[str], first: int, timeout_s: float) -> Mapping[str, TriggersTaken]:
        request = self.planned.request
        fields = self.services.fleet.requests.request_fields(request.job.actor)
        requests = {
            owner: TakeTriggers(**fields, job=request.job_id, step=request.index, first=first) for owner in owners
        }
        return await self.services.fleet.requests.request_all("take-triggers", requests, TriggersTaken, timeout_s)

    def _make_parts(
        self, output: AskedOutput, edges: TriggerEdges, places: FindPlaces, before: int
    ) -> Iterator[list[TriggerRow]]:
        """The rows, in parts of one message each. before: how many rows the output has already."""
        instants_ns = [*output.instants_ns, *output.skipped_ns]
        spans = [
            TimeInterval(earliest_ns=earliest_ns, latest_ns=latest_ns)
            for earliest_ns, latest_ns in zip(edges.earliest_ns, edges.latest_ns, strict=True)
        ][: len(output.instants_ns)]
        windows = make_window_finder(output, self.agreement, self.state)
        for first in range(0, len(instants_ns), ROWS_AT_ONCE):
            end = min(first + ROWS_AT_ONCE, len(instants_ns))
            positions = places(spans[first:end])
            rows: list[TriggerRow] = []
            for number in range(first, end):
                planned_ns = self.state.t0_fleet_ns + instants_ns[number]
                early_ns, late_ns = windows(number)
                is_seen = number < len(spans)
                rows.append(
                    TriggerRow(
                        number=before + number + 1,
                        planned_ns=planned_ns,
                        earliest_ns=planned_ns + early_ns,
                        latest_ns=planned_ns + late_ns,
                        seen=spans[number] if is_seen else None,
                        positions=positions[number - first] if is_seen else {},
                    )
                )
            yield rows

    def _publish(self, output: str, rows: list[TriggerRow]) -> None:
        request = self.planned.request
        message = RecordedTriggers(job_id=request.job_id, step=request.index, output=output, rows=rows)
        self.services.publisher.publish_triggers(message)
