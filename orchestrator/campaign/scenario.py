"""One seed of the fault campaign: a fleet at work, with faults that are injected and repaired, checked against the
simulators' ground truth.

A seed prepares a fleet and then runs phases. In each phase, jobs are submitted that run in parallel or one after the
other, sometimes an axis is jogged manually, and one fault is injected at a stage of a step. It is repaired, and the
remaining jobs run to their end. The true motions are checked against the invariants of the design (section 7).
"""

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from contextvars import Context
from dataclasses import dataclass, field, replace
from functools import partial
from random import Random
from typing import NamedTuple

from orchestrator.campaign.authority_checks import AuthorityChecker
from orchestrator.campaign.computers import connect_computers, make_computers
from orchestrator.campaign.fault_instants import FIRE_WINDOW_NS, FaultInstants
from orchestrator.campaign.faults import FAULTS, FaultInjector
from orchestrator.campaign.fleets import PERMIT_MAKE, find_members, make_stage_fleet
from orchestrator.campaign.hand_jogs import STAGE_RENEWALS, HandJogs
from orchestrator.campaign.invariants import InvariantChecker
from orchestrator.campaign.job_acts import FlightActs, StartRequests
from orchestrator.campaign.jobs import (
    WITNESS,
    JobOrder,
    MainKind,
    draw_orders,
    make_preparation,
    make_trial,
    make_witness,
)
from orchestrator.campaign.journal_checks import JournalChecker, give_databases
from orchestrator.campaign.operator import NamedCommands
from orchestrator.campaign.paths import PathChecker
from orchestrator.campaign.program import run_program
from orchestrator.campaign.recording.recorder import (
    SEARCHES,
    STAGES,
    STATED_STAGES,
    BusRecorder,
    RecordedRequest,
    Stage,
)
from orchestrator.campaign.recording.rest import find_at_rest
from orchestrator.campaign.records import CampaignPhase
from orchestrator.campaign.stages.hall import is_hall, keep_learned_times
from orchestrator.campaign.zone_checks import may_refuse_submission
from orchestrator.client.api import Tutti
from orchestrator.client.attendance import Attendance
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.crystal import ComputerClock
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet, group_by_controller
from orchestrator.model.jobs.job import Job
from orchestrator.model.names import controller_of
from orchestrator.model.queue import JournalPolicy, QueueTerms
from orchestrator.model.report import FINISHED_STATES, QueueEntry
from orchestrator.model.state import ControllerState
from orchestrator.runtime.virtual.fleet import VirtualFleet

REPAIR_DELAY_NS = 2 * NS_PER_S  # from the fault to its repair: by then it is detected everywhere
STAGE_TIMEOUT_NS = 20 * NS_PER_S  # for the stage to be reached
REFUSED_JOB_TIMEOUT_S = 10.0  # for a job that must be refused
READY_TIMEOUT_S = 25.0  # for a fleet to become ready after the repair
OPERATOR_DELAY_NS = 4 * NS_PER_S  # after a restart, before the operator starts the queue
OPERATOR_PERIOD_NS = NS_PER_S  # between two looks of the operator at the queue
LIVENESS_NS = 60 * NS_PER_S  # for the remaining jobs to end, or a command to be named
POLL_NS = 200 * NS_PER_MS
JOG_CHANCE = 0.3  # chance of a jog during the phase

SINGLE_MEMBER_STAGES: tuple[Stage, ...] = (
    "jog",
    "home",
)  # a fault of the fleet affects only one member in these stages

_KINDS: dict[Stage, MainKind] = {
    "home": "home",
    "chain": "chain",
    "chunk": "path",
    "trigger": "trigger",
    "at-once": "at-once",
    "live": "live",
    "armed-waiting": "armed",
    "flying": "flight",
    "virtual": "virtual",
    "pair": "pair",
    "probe": "probe",
    "zone": "zone",
}


class FaultCell(NamedTuple):
    """A fault to inject: the stage of a step, the fault, and the make of the member that it affects."""

    stage: Stage
    fault: str
    make: str


