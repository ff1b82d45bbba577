"""Supervision of a motion step from its start to its end."""

import asyncio
from collections.abc import Mapping

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.fleet.permits import PermitWatch
from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.coordinator.motion.path_feed import PathFeed
from orchestrator.coordinator.motion.planning import PlannedStep
from orchestrator.coordinator.motion.report import find_t0, make_member_report, narrow_evidence
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import StartState
from orchestrator.model.report import MemberReport
from orchestrator.model.state import ControllerEvent, ReadPosition

STARTED_NS = 400 * NS_PER_MS  # after T0: by then every member has reported its start
STARTED_TURN_NS = 150 * NS_PER_MS  # added for each other controller on its line
SETTLE_NS = 3 * NS_PER_S  # after the planned end: by then every member has reported its end
LOGGED_NS = 40 * NS_PER_S  # for the log of a silent member: a router that hangs is restarted after some 25 s
POLL_S = 0.05
LOOK_NS = round(POLL_S * NS_PER_S)

Failure = tuple[str, str]
"""The kind of event that ended the step, and the reason."""


class StepWatch:
    """Waits for the start and the end of every member.

    reports: by member. failure: why the step must be stopped, None if it is done. paused: a feed hold ended it.
    """

    def __init__(
        self,
        services: MotionServices,
        planned: PlannedStep,
        agreement: StartAgreement,
        state: StartState,
        permit_watch: PermitWatch,
    ) -> None:
        self._services = services
        self._planned = planned
        self._agreement = agreement
        self._state = state
        self._permit_watch = permit_watch
        self._waiting_start = set[str]()
        self._waiting_end = set[str]()
        self._due_ns = 0
        self._is_missing_members = False
        self._looked_ns = 0
        self._events: asyncio.Queue[ControllerEvent | None] = asyncio.Queue()
        self._removals = [
            services.fleet.view.add_event_listener(self._queue_event),
            services.fleet.permits.add_loss_listener(lambda: self._events.put_nowait(None)),
        ]
        self.reports: dict[str, MemberReport] = {}
        self.positions: dict[str, ReadPosition] = {}
        """By axis, where its controller has read it at rest behind the step."""
        self.failure: Failure | None = None
        self.paused = False
        self.feed: PathFeed | None = None
        """Of a path that becomes longer while it is executed."""

    def close(self) -> None:
        """Remove the listeners."""
        for remove in self._removals:
            remove()

    def set_durations(self, ends_s: Mapping[str, float]) -> None:
        """Set how long members move, from T0, as they have stated last."""
        for member, end_s in ends_s.items():
            report = self.reports[member]
            lowered_s = dict.fromkeys(report.lowered_s, end_s)
            self.reports[member] = report.model_copy(update={"lowered_s": lowered_s, "planned_s": lowered_s})

    def extend(self, member: str, end_s: float) -> None:
        """A member goes to another target on the way, and moves until `end_s` after T0."""
        self.set_durations({member: end_s})
        self._due_ns = self._state.t0_fleet_ns + round(end_s * NS_PER_S)

    async def run(self) -> None:
        """Return as soon as all members have ended, or one has failed."""
        agreement, fleet = self._agreement, self._services.fleet.view.fleet
        self._waiting_start, self._waiting_end = set(agreement.proposals), set(agreement.proposals)
        longest_s = max(max(proposal.durations_s.values(), default=0.0) for proposal in agreement.proposals.values())
        axes = [fleet.axis(axis) for axis in agreement.plan.profiles]
        settle_s = max((axis.in_position_timeout_s for axis in axes if axis.done == "in_position"), default=0.0)
        self._due_ns = self._state.t0_fleet_ns + round(longest_s * NS_PER_S)
        settle_ns = round(settle_s * NS_PER_S)
        self.reports = {
            member: make_member_report(agreement, self._state.armed[member], member) for member in agreement.proposals
        }
        while self._waiting_end and self.failure is None:
            event = await self._next_event()
            if event is not None:
                self._take_event(event)
            if self.feed is not None:
                due_ns = self._state.t0_fleet_ns + round(self.feed.chunk.stop_s * NS_PER_S)
                self._due_ns = max(self._due_ns, due_ns)
            self.failure = self.failure or self._find_loss() or self._look_for_missing(event, self._due_ns + settle_ns)

    @property
    def missed_members(self) -> list[str]:
        """Members that were missed, and may have logged their end all the same, because the planned end has passed."""
        is_over = self._services.leadership.fleet_now_ns() >= self._due_ns
        return sorted(self._waiting_end) if self._is_missing_members and is_over else []

    async def read_logs(self) -> bool:
        """Wait for what the missed members have logged; whether all have ended the step as planned. The wait ends
        with the log of each, or when one has restarted, which has lost its log, or after `LOGGED_NS`."""
        clock, missed_failure, self.failure = self._services.fleet.clock, self.failure, None
        begun_ns = clock.now_ns()
        while self._waiting_end and self.failure is None and clock.now_ns() < begun_ns + LOGGED_NS:
            event = await self._next_event()
            if event is not None:
                self._take_event(event)
            elif self._events.empty() and any(self._has_no_end(member, begun_ns) for member in self._waiting_end):
                break
        if self._waiting_end or self.failure is not None:
            self.failure = missed_failure
        return self.failure is None

    def _has_no_end(self, member: str, since_ns: int) -> bool:
        """Whether a member has no end of the step in its log, by what has arrived since `since_ns`."""
        view = self._services.fleet.view
        if view.is_silent(member):
            return False
        return self._describe_absence(member) is not None or view.has_all_events(member, since_ns)

    def _take_event(self, event: ControllerEvent) -> None:
        member = event.controller
        has_ended = event.kind == "done" or (event.kind == "stopped" and self._state.paused_by is not None)
        if event.kind == "started" or has_ended:
            self._waiting_start.discard(member)
            self._add_evidence(member, event)
        if has_ended:
            self._waiting_end.discard(member)
            self.positions.update({f"{member}.{axis}": position for axis, position in event.positions.items()})
            self.paused = self.paused or event.kind == "stopped"
        elif event.kind in ("failed", "stopped", "disarmed"):
            self.failure = (event.kind, f"{member}: {event.text}")

    def _add_evidence(self, member: str, event: ControllerEvent) -> None:
        budget = self._agreement.budget
        if budget is not None and event.kind == "started":
            self._state.t0_fleet_ns = find_t0(budget, self._state.t0_fleet_ns, event.evidence)
        t0_ns = self._state.t0_fleet_ns
        evidence = {
            axis: narrow_evidence(budget, t0_ns, member, axis_evidence)
            for axis, axis_evidence in event.evidence.items()
        }
        self.reports[member] = self.reports[member].model_copy(update={"evidence": evidence})

    def _find_loss(self) -> Failure | None:
        """What no longer holds: a permit, or a path that all members follow."""
        loss = self._permit_watch.describe_loss()
        if loss is not None:
            return "failed", loss
        if self.feed is not None and self.feed.lost is not None:
            return "failed", f"the path is not continued, and not all members can brake along it: {self.feed.lost}"
        return None

    def _look_for_missing(self, event: ControllerEvent | None, ends_ns: int) -> Failure | None:
        """Look for missing members now and then: a look at all of them with each of their events would be quadratic."""
        now_ns = self._services.fleet.clock.now_ns()
        if event is not None and now_ns < self._looked_ns + LOOK_NS:
            return None
        self._looked_ns = now_ns
        return self._find_missing(ends_ns)

    def _find_missing(self, ends_ns: int) -> Failure | None:
        """Which member is absent, or has not reported what it should have by now."""
        reason = self._describe_missing(ends_ns)
        self._is_missing_members = reason is not None
        return None if reason is None else ("failed", reason)

    def _describe_missing(self, ends_ns: int) -> str | None:
        now_ns, view = self._services.leadership.fleet_now_ns(), self._services.fleet.view
        for member in sorted(self._waiting_end):
            absence = self._describe_absence(member)
            if absence is not None:
                return f"{member}: {absence}{self._describe_others(member, absence)}"
        # Controllers on one line are polled in turn, or are armed for other jobs.
        neighbours = max(view.neighbours[member] for member in self._agreement.proposals)
        if self._waiting_start and now_ns > self._state.t0_fleet_ns + STARTED_NS + neighbours * STARTED_TURN_NS:
            return f"{min(self._waiting_start)}: promised, but has not started"
        if self._waiting_end and now_ns > ends_ns + SETTLE_NS:
            return f"{min(self._waiting_end)}: has not reached its end"
        return None

    def _queue_event(self, event: ControllerEvent) -> None:
        """Queue an event of this step: those of other jobs wake nothing."""
        request = self._planned.request
        is_ours = (event.job, event.step) == (request.job_id, request.index)
        if is_ours and event.controller in self._agreement.proposals:
            self._events.put_nowait(event)

    def _describe_absence(self, member: str) -> str | None:
        return self._services.fleet.view.describe_absence(member, self._planned.instances.get(member))

    def _describe_others(self, member: str, absence: str) -> str:
        """How many other members of its host are gone as well: their host is the cause."""
        controllers = self._services.fleet.view.fleet.controllers
        host = controllers[member].host
        names = [name for name in self._waiting_end if name != member and controllers[name].host == host]
        count = sum(self._describe_absence(name) == absence for name in names)
        return f" (as with {count} more of host {host})" if count else ""

    async def _next_event(self) -> ControllerEvent | None:
        """The next event of this step; None after a while, or when a permit was lost."""
        try:
            async with asyncio.timeout(POLL_S):
                event = await self._events.get()
        except TimeoutError:
            return None
        if event is None:
            return None
        # Members that were armed again have reported that they were disarmed before; unloading may have taken a while.
        since_ns = max(self._state.arming_fleet_ns, self._state.promised_fleet_ns)
        stale = event.kind == "disarmed" and event.fleet_ns is not None and event.fleet_ns < since_ns
        return None if stale else event
