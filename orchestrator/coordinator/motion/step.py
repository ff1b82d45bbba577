"""A motion step: plan, negotiate, start in two phases, watch, report."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Protocol

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.executor import run_while_recording
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.motion.armed_start import ArmedStart
from orchestrator.coordinator.motion.chain import BetweenSteps, PresentMove
from orchestrator.coordinator.motion.immediate_start import ImmediateStart
from orchestrator.coordinator.motion.negotiation import StartAgreement, agree_on_start
from orchestrator.coordinator.motion.path_feed import PathFeed
from orchestrator.coordinator.motion.planning import (
    PathRest,
    PlannedStep,
    StepRequest,
    plan_request,
    plan_resumed,
    plan_take_up,
)
from orchestrator.coordinator.motion.recorder import StepRecorder
from orchestrator.coordinator.motion.report import add_return, judge_completed_step, make_step_report
from orchestrator.coordinator.motion.sampling import StepSampler
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import FEED_HOLD, StartSequence, StateCallback
from orchestrator.coordinator.motion.trigger_rows import TriggerRows
from orchestrator.coordinator.motion.watch import StepWatch
from orchestrator.coordinator.switching.totals import TriggerTotals
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import RefusalDetails
from orchestrator.model.report import PathStop, StepRecording, StepReport
from orchestrator.model.steps.kinds import Motion
from orchestrator.plan.flying.path import FlightPath
from orchestrator.plan.racks import bound_racks
from orchestrator.plan.virtual_bound import bound_virtual_axes

BRAKED = "braked"  # code of a path that was braked along it, because a chunk was not loaded in time
MAX_STOPS = 3  # of one path, after which it ends


class StepObserver(Protocol):
    """Receives the progress of a step."""

    @property
    def on_state(self) -> StateCallback:
        """Called with each new state of the job, and its reason."""
        ...

    @property
    def on_started(self) -> Callable[[int, float], None]:
        """Called with T0 (fleet ns) and the planned duration (s) once all members are released."""
        ...


async def rehearse_step(services: MotionServices, planned: PlannedStep) -> StartAgreement:
    """What the members make of a planned step: durations, budget, commands. Raises `Refusal`."""
    _, agreement = await agree_on_start(services, planned)
    return agreement


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """A planned step that its members have agreed on, and the parts that start it and watch it."""

    planned: PlannedStep
    agreement: StartAgreement
    start: StartSequence
    watch: StepWatch
    feed: PathFeed | None = None

    @classmethod
    async def agree(
        cls, services: MotionServices, planned: PlannedStep, present: PresentMove | None = None
    ) -> "PlannedMotion":
        """Negotiate with the members. Raises `Refusal`. present: the moving step that it follows."""
        negotiation, agreement = await agree_on_start(services, planned, present)
        certificates, ends_s = services.fleet.certificates, _find_duration_s(planned, agreement)
        certificates.require_until(agreement.members, agreement.lead_ns / NS_PER_S + ends_s)
        stop_times_ns = {
            name: proposal.costs.stop_ns for name, proposal in agreement.proposals.items() if proposal.costs
        }
        services.stop_times_ns.update(stop_times_ns)
        # Events and permits count from before arming: a stop, or the loss of a permit, may come at any moment.
        permit_watch = services.fleet.permits.watch_losses(agreement.plan.profiles)
        start: StartSequence
        if planned.request.wait is not None:
            start = ArmedStart(services, planned, negotiation, agreement, permit_watch)
        else:
            make_start = ImmediateStart if can_start_at_once(planned, agreement) else StartSequence
            start = make_start(services, planned.request, negotiation, agreement, permit_watch)
        feed = PathFeed(services, planned.request, agreement, start.state) if agreement.first is not None else None
        watch = StepWatch(services, planned, agreement, start.state, permit_watch)
        watch.feed = feed
        return cls(planned, agreement, start, watch, feed)

    @property
    def duration_s(self) -> float:
        """From T0 to the end, as planned."""
        return _find_duration_s(self.planned, self.agreement)

    def make_present(self, between: BetweenSteps) -> PresentMove:
        """The step as the one that another step follows; once T0 is decided."""
        t0_ns, agreement = self.start.state.t0_fleet_ns, self.agreement
        return PresentMove(
            self.planned.request.index,
            t0_ns + agreement.longest_ns(with_start=True),
            t0_ns + agreement.longest_ns(with_start=False),
            between,
        )

    @property
    def leaves_path(self) -> bool:
        """Whether a feed hold would leave its path: a member has all of it loaded, and brakes by itself."""
        first = self.agreement.first
        return self.planned.path is not None and (first is None or not first.covers_all)

    async def feed_hold(self, fleet: FleetAccess, actor: str, *, begun: bool = True) -> None:
        """Prevent the start, and brake the members, once: on a path along it. begun: they may be moving, or about
        to."""
        state = self.start.state
        if state.paused_by is None:
            state.paused_by = actor
            if begun and self.feed is not None:
                await self.feed.hold(actor)
            elif begun:
                await fleet.stop_members(self.agreement.actors, "feed-hold", actor, f"paused by {actor}")


def can_start_at_once(planned: PlannedStep, agreement: StartAgreement) -> bool:
    """Whether a step starts as soon as its controller can. Raises `Refusal` for one that shall, and cannot."""
    move, present = planned.request.move, agreement.present
    if move.agrees_start:
        return False
    obstacle = _find_obstacle(planned, agreement)
    if obstacle and move.wants_start_at_once:
        remedy = "use `start: agreed`, or leave it out"
        raise Refusal("start-class", f"the step cannot start at once: {obstacle}", remedy)
    # Behind a dwell it starts at the end of that, which is an instant.
    return not obstacle and (present is None or not (present.between.pause_ns or present.between.acts))


def _find_obstacle(planned: PlannedStep, agreement: StartAgreement) -> str:
    """Why the start of a step needs an agreement; empty: it needs none."""
    members = agreement.members
    if len(members) != 1:
        return f"it has {len(members)} controllers ({', '.join(members)}), which start together"
    if agreement.triggers.owners:
        return "outputs are switched on its way (`triggers`), at instants that are agreed ahead"
    if planned.request.move.align:
        return "`align` waits for an instant"
    if not agreement.proposals[members[0]].starts_at_once:
        return f"{members[0]} cannot: its make starts at an agreed instant, or its adapter host is of an older version"
    return ""


def _find_duration_s(planned: PlannedStep, agreement: StartAgreement) -> float:
    first = agreement.first
    return agreement.plan.duration_s if first is None else first.course.duration_s - planned.begun_s


def _is_resumed(move: Motion, report: StepReport) -> bool:
    """Whether a path that was braked goes on from there; a scan begins again before what was disturbed."""
    return report.refused is not None and report.refused.code == BRAKED and not isinstance(move, FlightPath)


class MotionStep:
    """One motion step of a job. After a feed hold, `run` again continues to the same targets."""

    def __init__(self, services: MotionServices, request: StepRequest) -> None:
        self._services = services
        self._request = request
        self._goal: Mapping[str, Fraction] = {}
        self._next_goal: Mapping[str, Fraction] = {}
        """Other targets that it has got; they count from its next plan on."""
        self._motion: PlannedMotion | None = None
        self._rest: PathRest | None = None
        self._stops: list[PathStop] = []
        self.switched: dict[str, TriggerTotals] = {}  # by output, up to the end of its last motion

    @property
    def request(self) -> StepRequest:
        """Its number, its move and its job."""
        return self._request

    @property
    def goal(self) -> Mapping[str, Fraction]:
        """The exact targets that its axes have, motor positions; empty while they are not planned yet."""
        return self._next_goal or self._goal

    @property
    def is_retargeted(self) -> bool:
        """Whether it has got other targets than those it was planned for."""
        return bool(self._next_goal)

    def retarget(self, goal: Mapping[str, Fraction]) -> None:
        """Go to other targets, from its next plan on: `run` again, once it is braked."""
        self._next_goal = goal

    def take_motion(self, motion: PlannedMotion, changed: PlannedMotion) -> None:
        """`motion` continues to other targets on the way, as `changed` states. Raises `Refusal`: it is over."""
        if self._motion is not motion:
            raise Refusal("late", "the motion has ended")
        self._motion = changed
        self._goal = changed.planned.resolved.goal

    @property
    def motion(self) -> PlannedMotion | None:
        """Its plan and start, once it is planned; None when it is over."""
        return self._motion

    async def run(self, observer: StepObserver, seen_ns: int | None) -> StepReport:
        """Run the step to its end; the report tells how it went. Raises `Refusal` when nothing has moved.

        seen_ns: since when nothing has been done with its axes; None: unknown. A path that was braked because a chunk
        came too late goes on from there.
        """
        report = await self._run_to_target(observer, seen_ns)
        while _is_resumed(self._request.move, report) and len(self._stops) <= MAX_STOPS:
            report = await self._run_to_target(observer, None)
        if report.path is not None and self._stops:
            report = report.model_copy(update={"path": report.path.model_copy(update={"stops": self._stops})})
        return report

    async def _plan(self, seen_ns: int | None) -> PlannedStep:
        if self._rest is not None:
            return await plan_resumed(self._services, self._rest)
        if self._next_goal:
            self._goal, self._next_goal = self._next_goal, {}
        return await plan_request(self._services, self._request, self._goal, seen_ns)

    async def _run_to_target(self, observer: StepObserver, seen_ns: int | None) -> StepReport:
        """Run the motion of the step, with those that play needs before and behind it."""
        planned_step = await self._plan_once(observer, seen_ns)
        if planned_step.resolved.take_ups:
            report = await self._run_once(observer, plan_take_up(planned_step))
            if report.state != "done":
                return report
            planned_step = await self._plan_once(observer, None)
        return await self._return(observer, await self._run_once(observer, planned_step), planned_step)

    async def _return(self, observer: StepObserver, report: StepReport, planned: PlannedStep) -> StepReport:
        """Bring axes that were moved beyond their targets back to these; the report of the step, whose motion was done
        with `report`."""
        if report.state != "done" or not planned.resolved.overruns or self.is_retargeted:
            return report
        planned_return = await self._plan_once(observer, None)
        return_report = await self._run_once(observer, replace(planned_return, triggers=()))
        return add_return(report, return_report)

    async def _plan_once(self, observer: StepObserver, seen_ns: int | None) -> PlannedStep:
        planned_step = await run_while_recording(observer.on_state("planning", ""), self._plan(seen_ns))
        self._goal = planned_step.resolved.goal
        return planned_step

    async def _run_once(self, observer: StepObserver, planned_step: PlannedStep) -> StepReport:
        services, request = self._services, self._request
        if not planned_step.plan.profiles:
            return _make_standing_report(services, planned_step)
        motion = self._motion = await PlannedMotion.agree(services, planned_step)
        whole_plan = (
            planned_step.plan if planned_step.path is not None and not planned_step.begun_s else motion.agreement.plan
        )
        recorder = StepRecorder(services.fleet.view, whole_plan.profiles)
        sampler = StepSampler(services, request)
        try:
            await sampler.begin(motion.duration_s, motion.agreement.lead_ns)
            await motion.start.run(observer.on_state)
        except BaseException as error:
            self._end_motion(motion)
            recorder.close()
            if isinstance(error, Refusal):
                # A member that was stopped while it was being armed refuses for a reason of its own.
                motion.start.state.require_not_paused()
            else:
                await motion.start.disarm_line_driver()
            raise
        report = await self._watch_motion(motion, observer, recorder)
        report = report.model_copy(update={"sampling": await sampler.take()})
        is_as_planned = report.state == "done" or (self._rest is not None and self._rest.planned is motion.planned)
        rows = TriggerRows(services, motion.planned, motion.agreement, motion.start.state, motion.feed, self.switched)
        return await rows.add_to(report, is_as_planned=is_as_planned)

    async def run_released(self, motion: PlannedMotion, observer: StepObserver) -> StepReport:
        """Watch a step that was released behind the one before it, to its end; otherwise like `run`."""
        self._motion = motion
        self._goal = motion.planned.resolved.goal
        recorder = StepRecorder(self._services.fleet.view, motion.agreement.plan.profiles)
        report = await self._watch_motion(motion, observer, recorder)
        return await self._return(observer, report, motion.planned)

    async def feed_hold(self, actor: str) -> None:
        """Brake the step if it is being started or moving; `run` then reports it as stopped."""
        if self._motion is not None:
            await self._motion.feed_hold(self._services.fleet, actor)

    @property
    def armed_start(self) -> ArmedStart | None:
        """Its start, if it waits armed, or did."""
        start = None if self._motion is None else self._motion.start
        return start if isinstance(start, ArmedStart) else None

    @property
    def is_path(self) -> bool:
        """Whether it moves along a path."""
        return self._request.move.follows_path

    async def override(self, rate: float) -> None:
        """Play a path at another rate. Raises `Refusal`."""
        feed = self._motion.feed if self._motion is not None else None
        if feed is None:
            text = "the present step is no path whose speed can be changed while it moves"
            raise Refusal("not-on-path", text, "an override is for paths whose members all load it in chunks")
        await feed.override(rate)

    @property
    def path_times_s(self) -> tuple[float, float] | None:
        """How long it has moved on its path, and how long it will at its present speed, s; None if it is on none, or is
        being braked on it."""
        feed = self._motion.feed if self._motion is not None else None
        return None if feed is None else feed.times_s

    @property
    def line(self) -> int | None:
        """The line that runs now of the file that its path was made of; None: it is on none, or has not begun."""
        motion = self._motion
        path = None if motion is None else motion.planned.path
        if motion is None or path is None or path.lines is None or not motion.start.state.t0_fleet_ns:
            return None
        moved_s = (self._services.leadership.fleet_now_ns() - motion.start.state.t0_fleet_ns) / NS_PER_S
        if motion.feed is not None:
            return path.lines.find_line(motion.feed.chunk.clock.find_path_s(moved_s))
        return path.lines.find_line(moved_s / motion.duration_s * path.report.duration_s)

    @property
    def rate(self) -> float | None:
        """The feed override, 1.0 as planned; None where the speed cannot be changed."""
        feed = self._motion.feed if self._motion is not None else None
        return feed.rate if feed is not None and feed.covers_all else None

    def _end_motion(self, motion: PlannedMotion) -> None:
        self._motion = None
        motion.watch.close()

    async def _watch_motion(self, motion: PlannedMotion, observer: StepObserver, recorder: StepRecorder) -> StepReport:
        """Watch the members, which are released, and store what was recorded meanwhile."""
        services, request, start = self._services, self._request, motion.start
        done_report: StepReport | None = None
        feeding = TaskOwner()
        if motion.feed is not None:
            feeding.spawn(motion.feed.run())
        try:
            await observer.on_state("running", "")
            observer.on_started(start.state.t0_fleet_ns, motion.duration_s)
            await motion.watch.run()
            if self._motion is not None and self._motion.planned is not motion.planned:
                motion = self._motion
                recorder.profiles = motion.agreement.plan.profiles
            if motion.watch.failure is not None:
                await _handle_failure(services, motion, observer)
            done_report = report = await self._finish(motion)
        except asyncio.CancelledError:
            # The job was interrupted, and its members were stopped. Nothing stops the driver of a trigger line, which
            # would wait for T0, and refuse the next job until then.
            await start.disarm_line_driver()
            raise
        finally:
            feeding.cancel_all()
            self._end_motion(motion)
            recording = recorder.finish(request.index, request.move.name or "", start.state.t0_fleet_ns)
            for listener in services.listeners:
                listener(recording, done_report)
        if report.state == "done":
            for axis, (exact, counts) in motion.planned.resolved.exact.items():
                services.targets.record_target(axis, exact, counts)
        _store_recording(services, request.job_id, recording)
        return report

    def _rest_on_path(self, motion: PlannedMotion, feed: PathFeed) -> StepReport:
        """The report of a path that was braked along it, by a feed hold or because a chunk came too late: the next run
        goes on from there."""
        chunk = feed.chunk
        feed.triggers.skip_tail(chunk)
        self._rest = PathRest.behind(motion.planned, chunk, feed.rate)
        code, reason = FEED_HOLD, f"paused by {feed.held_by}"
        if feed.held_by is None:
            cause = feed.failure or Refusal("late", "the next chunk was not released in time")
            code, reason = BRAKED, f"braked on the path at {chunk.stop_path_s:.1f} s: {cause}"
            self._stops.append(
                PathStop(at_s=round(chunk.stop_path_s, 3), member=cause.controller or "", reason=str(cause))
            )
        outcome = ("stopped", reason)
        report = make_step_report(self._request, motion.agreement, motion.start.state, motion.watch.reports, outcome)
        return report.model_copy(update={"refused": RefusalDetails(code=code, text=reason)})

    async def _finish(self, motion: PlannedMotion) -> StepReport:
        """Make the report."""
        start, watch, agreement, feed = motion.start, motion.watch, motion.agreement, motion.feed
        failure, request = watch.failure, self._request
        if feed is not None:
            agreement.plan = feed.plan
            watch.set_durations(feed.ends_s)
            if failure is None and not watch.paused and not feed.is_complete:
                return self._rest_on_path(motion, feed)
        if failure is None and watch.paused:
            reason = f"paused by {start.state.paused_by}"
            report = make_step_report(request, agreement, start.state, watch.reports, ("stopped", reason))
            return report.model_copy(update={"refused": RefusalDetails(code=FEED_HOLD, text=reason)})
        view = self._services.fleet.view
        report = _make_report(view.fleet, request, motion, failure)
        if failure is not None:
            return report
        states = {member: state for member in agreement.proposals if (state := view.last_state(member)) is not None}
        return judge_completed_step(report, agreement, states).model_copy(update={"positions": watch.positions})


def _make_report(
    fleet: Fleet, request: StepRequest, motion: PlannedMotion, failure: tuple[str, str] | None
) -> StepReport:
    """The report of a step, with how far axes may have been off their lines, and motors apart. failure: what ended
    it, and why."""
    report = make_step_report(request, motion.agreement, motion.start.state, motion.watch.reports, failure)
    line = motion.planned.line
    update: dict[str, Any] = {
        "virtual": bound_virtual_axes(fleet, request.move, motion.agreement, line),
        "bounds": motion.planned.resolved.bounds,
        "racks": bound_racks(fleet, motion.agreement.plan),
        "pairs": motion.planned.pairs,
    }
    # In counts, and without a tolerance, the path that keeps curved axes on their line means nothing to a user.
    return report.model_copy(update=update if line is None else update | {"path": None})


def _store_recording(services: MotionServices, job_id: str, recording: StepRecording) -> None:
    """Publish the plan of a step that is over, and store what was recorded of it with the next record."""

    def log_error(error: JournalError) -> None:
        services.fleet.log.warning(f"a step is not recorded: {error}", job=job_id)

    services.publisher.publish_plan(job_id, recording)
    services.record_later(log_error, services.journal.store_recording, job_id, recording)


def _make_standing_report(services: MotionServices, planned: PlannedStep) -> StepReport:
    """The report of a step whose axes are at its targets already."""
    request, resolved_move = planned.request, planned.resolved
    return StepReport(
        index=request.index,
        do=request.move.do,
        name=request.move.name or "",
        state="done",
        reason="already there",
        positions=services.fleet.view.read_positions(resolved_move.goal),
        bounds=resolved_move.bounds,
    )


async def _handle_failure(services: MotionServices, motion: PlannedMotion, observer: StepObserver) -> None:
    """Stop all members, because one has failed or is missed. The step is done all the same if all have logged their
    end, as when the bus was away at that moment."""
    watch, request = motion.watch, motion.planned.request
    reason = "" if watch.failure is None else watch.failure[1]
    actors, missed_members = motion.agreement.actors, watch.missed_members
    await services.fleet.stop_members(actors, "decelerate", request.job.actor, reason)
    await motion.start.disarm_line_driver()
    if missed_members:
        names = ", ".join(missed_members)
        await observer.on_state("running", f"waits for the log of {names}, stopped at the planned end: {reason}")
        is_done = await watch.read_logs()
        outcome = "is logged" if is_done else "is not logged"
        services.fleet.log.warning(f"{reason}; the end of {names} {outcome}", job=request.job_id)