@dataclass(slots=True)
class SeedRun:
    """The events of one seed, which took fleet_s of virtual time.

    hit: injected faults, by the stage that their step had reached.
    affected: the same for each affected make.
    events: a summary.
    lines: the complete log.
    """

    seed: int
    cells: tuple[FaultCell, ...]
    fleet: Fleet
    hit: list[FaultCell] = field(default_factory=list[FaultCell])
    affected: list[FaultCell] = field(default_factory=list[FaultCell])
    jobs: int = 0
    events: list[str] = field(default_factory=list[str])
    lines: list[str] = field(default_factory=list[str])
    violations: list[str] = field(default_factory=list[str])
    fleet_s: float = 0.0

    def summarize(self) -> str:
        """Return a summary of the run with its violations."""
        controllers = ", ".join(f"{name} ({config.adapter})" for name, config in self.fleet.controllers.items())
        return "\n".join([f"seed {self.seed}: {controllers}", *self.events, *self.violations])


def run_scenario(seed: int, cells: Sequence[FaultCell], *, apart: bool = False) -> SeedRun:
    """Run one seed: a phase for each of `cells`. The run is deterministic. apart: each adapter host runs on a computer
    of its own."""
    makes = [cell.make for cell in cells]
    if any(cell.fault == "permit-lost" for cell in cells):
        makes.append(PERMIT_MAKE)
    fleet = make_stage_fleet(seed, makes, {cell.stage for cell in cells})
    if any(FAULTS[cell.fault].of_databases for cell in cells):
        fleet = fleet.model_copy(update={"journal": JournalPolicy(copies=2)})
    seed_run = SeedRun(seed, tuple(cells), fleet)

    async def run_in_clock(clock: VirtualClock) -> None:
        scenario = _Scenario(seed_run, clock, make_computers(seed_run.fleet, clock, seed) if apart else {})
        stages: list[Stage] = [cell.stage for cell in cells]
        programs = StartRequests(scenario.virtual, seed, stages), FlightActs(scenario.virtual, seed, stages)
        if is_hall(seed_run.fleet):
            keep_learned_times(scenario.virtual)
        try:
            await scenario.run_phases()
        finally:
            for program in programs:
                program.end()
            seed_run.lines = scenario.virtual.lines
            seed_run.violations = scenario.checker.violations
            seed_run.fleet_s = clock.now_ns() / NS_PER_S

    try:
        run_virtual(run_in_clock)
    except Exception as error:
        # An error in one of thousands of seeds must not discard the results of the others.
        seed_run.violations.append(f"the seed did not run to its end: {error!r}")
    return seed_run


