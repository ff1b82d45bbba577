"""The coordinator: reigns over a fleet, adopts its controllers, serves users, runs jobs."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import ValidationError

from orchestrator.bus.answers import Answers
from orchestrator.bus.base import Bus, Declared, RequestRefused, Sample
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log, Sink
from orchestrator.clock.base import Clock
from orchestrator.clock.executor import Runs
from orchestrator.coordinator.fleet.leases import LeaseBook
from orchestrator.coordinator.fleet.manual import Hands
from orchestrator.coordinator.fleet.permits import Permits
from orchestrator.coordinator.fleet.requests import Members
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.jobs.homing import Homing
from orchestrator.coordinator.jobs.intake import Office
from orchestrator.coordinator.jobs.job_run import Interrupted, Works
from orchestrator.coordinator.jobs.scheduler import Runner
from orchestrator.coordinator.jobs.steps import PlainSteps, check_job
from orchestrator.coordinator.journal.journal import Journal, JournalError
from orchestrator.coordinator.leadership.leadership import Throne
from orchestrator.coordinator.maintenance.reload import Reloading
from orchestrator.coordinator.maintenance.wiring import WiringCheck
from orchestrator.coordinator.motion.motion import Motion
from orchestrator.coordinator.motion.targets import Refuse
from orchestrator.model.base import Model, UnknownName
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Move
from orchestrator.model.messages import Adopt, Adopted, Refusal, Reply, Request
from orchestrator.model.report import QueueState
from orchestrator.model.service import (
    Again,
    GiveBack,
    JobRef,
    JobRefs,
    JobShown,
    ListJobs,
    MoveJob,
    PauseJob,
    Prune,
    Pruned,
    Recorded,
    RecordingRef,
    Reload,
    Reloaded,
    StopFleet,
    Submit,
    Submitted,
    Take,
    Taken,
    WiringChecked,
)
from orchestrator.model.state import ControllerState

T = TypeVar("T")

ADOPT_S = 2.0
LEAVE_S = 2.0
_READING = ("list", "show", "recording")
"""Verbs that may be done twice; their answers are too large to keep."""


@dataclass(frozen=True, slots=True)
class Court:
    """What a coordinator is given: everything that differs between live and virtual.

    save_fleet: keeps a reloaded fleet for the next start.
    """

    bus: Bus
    keys: Keys
    clock: Clock
    journal: Journal
    runs: Runs
    new_id: Callable[[], str]
    sink: Sink
    save_fleet: Callable[[Fleet], None]


class Coordinator:
    """One coordinator of `fleet`."""

    def __init__(self, fleet: Fleet, court: Court) -> None:
        self._court = court
        bus, keys, clock = court.bus, court.keys, court.clock
        self.throne = Throne(fleet.fleet, bus, keys, clock, court.journal, court.runs, court.new_id)
        self._log = Log("coordinator", self.throne.coordinator[:8], clock, court.sink, bus, keys)
        self._log.fleet_ns = lambda: self.throne.fleet_now_ns() if self.throne.epoch else None
        self._view = FleetView(fleet, bus, keys, clock, self._log)
        view = self._view
        members = self._members = Members(
            bus, keys, self.throne, court.new_id, lambda controller: view.fleet.controllers[controller].host
        )
        permits = self._permits = Permits(self._view, clock)
        self._leases = LeaseBook(self._view, members, clock, bus, keys, self._log)
        self._motion = Motion(self._view, members, permits, self.throne, clock, court.journal, self._runs, self._log)
        targets = self._motion.targets
        homing = Homing(self._view, members, permits, targets, self._motion.stop)
        plain = self._plain = PlainSteps(self._view, members, clock, targets, homing)
        works = Works(
            bus=bus,
            keys=keys,
            clock=clock,
            journal=court.journal,
            runs=self._runs,
            view=self._view,
            motion=self._motion,
            plain=plain,
            leases=self._leases,
            throne=self.throne,
            log=self._log,
        )
        self.runner = Runner(works)
        self._office = Office(works, self.runner, court.new_id)
        self._hands = Hands(self._view, self._leases, permits, clock, court.journal, court.runs, self._log)
        self._reloading = Reloading(self._view, members, self._leases, clock, court.save_fleet)
        self._wiring = WiringCheck(self._view, members, self._leases, clock)
        self._adopting: set[str] = set()
        self._adopted: dict[str, str] = {}
        self._declared: list[Declared] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self.deposed = asyncio.Event()
        self._answers = Answers()
        self._verbs: dict[str, tuple[type[Request], Callable[[Any], Awaitable[Model]]]] = {
            "submit": (Submit, self._submit),
            "list": (ListJobs, self._list),
            "show": (JobRef, self._show),
            "recording": (RecordingRef, self._recording),
            "cancel": (JobRef, self._cancel),
            "retry": (Again, self._again),
            "hold": (JobRefs, self._hold),
            "release-job": (JobRefs, self._release_jobs),
            "move": (MoveJob, self._move),
            "pause": (PauseJob, self._pause),
            "resume": (JobRef, self._resume),
            "prune": (Prune, self._prune),
            "stop": (StopFleet, self._stop),
            "take": (Take, self._take),
            "release": (GiveBack, self._release),
            "reload": (Reload, self._reload),
            "check-wiring": (Request, self._check_wiring),
        }

    async def start(self, take_over: bool = False, vacant: bool = False) -> None:
        """Begin to reign. Raises `AnotherReigns`, `JournalError`. take_over, vacant: see `Throne.take`."""
        await self.throne.take(take_over, vacant)
        self.throne.on_lost = self._depose
        self._view.listen_states(self._see)
        await self._view.start()
        bus, keys = self._court.bus, self._court.keys
        await self._leases.start()
        await self._hands.start()
        await self.runner.start()
        self._declared = [
            await bus.serve(keys.svc(), self._answer),
            await bus.announce(keys.live("coordinator", self.throne.coordinator[:8], f"e{self.throne.epoch}")),
        ]
        self._log.info("reigns", epoch=self.throne.epoch, scale=self.throne.scale.scale_id)

    async def close(self, reason: str = "the coordinator was stopped") -> None:
        """Stop what runs and leave."""
        for declared in self._declared:
            await declared.undeclare()
        self._declared.clear()
        await self.runner.close(reason)
        self._hands.close()
        await self._leases.close()
        await self._view.close()
        await self.throne.close()
        for task in list(self._tasks):
            task.cancel()

    async def _runs(self, function: Callable[..., T], *values: Any) -> T:
        """Call the journal; not any more once another coordinator has taken an epoch from it, heard of or not."""
        await self._court.runs(self._court.journal.require_reign, self.throne.epoch)
        return await self._court.runs(function, *values)

    # Adoption: every controller that is heard and not ours yet

    def _see(self, state: ControllerState) -> None:
        controller = state.controller
        ours = self._adopted.get(controller) == state.instance and state.epoch == self.throne.epoch
        if ours or controller in self._adopting or self.throne.over or not self.throne.epoch:
            return
        self._adopting.add(controller)
        self._spawn(self._adopt(controller, state.instance))

    async def _adopt(self, controller: str, instance: str) -> None:
        try:
            request = Adopt(**self._members.fields("coordinator"), reign=self.throne.reign())
            reply = await self._members.ask(controller, "adopt", request, Adopted, ADOPT_S)
            if reply.refused is None:
                self._adopted[controller] = instance
                self._log.info("adopted", controller=controller, epoch=self.throne.epoch)
                await self._enable_at_start(controller)
            else:
                self._log.warning(f"not adopted: {reply.refused.text}", controller=controller)
        finally:
            self._adopting.discard(controller)

    async def _enable_at_start(self, controller: str) -> None:
        """Enable the axes that the fleet file wants on from the start, once the controller is idle."""
        axes = self._view.fleet.controllers[controller].axes
        names = [f"{controller}.{name}" for name, axis in axes.items() if axis.enable == "at_start"]
        if not names:
            return
        holder = f"start-{self._court.new_id()[:8]}"
        try:
            await self._leases.take(holder, "coordinator", "enabling at the start", names, brief=True)
            await self._plain.enable(names, True, holder, "coordinator")
        except Refuse as error:
            self._log.warning(f"not enabled at start: {error.refusal.text}", controller=controller)
        finally:
            await self._leases.give_back(holder)

    def _depose(self, reason: str) -> None:
        """A newer reign was heard: answer nobody any more, touch nothing. The adapters refuse us anyhow."""
        self._log.warning(reason, epoch=self.throne.epoch)

        async def leave() -> None:
            # A process that slept may have lost its router, and would wait for it to be back.
            with suppress(TimeoutError):
                async with asyncio.timeout(LEAVE_S):
                    for declared in self._declared:
                        await declared.undeclare()
            self._declared.clear()
            self.deposed.set()

        self._spawn(leave())

    # Service

    async def _answer(self, sample: Sample) -> bytes:
        verb = self._court.keys.verb_of(sample.key)
        if verb not in self._verbs:
            raise RequestRefused(f"unknown verb {verb!r}; known: {', '.join(sorted(self._verbs))}")
        model, handler = self._verbs[verb]
        try:
            request = model.model_validate_json(sample.payload)
        except ValidationError as error:
            first = error.errors()[0]
            raise RequestRefused(f"{verb}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
        if self.throne.over:
            raise RequestRefused("this coordinator reigns no more; ask again")
        if verb in _READING:
            return await self._do(verb, handler, request)
        return await self._answers.once(verb, request.request_id, lambda: self._do(verb, handler, request))

    async def _do(self, verb: str, handler: Callable[[Any], Awaitable[Model]], request: Request) -> bytes:
        try:
            return (await handler(request)).to_json()
        except JournalError as error:
            self._log.warning(str(error))
            if verb == "list":  # its answer has no room for a refusal
                raise RequestRefused(str(error)) from None
            return Reply(refused=Refusal(code="journal", text=error.text, remedy=error.remedy)).to_json()

    async def _submit(self, request: Submit) -> Reply:
        if request.dry_run:
            try:
                check_job(self._view.fleet, list(request.job.steps))
                return Submitted(dry_run=await self._dry_run(request))
            except Refuse as error:
                return Submitted(refused=error.refusal)
        return await self._office.submit(request)

    async def _dry_run(self, request: Submit) -> dict[str, Any]:
        """What each motion step would take, each planned from where the axes stand now."""
        steps: dict[str, Any] = {}
        for index, step in enumerate(request.job.steps):
            if isinstance(step, Move):
                steps[str(index)] = await self._motion.dry_run(request.job, index, step)
        return steps

    async def _list(self, request: ListJobs) -> Model:
        find = self._court.journal.find
        values = (request.limit, request.state, request.name, request.since or "")
        rows, total = await self._court.runs(find, *values)
        return QueueState(total=total, jobs=self.runner.entries(rows))

    async def _show(self, request: JobRef) -> Model:
        journal, runs = self._court.journal, self._court.runs
        row = await runs(journal.row, request.job_id)
        if row is None:
            return JobShown(
                refused=Refusal(code="unknown-job", text=f"no job {request.job_id}", remedy="see `tutti job ls`")
            )
        job, report = await runs(journal.job, row.id), await runs(journal.report, row.id)
        return JobShown(
            entry=self.runner.entry(row),
            job=job,
            report=report,
            transitions=await runs(journal.transitions, row.id),
        )

    async def _recording(self, request: RecordingRef) -> Model:
        recording = await self._court.runs(self._court.journal.recording, request.job_id, request.step)
        return Recorded(recording=recording)

    async def _cancel(self, request: JobRef) -> Model:
        return Reply(refused=await self.runner.cancel(request.job_id, request.actor))

    async def _again(self, request: Again) -> Model:
        return await self._office.again(request)

    async def _hold(self, request: JobRefs) -> Model:
        return Reply(refused=await self.runner.hold(request.job_ids, request.actor))

    async def _release_jobs(self, request: JobRefs) -> Model:
        return Reply(refused=await self.runner.release(request.job_ids, request.actor))

    async def _move(self, request: MoveJob) -> Model:
        return Reply(refused=await self.runner.move(request.job_id, request.before, request.actor))

    async def _pause(self, request: PauseJob) -> Model:
        return Reply(refused=await self.runner.pause(request.job_id, request.actor, request.now))

    async def _resume(self, request: JobRef) -> Model:
        return Reply(refused=await self.runner.resume(request.job_id, request.actor))

    async def _prune(self, request: Prune) -> Model:
        return Pruned(jobs=await self._office.prune(request))

    async def _stop(self, request: StopFleet) -> Model:
        interrupt = Interrupted("aborted", f"stopped by {request.actor}", request.actor)
        await self.runner.stop(interrupt, request.mode)
        return Reply()

    async def _take(self, request: Take) -> Model:
        try:
            return await self._hands.take(request)
        except Refuse as error:
            return Taken(refused=error.refusal)
        except UnknownName as error:
            return Taken(refused=Refusal(code="unknown-name", text=str(error), remedy="see `tutti axis ls`"))

    async def _release(self, request: GiveBack) -> Model:
        await self._leases.give_back(request.holder)
        return Reply()

    async def _reload(self, request: Reload) -> Model:
        try:
            fleet = Fleet.model_validate(request.configuration)
            changed = await self._reloading.reload(fleet, request.actor)
        except Refuse as error:
            return Reloaded(refused=error.refusal)
        except ValidationError as error:
            first = error.errors()[0]
            text = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
            return Reloaded(refused=Refusal(code="bad-file", text=text, remedy="correct the fleet file"))
        self.runner.forget_needs()
        self._log.info(f"reloaded by {request.actor}: {', '.join(changed) or 'no controller has changed'}")
        return Reloaded(changed=changed)

    async def _check_wiring(self, request: Request) -> Model:
        try:
            return WiringChecked(wires=await self._wiring.check(request.actor))
        except Refuse as error:
            return WiringChecked(refused=error.refusal)

    def _spawn(self, coroutine: Any) -> None:
        task: asyncio.Task[None] = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
