"""A motion step: plan, propose, settle the start, arm, commit, go, watch, report (design, section 6)."""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from fractions import Fraction
from typing import Any

from orchestrator.bus.base import BusError
from orchestrator.bus.log import Log
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.clock.executor import Runs, beside
from orchestrator.coordinator.fleet.permits import Permits
from orchestrator.coordinator.fleet.requests import ANSWER_S, Members
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.journal.journal import Journal
from orchestrator.coordinator.leadership.leadership import Throne
from orchestrator.coordinator.motion.moving import Moving
from orchestrator.coordinator.motion.negotiation import Proposing, start_ways
from orchestrator.coordinator.motion.recorder import Recorder
from orchestrator.coordinator.motion.report import member_report, narrowed, step_report
from orchestrator.coordinator.motion.targets import Refuse, refuse, resolve
from orchestrator.model.job import Job, Move
from orchestrator.model.messages import (
    Arm,
    Armed,
    Commit,
    Disarm,
    Disarmed,
    Go,
    Refusal,
    Reply,
    Stop,
    StopMode,
)
from orchestrator.model.report import JobState, StepReport
from orchestrator.model.state import AxisState, ControllerState, Event, Info
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import Targets, plan_step

STARTED_NS = 400 * NS_PER_MS  # after T0: by then every member has said that it moves
STARTED_TURN_NS = 150 * NS_PER_MS  # and so much later for each other controller on its line
SETTLE_NS = 3 * NS_PER_S  # after the planned end: by then every member has said that it is there
ALIGN_EARLY_NS = 20 * NS_PER_MS  # for asking once more
HELD = "held"  # the code of a step that was held, inside or before it began: it can go on
ALIGN_ASK_NS = NS_PER_S  # nearer than this, clocks will know no better
LATE = ("late", "no-answer")  # the codes of who was not quick enough
LEADS = (None, 1, 2, 4)  # times the declared one, when arming took longer than the lead that was known to do