class _Scenario:
    """The fleet of one seed."""

    def __init__(self, seed_run: SeedRun, clock: VirtualClock, computers: Mapping[str, ComputerClock]) -> None:
        self._seed_run = seed_run
        self._clock = clock
        self._draw = Random(seed_run.seed)
        self._target: tuple[CampaignPhase, FaultCell, asyncio.Future[tuple[str, int]]] | None = None
        self._stage_times: dict[tuple[tuple[str, int], str], dict[str, int]] = {}
        self._phase: CampaignPhase | None = None
        self._attendance: Attendance | None = None
        self._witnesses = 0
        self._programs = TaskOwner()
        self.recorder = BusRecorder(clock, self._on_request)
        self.virtual = VirtualFleet(seed_run.fleet, clock, seed_run.seed)
        give_databases(self.virtual)
        self.virtual.computers.update(computers)
        connect_computers(self.virtual, seed_run.seed)
        self.virtual.wrap_bus = self.recorder.wrap_bus
        self.checker = InvariantChecker(self.virtual, self.recorder, seed_run.seed)
        self._databases = JournalChecker(self.virtual, self.recorder, self.checker.add_violation)
        self._paths = PathChecker(self.virtual, self.checker.add_violation)
        self._authority = AuthorityChecker(self.virtual, self.checker.add_violation)
        self._injector = FaultInjector(self.virtual, clock, self._draw)
        self._jogs = HandJogs(self.virtual, clock, self._draw, self._axis_positions)
        self._instants = FaultInstants(
            seed_run.fleet, self.recorder, self._draw, self._axis_positions, self._t0_host_ns
        )

    async def run_phases(self) -> None:
        """Prepare the fleet, and run one phase after the other."""
        await self.virtual.start()
        await self._databases.start()
        client = self.virtual.make_client()
        await self._authority.watch()
        looking = asyncio.get_running_loop().create_task(self._poll_velocities())
        axes = list(self._seed_run.fleet.controllers)
        if await self._prepare_axes(client, axes, axes):
            for number, cell in enumerate(self._seed_run.cells):
                last = number + 1 == len(self._seed_run.cells)
                await self._run_phase(client, cell, last=last)
                if not last and not await self._restore_axes(client):
                    break
        looking.cancel()
        self._programs.cancel_all()
        self.checker.watched.end()
        self._authority.check_leaders(self._injector.former_leaders)

    def _log_event(self, text: str) -> None:
        self._seed_run.events.append(f"{self._clock.now_ns() / NS_PER_S:8.3f} s  {text}")

    async def _poll_velocities(self) -> None:
        while True:
            self.checker.check_velocities(self._clock.now_ns())
            if (phase := self._phase) is not None:
                self.checker.watched.watch(phase)
                if phase.fault_ns is None or not phase.fault.must_stop:
                    self._paths.check_positions(phase)
            await sleep_ns(self._clock, POLL_NS)

    async def _prepare_axes(self, client: Tutti, axes: list[str], homing: list[str]) -> bool:
        """Enable and home axes as an operator does, whose commands come before all waiting jobs."""
        self._seed_run.jobs += 1
        async with client.attend() as attendance:
            job, terms = make_preparation(self._seed_run.fleet, axes, homing), QueueTerms(session=attendance.session)
            job_id = await client.submit(job, terms=terms)
            if self._phase is not None:
                controllers = tuple(dict.fromkeys(controller_of(axis) for axis in axes))
                self._phase.jobs[job_id] = JobOrder(job, terms, controllers)
            report = await client.wait_for_job(job_id)
        if report.state != "done":
            self.checker.add_violation("3", f"the preparation of {axes} is {report.state}: {report.reason}")
        if self._phase is None:  # within a phase other axes may move
            self.checker.check_positions(await client.status(1.0))
        return report.state == "done"

    # A phase

    async def _run_phase(self, client: Tutti, cell: FaultCell, *, last: bool) -> None:
        fleet, fault = self._seed_run.fleet, FAULTS[cell.fault]
        member = self._draw.choice(find_members(fleet, cell.make))
        motion_counts = {name: len(unit.commanded_motions) for name, unit in self.virtual.controllers.items()}
        act = CampaignPhase(fault, member, self._injector.find_affected(fault, member), motion_counts)
        arrival: asyncio.Future[tuple[str, int]] = asyncio.get_running_loop().create_future()
        self._target = act, cell, arrival
        self._phase = act
        keys: dict[str, str] = {}
        by_hand: asyncio.Task[None] | None = None
        if cell.stage == "jog":
            by_hand = asyncio.get_running_loop().create_task(self._jogs.jog_axis(act, member, STAGE_RENEWALS, arrival))
            while not self._jogs.is_jogging and not by_hand.done():
                await sleep_ns(self._clock, NS_PER_MS)
        kind = _KINDS.get(cell.stage, "move")
        orders = draw_orders(fleet, member, self._axis_positions(), self._draw, kind)
        if fault.name == "fleet-restarted":
            # One that would switch motors on and home by itself.
            orders.append(make_trial(fleet, member, priority=-2))
        if fault.of_job:
            act.affected = list(orders[0].controllers)
        if fault.attended or orders[0].asked_steps:
            self._attendance = await client.attend().__aenter__()
            terms = orders[0].terms.model_copy(update={"session": self._attendance.session})
            orders[0] = replace(orders[0], terms=terms)
        for order in orders:
            keys[order.job.name] = await self._submit_order(client, act, order)
        self._seed_run.jobs += len(act.jobs)
        if by_hand is None and self._draw.random() < JOG_CHANCE:
            by_hand = asyncio.get_running_loop().create_task(self._jogs.jog_free_axis(act))
        step = await self._wait_for_stage(arrival, act)
        self._target = None
        if step is not None:
            await self._inject_fault(act, cell, step)
        await self._wait_for_ends(client, act, last=last)
        if by_hand is not None:
            await by_hand
        await self._check_repeated_submit(client, act, keys)
        act.at_rest = await find_at_rest(self.virtual, self._clock)
        self._log_ends(act)
        self._phase = None
        if self._attendance is not None:
            await self._attendance.__aexit__()
            self._attendance = None
        self.checker.check_phase(act)
        self._databases.check_phase(act)
        self.checker.check_positions(await client.status(1.0))

    def _log_ends(self, phase: CampaignPhase) -> None:
        for job_id, order in phase.jobs.items():
            row = self.virtual.journal.load_record(job_id)
            end = "missing from the journal" if row is None else f"{row.state}: {row.reason}"
            self._log_event(f"{order.job.name} is {end}")

    async def _submit_order(self, client: Tutti, phase: CampaignPhase, order: JobOrder) -> str:
        """Submit a job, unless a zone refuses it, and return its key; the program of a live job begins."""
        key = self.virtual.draw_id()
        try:
            job_id = await client.submit(order.job, key, order.terms)
        except Refusal as refusal:
            if not may_refuse_submission(order, refusal):
                raise
            self._log_event(f"{order.job.name} is not accepted: {refusal.text}")
            return key
        phase.jobs[job_id] = order
        self._databases.accepted.add(job_id)
        if order.asked_steps:
            self._programs.spawn(run_program(client, self._clock, job_id, order.asked_steps))
        self._log_event(f"{order.job.name} of {', '.join(order.controllers)}")
        return key

    def _axis_positions(self) -> dict[str, float]:
        """Return the position of each axis, in its unit."""
        return {
            f"{name}.{axis}": axis_config.to_unit(self.virtual.controllers[name].position(axis_config.motors[0]))
            for name, config in self._seed_run.fleet.controllers.items()
            for axis, axis_config in config.axes.items()
        }

    async def _wait_for_stage(
        self, reached: "asyncio.Future[tuple[str, int]]", phase: CampaignPhase
    ) -> tuple[str, int] | None:
        """Wait until the step reaches the stage of the fault; return None when all jobs end before that."""
        until_ns = self._clock.now_ns() + STAGE_TIMEOUT_NS
        while not reached.done() and self._clock.now_ns() < until_ns and not self._all_finished(phase):
            with suppress(TimeoutError):
                async with asyncio.timeout(0.5):
                    await asyncio.shield(reached)
        return reached.result() if reached.done() else None

    async def _inject_fault(self, phase: CampaignPhase, cell: FaultCell, step: tuple[str, int]) -> None:
        stage = (
            self._find_stage(step, phase.member) if cell.stage != "jog" else "jog" if self._jogs.is_jogging else None
        )
        if stage is not None and cell.stage in STATED_STAGES:
            stage = cell.stage
        if stage is None:
            self._log_event(f"too late for {cell.fault}")
            return
        now_ns = phase.fault_ns = self._clock.now_ns()
        hit = cell._replace(stage=stage)
        all_of_step = phase.fault.reach == "fleet" and stage not in SINGLE_MEMBER_STAGES
        controllers = phase.jobs[step[0]].controllers if all_of_step else [phase.member]
        makes = dict.fromkeys(self._seed_run.fleet.controllers[name].adapter for name in controllers)
        self._seed_run.hit.append(hit)
        self._seed_run.affected += [hit._replace(make=make) for make in makes]
        self._log_event(f"{cell.fault} of {phase.member} at {stage}")
        repair = await self._injector.inject_fault(phase.fault, phase.member)
        await self._act_as_operator(phase, step[0])
        await sleep_ns(self._clock, max(0, now_ns + REPAIR_DELAY_NS - self._clock.now_ns()))
        await _check_latches(self.virtual, self.checker, cell.fault)
        if cell.fault == "host-other-file":
            await self._try_other_file(phase)
        phase.repair_ns = self._clock.now_ns()
        await self._injector.repair_fault(repair)
        self._log_event("mended")

    async def _act_as_operator(self, phase: CampaignPhase, job_id: str) -> None:
        """Interrupt, or lose, the command that a person waits for."""
        attendance = self._attendance
        if attendance is None or not phase.fault.attended:
            return
        self._attendance = None
        if phase.fault.name == "operator-interrupts":
            operator = self.virtual.make_client("operator")
            with suppress(Refusal):
                await operator.cancel_job(job_id)
            await operator.close()
        await attendance.__aexit__()

    async def _try_other_file(self, phase: CampaignPhase) -> None:
        """Submit a job that homes and moves a member whose host has another fleet file than the coordinator."""
        person = self.virtual.make_client("ben")
        with suppress(Refusal):
            await person.start_queue()
        order = make_trial(self._seed_run.fleet, phase.member)
        job_id = await person.submit(order.job, terms=order.terms)
        phase.jobs[job_id] = order
        self._log_event(f"job submitted for {phase.member} with another fleet file")
        with suppress(TimeoutError):
            async with asyncio.timeout(REFUSED_JOB_TIMEOUT_S):
                await person.wait_for_job(job_id)
        await person.close()

    async def _wait_for_ends(self, client: Tutti, phase: CampaignPhase, *, last: bool) -> None:
        """Run the commands that the fleet names until all jobs end, and after the last fault one more is done.

        Checks invariant 13: within `LIVENESS_NS` of the repair, and of each command, that is so, or a command is named.
        """
        if phase.fault.name == "fleet-restarted":
            await sleep_ns(self._clock, OPERATOR_DELAY_NS)
        phase.queue_started_ns = since_ns = self._clock.now_ns()
        operator = NamedCommands(client, partial(self._run_step, client, phase), self._seed_run.fleet)
        while True:
            waiting_entries: list[QueueEntry] = []
            with suppress(Refusal):
                if last and self._all_finished(phase):
                    await self._submit_witness(client, phase)
                queued_jobs = (await client.list_jobs(state="queued")).jobs
                waiting_entries = sorted(
                    (entry for entry in queued_jobs if entry.id in phase.jobs), key=lambda entry: entry.place or 0
                )
                command = await operator.run_named(waiting_entries)
                if command:
                    self._log_event(f"tutti {command}")
                    since_ns = self._clock.now_ns()
            if self._all_finished(phase) and (not last or self._is_witness_done(phase)):
                break
            if operator.is_repeating or self._clock.now_ns() - since_ns > LIVENESS_NS:
                reasons = "; ".join(f"{entry.name}: {entry.reason}" for entry in waiting_entries)
                commands = ", ".join(operator.commands) or "no command was named"
                self.checker.add_violation("13", f"jobs do not go on after the repair ({commands}): {reasons}")
                break
            await sleep_ns(self._clock, OPERATOR_PERIOD_NS)
        await sleep_ns(self._clock, NS_PER_S)

    async def _submit_witness(self, client: Tutti, phase: CampaignPhase) -> None:
        """Submit a job of all controllers, which shows that the fleet works again; another one if it was not done."""
        if not self._is_witness_done(phase):
            attempt, self._witnesses = self._witnesses, self._witnesses + 1
            order = make_witness(self._seed_run.fleet, self._axis_positions(), attempt)
            phase.jobs[await client.submit(order.job, terms=order.terms)] = order

    def _is_witness_done(self, phase: CampaignPhase) -> bool:
        rows = (self.virtual.journal.load_record(job_id) for job_id in phase.jobs)
        return any(row is not None and row.name == WITNESS and row.state == "done" for row in rows)

    async def _run_step(self, client: Tutti, phase: CampaignPhase, job: Job, terms: QueueTerms) -> None:
        """Run a job of one step as a command of a person does. Raises `Refusal`."""
        async with client.attend() as attendance:
            terms = terms.model_copy(update={"session": attendance.session})
            job_id = await client.submit(job, terms=terms)
            controllers = tuple(group_by_controller(job.steps[0].find_axes(self._seed_run.fleet)))
            phase.jobs[job_id] = JobOrder(job, terms, controllers)
            await client.wait_for_job(job_id)

    def _all_finished(self, phase: CampaignPhase) -> bool:
        rows = [self.virtual.journal.load_record(job_id) for job_id in phase.jobs]
        return all(row is None or row.state in FINISHED_STATES for row in rows)

    async def _wait_until_ready(self, client: Tutti) -> None:
        """Wait until all controllers are adopted by the current leader and without a fault; reset latched e-stops."""
        fleet = self._seed_run.fleet
        states: dict[str, ControllerState] = {}
        for _ in range(round(READY_TIMEOUT_S / 0.5)):
            states = await client.status(1.0)
            epoch = self.virtual.coordinators[self._injector.find_leader()][1].leadership.epoch
            troubled_controllers = [
                name
                for name in fleet.controllers
                if name not in states or states[name].faults or states[name].mode == "offline"
            ]
            latched_states = [name for name, state in states.items() if state.estop is not None]
            strange = [name for name, state in states.items() if not epoch or state.epoch != epoch]
            if (
                not troubled_controllers
                and not latched_states
                and not strange
                and len(states) == len(fleet.controllers)
            ):
                return
            if latched_states or troubled_controllers:
                await client.reset()
            await sleep_ns(self._clock, 500 * NS_PER_MS)
        shown_modes = {
            name: (state.mode, state.epoch, [fault.text for fault in state.faults]) for name, state in states.items()
        }
        self.checker.add_violation("3", f"not ready {READY_TIMEOUT_S} s after the repair: {shown_modes}")

    async def _restore_axes(self, client: Tutti) -> bool:
        """Enable and home the axes that the fault has left disabled, unreferenced or on a limit switch.

        A controller that cannot read its switches is on one until its axis has moved away.
        """
        # The fault may have been detected only after its repair.
        await self._wait_until_ready(client)
        states = await client.status()
        axes = [
            (f"{name}.{axis}", axis_state) for name, state in states.items() for axis, axis_state in state.axes.items()
        ]
        off = [name for name, axis_state in axes if not axis_state.enabled]
        lost_axes = [name for name, axis_state in axes if not axis_state.referenced or axis_state.limit != "none"]
        if not off and not lost_axes:
            return True
        self._log_event(f"homing {', '.join(lost_axes)}" if lost_axes else f"enabling {', '.join(off)}")
        return await self._prepare_axes(client, sorted({*off, *lost_axes}), lost_axes)

    async def _check_repeated_submit(self, client: Tutti, phase: CampaignPhase, keys: dict[str, str]) -> None:
        """Check invariant 6: a client that repeats a request after a lost reply gets the same job."""
        job_id, order = next(iter(phase.jobs.items()))
        try:
            job_again = await client.submit(order.job, keys[order.job.name], order.terms)
        except Refusal as error:
            self.checker.add_violation("9", f"a coordinator that cannot accept jobs answers for one: {error.text}")
            return
        if job_again != job_id:
            self.checker.add_violation("6", f"job {order.job.name} was accepted twice: {job_id} and {job_again}")

    # Stages

    def _on_request(self, request: RecordedRequest) -> None:
        """Note that a request to a member was sent or answered. Runs in the coordinator's process."""
        if request.verb == "lease":
            return
        at = self._stage_times.setdefault((request.step_id, request.member), {})
        now_ns = self._clock.now_ns()
        at.setdefault(request.verb, now_ns)
        if request.verb in SEARCHES and request.answered_ns is not None:
            at["found"] = now_ns
        self.checker.note_request(request)
        if request.verb in ("go", "start-at-once") and request.accepted:
            at.setdefault("fire", now_ns)
            at.setdefault("t0", self._t0_host_ns(request))
        if self._target is None:
            return
        act, cell, arrival = self._target
        if request.job_id not in act.jobs or request.member != act.member or arrival.done():
            return
        at_ns = self._instants.find_instant(cell.stage, request, act.jobs[request.job_id].job, now_ns)
        if at_ns is not None:
            self._target = None
            self._clock.call_at_ns(at_ns, lambda: _note_arrival(arrival, request.step_id), context=Context())

    def _find_stage(self, step: tuple[str, int], member: str) -> Stage | None:
        """Return the stage that `member` has reached in the step; None when its job has ended."""
        row = self.virtual.journal.load_record(step[0])
        if row is None or row.state in FINISHED_STATES:
            return None
        at = self._stage_times[step, member]
        for search in SEARCHES:
            if search in at:
                return None if "found" in at else search
        if "t0" in at and self._clock.now_ns() > at["t0"] + FIRE_WINDOW_NS:
            return "motion"
        return next(stage for stage in reversed(STAGES) if stage in at)

    def _t0_host_ns(self, request: RecordedRequest) -> int:
        origin_ns = next(
            c.leadership.scale.origin_host_ns for _, c in self.virtual.coordinators.values() if c.leadership.epoch
        )
        return request.fields["t0_fleet_ns"] + origin_ns


async def _check_latches(virtual: VirtualFleet, checker: InvariantChecker, fault: str) -> None:
    """Check invariant 4: every reachable adapter latches an e-stop, without a coordinator."""
    if fault != "estop":
        return
    person = virtual.make_client("looker")
    for name, state in (await person.status(1.0)).items():
        if state.estop is None:
            checker.add_violation("4", f"{name} has not latched the e-stop")
    await person.close()


def _note_arrival(arrival: "asyncio.Future[tuple[str, int]]", step: tuple[str, int]) -> None:
    """The instant of a fault in this step has come."""
    if not arrival.done():
        arrival.set_result(step)
