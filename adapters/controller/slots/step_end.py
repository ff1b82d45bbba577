"""Start and end of a move as evidence: what the controller reported, in fleet time, and what differs from the plan."""

from collections.abc import Mapping

from adapters.contract import HostInterval, MoveOutcome
from adapters.controller.monitoring.settling import SettlingResult
from adapters.controller.publishing.positions import fleet_interval
from adapters.controller.state.armed_step import ArmedStep
from orchestrator.clock.fleet import FleetScale
from orchestrator.clock.interval import find_other_duration
from orchestrator.model.state import AxisEvidence, EventKind

_KIND_OF_END: dict[str, EventKind] = {"done": "done", "stopped": "stopped", "fault": "failed"}


class MotionStart:
    """The start of a move, by the controller's own evidence."""

    def __init__(self, started: Mapping[str, HostInterval], scale: FleetScale) -> None:
        self.spans = started
        self.evidence = {axis: _start_evidence(span, scale) for axis, span in started.items()}
        self.unseen = {axis for axis, span in started.items() if not span.seen}

    @property
    def text(self) -> str:
        """The start in words."""
        late_ns = max((span.late_ns for span in self.spans.values()), default=0)
        return f"started, {late_ns / 1e6:.1f} ms later than this host guarantees" if late_ns else "started"

    @property
    def seen_evidence(self) -> dict[str, AxisEvidence]:
        """The evidence of axes whose start the controller has reported."""
        return _without_axes(self.evidence, self.unseen)


class MotionEnd:
    """The end of a move: what came of it, and why it is not what was planned."""

    def __init__(self, moving: ArmedStep, begun: MotionStart, outcome: MoveOutcome, settled: SettlingResult) -> None:
        self.moving = moving
        self.outcome = outcome
        self._begun = begun
        self._settled = settled
        is_done = outcome.state == "done"
        wrong_durations = _find_wrong_durations(moving, begun.spans, outcome.ended) if is_done else {}
        wrong_ends = settled.wrong_ends if is_done else outcome.misplaced
        self.doubts = {**wrong_durations, **wrong_ends}
        """Axes that are perhaps not where their counts say, in words."""
        self.reason = settled.reason or ("; ".join(self.doubts.values()) if is_done else "")
        self.kind: EventKind = "failed" if self.reason else _KIND_OF_END[outcome.state]

    def make_evidence(self) -> dict[str, AxisEvidence]:
        """The evidence of starts and ends, by axis."""
        evidence = dict(self._begun.evidence)
        for axis, span in self.outcome.ended.items():
            if axis in evidence and span.earliest_ns <= span.latest_ns:
                end_evidence = {
                    "end": fleet_interval(span, self.moving.scale),
                    "settled_s": self._settled.settled_s.get(axis),
                }
                evidence[axis] = evidence[axis].model_copy(update=end_evidence)
        return evidence if self.outcome.state == "done" else _without_axes(evidence, self._begun.unseen)


def _find_wrong_durations(
    step: ArmedStep, started: Mapping[str, HostInterval], ended: Mapping[str, HostInterval]
) -> dict[str, str]:
    """Axes whose motion has certainly taken another time than the controller was loaded with, with a description: their
    settings or their position were changed meanwhile."""
    wrong_durations: dict[str, str] = {}
    for axis, end in ended.items():
        start, promised_s = started.get(axis), step.promised_s.get(axis)
        if start is None or promised_s is None:
            continue
        taken_s = find_other_duration(start, end, promised_s, step.clock_ppm)
        if taken_s is not None:
            wrong_durations[axis] = (
                f"axis {axis} took {taken_s:.3f} s, promised {promised_s:.3f} s: another client has changed its "
                "settings or its position; it must be homed again"
            )
    return wrong_durations


def _without_axes(evidence: Mapping[str, AxisEvidence], axes: set[str]) -> dict[str, AxisEvidence]:
    return {axis: axis_evidence for axis, axis_evidence in evidence.items() if axis not in axes}


def _start_evidence(span: HostInterval, scale: FleetScale) -> AxisEvidence:
    return AxisEvidence(start=fleet_interval(span, scale), late_ns=span.late_ns)