class Motion:
    """Runs motion steps. `on_state` is told how far the job has come."""

    def __init__(
        self,
        view: FleetView,
        members: Members,
        permits: Permits,
        throne: Throne,
        clock: Clock,
        journal: Journal,
        runs: Runs,
        log: Log,
    ) -> None:
        self._view = view
        self._members = members
        self._proposing = Proposing(view, members)
        self._permits = permits
        self._throne = throne
        self._clock = clock
        self._journal = journal
        self._runs = runs
        self._log = log
        self._under_way: dict[str, Moving] = {}
        self.targets = Targets()
        self.stops_ns: dict[str, int] = {}  # what stopping each member's last step takes at the most

    async def run(
        self,
        job_id: str,
        job: Job,
        index: int,
        step: Move,
        on_state: Callable[[JobState, str], Coroutine[Any, Any, None]],
        on_started: Callable[[int, float], None],
        goal: dict[str, Fraction],
        seen_ns: int | None,
    ) -> StepReport:
        """Run one move to its end. Raises `Refuse` when nothing has moved; else the report says how it went.

        goal: the exact targets of its axes, empty at first; given again when a step that was held goes on. seen_ns:
        since when nothing has been done with its axes; None: nobody has looked.
        """
        moving = await beside(on_state("planning", ""), self._plan(job_id, job, index, step, goal, seen_ns))
        goal.update({axis: exact for axis, (exact, _) in moving.resolved.exact.items()})
        if not moving.plan.profiles:
            return StepReport(index=index, do="move", name=step.name or "", state="done", reason="already there")
        await self._proposing.agree(moving, job, step)
        self.stops_ns |= {name: each.costs.stop_ns for name, each in moving.proposals.items() if each.costs}
        # Events and permits count from before the arming on: a stop, or an open door, may come at any moment.
        moving.guard = self._permits.guard(moving.plan.profiles)
        unlisten = self._view.listen(moving.events.put_nowait)
        unguard = self._permits.listen(lambda: moving.events.put_nowait(None))
        recorder = Recorder(self._view, moving.plan.profiles)
        self._under_way[job_id] = moving
        try:
            try:
                await self._arm_and_release(moving, job, step, on_state)
            except Refuse:
                # A member that was stopped while it was being armed says so in its own words.
                _require_not_held(moving)
                raise
            await on_state("running", "")
            on_started(moving.t0_fleet_ns, moving.plan.duration_s)
            report = await self._watch(moving, step)
        finally:
            del self._under_way[job_id]
            unlisten()
            unguard()
            recording = recorder.done(index, step.name or "", moving.t0_fleet_ns)
        await self._runs(self._journal.record, job_id, recording)
        if report.state == "done":
            for axis, (exact, counts) in moving.resolved.exact.items():
                self.targets.reached(axis, exact, counts)
        return report

    async def dry_run(self, job: Job, index: int, step: Move) -> dict[str, Any]:
        """Durations, budget and what each controller would be sent. Raises `Refuse`."""
        moving = await self._plan("dry-run", job, index, step, {}, None)
        if moving.plan.profiles:
            await self._proposing.agree(moving, job, step)
        return {
            "duration_s": moving.plan.duration_s,
            "budget": moving.budget.to_plain() if moving.budget else None,
            "commands": {member: proposal.commands for member, proposal in moving.proposals.items()},
        }

    async def hold(self, job_id: str, actor: str) -> None:
        """Brake the motion step that the job is in, if it is in one; `run` then reports it as stopped."""
        moving = self._under_way.get(job_id)
        if moving is not None and moving.held_by is None:
            moving.held_by = actor
            await self.stop(moving.movers, "hold", actor, f"held by {actor}")

    # Plan

    async def _plan(
        self, job_id: str, job: Job, index: int, step: Move, goal: Mapping[str, Fraction], seen_ns: int | None
    ) -> Moving:
        names = list(step.to | step.by)
        members = list(dict.fromkeys(name.partition(".")[0] for name in names))
        states: dict[str, AxisState] = {}
        infos: dict[str, Info] = {}
        instances: dict[str, str] = {}
        looks = await asyncio.gather(*(self._look(member, seen_ns) for member in members))
        for member, (state, info) in zip(members, looks, strict=True):
            infos[member], instances[member] = info, state.instance
            states |= {f"{member}.{axis}": each for axis, each in state.axes.items()}
        missing = self._permits.missing(names)
        if missing is not None:
            raise Refuse("permit", missing, "bring it about, then submit again")
        resolved = resolve(step, self._view.fleet, states, infos, self.targets, goal)
        try:
            plan = plan_step(resolved.moves, step.sync, step.speed, step.ramps)
        except PlanError as error:
            raise Refuse("plan", str(error)) from None
        return Moving(job_id, index, job.actor, resolved, plan, instances, aligned=bool(step.align))

    async def _look(self, member: str, seen_ns: int | None) -> tuple[ControllerState, Info]:
        try:
            state, info = await self._view.fresh(member, seen_ns), await self._view.info(member)
        except BusError as error:
            raise Refuse("absent", f"{member}: {error}", "is its adapter host running?", member) from None
        if state.mode == "offline":
            fault = state.faults[0] if state.faults else None
            raise Refuse(
                "offline",
                f"{member} can not be reached: {fault.text if fault else 'no link'}",
                fault.remedy if fault else "check its link",
                member,
            )
        return state, info

    # Arm, commit, go

    async def _arm_and_release(
        self,
        moving: Moving,
        job: Job,
        step: Move,
        on_state: Callable[[JobState, str], Coroutine[Any, Any, None]],
    ) -> None:
        """Load all and let them go. Who is late while nothing has moved is armed again, with more lead."""
        late = Refuse("late", "", "")
        for growth in LEADS:
            _require_not_held(moving)
            if growth is not None:
                self._log.warning(f"late; arming again with more lead ({late.refusal.text})", job=moving.job_id)
                await self._proposing.again(moving, step, growth)
            elif step.align:
                await on_state("arming", "")
                await self._await_alignment(moving, step)
            moving.arming_fleet_ns = self._throne.fleet_now_ns()
            moving.sooner_ns = moving.slip_ns = 0
            moving.t0_fleet_ns = self._proposing.start(moving, moving.arming_fleet_ns + moving.lead_ns, 0)
            try:
                await beside(on_state("arming", ""), self._arm(moving, step))
                await self._judge_frozen(moving, job, step)
                await self._require_time(moving, "arming took longer than was allowed for")
                await self._release(moving, job, step, on_state, 2 * (growth or 0) or 1)
            except Refuse as refused:
                # Who does not answer may be busy.
                if refused.refusal.code not in LATE or not moving.unloaded:
                    raise
                late = refused
                if moving.decided:
                    await self._withdraw(moving)
            else:
                return
        text = f"arming takes longer than the members say, however long the lead: {late.refusal.text}"
        raise Refuse("late", text, "see the log of the adapters, and the load of this machine", late.refusal.member)

    async def _withdraw(self, moving: Moving) -> None:
        """A decision stands for one start alone. Nobody has begun, and all have said so: it is taken back, and the next
        arming gets one of its own."""
        await self._runs(self._journal.withdraw, moving.job_id, moving.index, moving.t0_fleet_ns)
        moving.decided = False

    async def _release(
        self,
        moving: Moving,
        job: Job,
        step: Move,
        on_state: Callable[[JobState, str], Coroutine[Any, Any, None]],
        room: int,
    ) -> None:
        """Have all promise, settle T0, write down that they go, and let them. Raises `Refuse`: all are unloaded or
        stopped. room: times what go is given; beyond that, what is left of the lead is not waited for."""
        armed_ns = self._clock.now_ns()
        await beside(on_state("armed", ""), self._commit(moving))
        if moving.held_by is not None:
            await self._disarm(moving)
            _require_not_held(moving)
        lost = moving.lost_permit()
        if lost is not None:
            await self._disarm(moving)
            raise Refuse("permit", lost, "bring it about, then submit again")
        # Behind the decision who is late has failed; before it, all are armed again.
        pace, promised_ns = self._proposing.pace, self._clock.now_ns()
        try:
            await self._require_time(moving, "promises took longer than was allowed for")
        except Refuse:
            pace.late(promised_ns - armed_ns, len(moving.proposals))
            raise
        moving.settled_fleet_ns = self._throne.fleet_now_ns()
        go_ns = room * pace.go_ns(len(moving.proposals), promised_ns - armed_ns)
        self._proposing.settle(moving, job, step, moving.settled_fleet_ns + go_ns)
        epoch, members, utc = self._throne.epoch, ",".join(moving.proposals), self._clock.utc()
        await self._runs(self._journal.decide, moving.job_id, moving.index, epoch, moving.t0_fleet_ns, members, utc)
        if self._throne.over:
            await self._disarm(moving)
            raise Refuse("deposed", "another coordinator has taken over")
        moving.decided = True
        await beside(on_state("committed", ""), self._go(moving))
        pace.released(self._clock.now_ns() - armed_ns, self._clock.now_ns() - promised_ns)

    async def _require_time(self, moving: Moving, late: str) -> None:
        """For what is still to be done, and then for unloading all if that fails. Raises `Refuse`: all are unloaded."""
        needs_ns = self._proposing.pace.go_ns(len(moving.proposals))
        if self._throne.fleet_now_ns() + needs_ns + moving.disarm_ns >= moving.t0_fleet_ns:
            await self._disarm(moving)
            raise Refuse("late", late)

    async def _await_alignment(self, moving: Moving, step: Move) -> None:
        """Wait until arming leads to the moment at which the members' ticks fall closest together. They are asked
        again on the way, because the nearer it is, the better do they know when."""
        ends_ns = self._throne.fleet_now_ns() + moving.lead_ns + step.align
        while True:
            soonest_ns = self._throne.fleet_now_ns() + moving.lead_ns
            best_ns = self._proposing.start(moving, soonest_ns, max(0, ends_ns - soonest_ns))
            wait_ns = best_ns - soonest_ns - ALIGN_EARLY_NS
            await sleep_ns(self._clock, max(0, wait_ns if wait_ns < ALIGN_ASK_NS else wait_ns // 2))
            await self._proposing.again(moving, step, None)
            if wait_ns < ALIGN_ASK_NS:
                return

    async def _arm(self, moving: Moving, step: Move) -> None:
        ends_ns = moving.t0_fleet_ns + round(moving.plan.duration_s * NS_PER_S)
        end_ns = self._proposing.start(moving, ends_ns, 0) - moving.t0_fleet_ns
        requests = {
            member: Arm(
                **self._ref(moving),
                digest=self._view.fleet.controllers[member].digest,
                t0_fleet_ns=moving.t0_ns(member),
                profiles=moving.profiles(member),
                start=way.model_copy(update={"end_ns": end_ns}),
            )
            for member, way in start_ways(moving, step, moving.proposals).items()
        }
        declared_ns = {name: each.costs.arm_ns if each.costs else 0 for name, each in moving.proposals.items()}
        timeout_s = ANSWER_S + 2 * max(declared_ns.values()) / NS_PER_S
        took_ns = dict[str, int]()
        moving.armed = await self._members.ask_all("arm", requests, Armed, timeout_s, answered=took_ns.__setitem__)
        await self._disarm_if_refused(moving, moving.armed)
        self._proposing.pace.armed(declared_ns, took_ns)

    async def _judge_frozen(self, moving: Moving, job: Job, step: Move) -> None:
        """Once more, with the clock mappings that are frozen into what is armed."""
        try:
            self._proposing.judge(moving, moving.armed, job, step)
        except Refuse:
            await self._disarm(moving)
            raise

    async def _commit(self, moving: Moving) -> None:
        requests = {
            member: Commit(**self._ref(moving), t0_fleet_ns=moving.t0_ns(member)) for member in moving.proposals
        }
        left_ns = moving.t0_fleet_ns - self._throne.fleet_now_ns()
        # Later there would be no time left for go.
        useful_ns = left_ns - self._proposing.pace.go_ns(len(moving.proposals)) - moving.disarm_ns
        wait_s = max(0.02, min(ANSWER_S, max(left_ns / 2, useful_ns) / NS_PER_S))
        promises = await self._members.ask_all("commit", requests, Reply, wait_s)
        await self._disarm_if_refused(moving, promises)

    async def _go(self, moving: Moving) -> None:
        """After the decision: a member that can not go makes all others stop before, or just after, they begin."""
        slack_ns = moving.slack_ns
        requests = {
            member: Go(
                **self._ref(moving),
                t0_fleet_ns=moving.t0_ns(member),
                sooner_ns=moving.sooner_ns,
                slack_ns=slack_ns,
            )
            for member in moving.proposals
        }
        left_s = (moving.t0_fleet_ns - self._throne.fleet_now_ns()) / NS_PER_S
        # Whoever has not answered by then is given up while the others can still be unloaded.
        wait_s = max(0.02, min(ANSWER_S, max(left_s / 2, left_s - moving.disarm_ns / NS_PER_S)))
        released = await self._members.ask_all("go", requests, Reply, wait_s)
        if any(reply.refused is not None and reply.refused.code in LATE for reply in released.values()):
            self._proposing.pace.late_to_go(len(moving.proposals))
        await self._disarm_if_refused(moving, released)

    async def _disarm_if_refused(self, moving: Moving, replies: Mapping[str, Reply]) -> None:
        refused = next((reply.refused for reply in replies.values() if reply.refused is not None), None)
        if refused is None:
            return
        await self._disarm(moving)
        raise refuse(refused)

    async def _disarm(self, moving: Moving) -> None:
        """Unload all, each for itself: a member that says it moves already, or says nothing, is stopped as well, and
        no other one's silence holds that up."""
        movers = moving.movers
        moving.unloaded = True

        async def unload(member: str) -> None:
            reply = await self._members.ask(member, "disarm", Disarm(**self._ref(moving)), Disarmed, ANSWER_S)
            moving.unloaded = moving.unloaded and not reply.begun
            if reply.refused is not None and member in movers:
                moving.unloaded = False
                await self.stop([member], "decelerate", moving.actor, "disarm did not succeed")

        await asyncio.gather(*(unload(member) for member in moving.proposals))

    # Watch and report

    async def _watch(self, moving: Moving, step: Move) -> StepReport:
        """Wait for every member's start and end; stop all as soon as one fails."""
        waiting_start = set(moving.proposals)
        waiting_end = set(moving.proposals)
        longest_s = max(max(proposal.durations_s.values(), default=0.0) for proposal in moving.proposals.values())
        settling = [self._view.fleet.axis(axis) for axis in moving.plan.profiles]
        settle_s = max((axis.in_position_timeout_s for axis in settling if axis.done == "in_position"), default=0.0)
        ends_ns = moving.t0_fleet_ns + round((longest_s + settle_s) * NS_PER_S)
        reports = {member: member_report(moving, member) for member in moving.proposals}
        failure: tuple[str, str] | None = None
        held = False
        while waiting_end and failure is None:
            event = await self._next_event(moving)
            if event is not None:
                member = event.controller
                ends = event.kind == "done" or (event.kind == "stopped" and moving.held_by is not None)
                if event.kind == "started" or ends:
                    waiting_start.discard(member)
                    evidence = {axis: narrowed(moving, member, each) for axis, each in event.evidence.items()}
                    reports[member] = reports[member].model_copy(update={"evidence": evidence})
                if ends:
                    waiting_end.discard(member)
                    held = held or event.kind == "stopped"
                elif event.kind in ("failed", "stopped", "disarmed"):
                    failure = (event.kind, f"{member}: {event.text}")
            failure = failure or self._overdue(moving, waiting_start, waiting_end, ends_ns)
        if held and failure is None:
            by = f"held by {moving.held_by}"
            report = step_report(moving, step, reports, ("stopped", by))
            return report.model_copy(update={"refused": Refusal(code=HELD, text=by)})
        if failure is not None:
            await self.stop(moving.movers, "decelerate", moving.actor, failure[1])
            if moving.line is not None and moving.line.driver not in moving.movers:
                # It may be moving for another job.
                disarm = Disarm(**self._ref(moving))
                await self._members.ask(moving.line.driver, "disarm", disarm, Reply, ANSWER_S)
        return step_report(moving, step, reports, failure)

    def _overdue(
        self, moving: Moving, waiting_start: set[str], waiting_end: set[str], ends_ns: int
    ) -> tuple[str, str] | None:
        """What has not happened although it should have by now."""
        now_ns = self._throne.fleet_now_ns()
        for member in sorted(waiting_end):
            gone = self._view.gone(member, moving.instances.get(member))
            if gone is not None:
                return "failed", f"{member}: {gone}"
        lost = moving.lost_permit()
        if lost is not None:
            return "failed", lost
        # Those on one line are asked in turns whether they have started, or are armed for other jobs.
        in_turns = max(self._view.others[member] for member in moving.proposals)
        if waiting_start and now_ns > moving.t0_fleet_ns + STARTED_NS + in_turns * STARTED_TURN_NS:
            return "failed", f"{min(waiting_start)}: promised, and has not started"
        if waiting_end and now_ns > ends_ns + SETTLE_NS:
            return "failed", f"{min(waiting_end)}: has not come to its end"
        return None

    async def _next_event(self, moving: Moving) -> Event | None:
        """The next event about this step; None after a while, or when a permit was lost."""
        try:
            async with asyncio.timeout(0.05):
                event = await moving.events.get()
        except TimeoutError:
            return None
        if event is None:
            return None
        about = (event.job, event.step) == (moving.job_id, moving.index) and event.controller in moving.proposals
        # Members that were armed anew have said before that they are disarmed.
        stale = event.kind == "disarmed" and event.fleet_ns is not None and event.fleet_ns < moving.arming_fleet_ns
        return event if about and not stale else None

    async def stop(self, members: list[str], mode: StopMode, actor: str, reason: str) -> None:
        """Stop members, all at once; who does not answer is asked again, and logged in the end."""
        requests = {
            member: Stop(request_id=self._members.new_id(), actor=actor, mode=mode, reason=reason) for member in members
        }
        replies = await self._members.ask_all("stop", requests, Reply, insist=True)
        for member, reply in replies.items():
            if reply.refused is not None:
                self._log.warning(f"stop: {reply.refused.text}", controller=member)

    # Inside

    def _ref(self, moving: Moving) -> dict[str, Any]:
        return {**self._members.fields(moving.actor), "job": moving.job_id, "step": moving.index}


def _require_not_held(moving: Moving) -> None:
    if moving.held_by is not None:
        raise Refuse(HELD, f"held by {moving.held_by} before it began")
