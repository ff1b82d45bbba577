"""The coordinator: leads a fleet, adopts its controllers, serves users, runs jobs."""

import asyncio
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from orchestrator.bus.base import BusDeclaration
from orchestrator.bus.latch import LatchKeeper
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.alarms.service import AlarmService
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.adoption import AdoptionReports, FleetAdoption
from orchestrator.coordinator.fleet.certificates import CertificateEnds
from orchestrator.coordinator.fleet.lease_states import LeaseUser
from orchestrator.coordinator.fleet.leases import LeaseRegistry
from orchestrator.coordinator.fleet.manual import ManualLeases
from orchestrator.coordinator.fleet.pair_stops import PairStops
from orchestrator.coordinator.fleet.pairs import PairMonitor
from orchestrator.coordinator.fleet.permits import PermitMonitor
from orchestrator.coordinator.fleet.positions import PositionBook
from orchestrator.coordinator.fleet.requests import MemberRequests
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.fleet.virtual_states import VirtualObserver
from orchestrator.coordinator.fleet.zone_states import ZoneObserver
from orchestrator.coordinator.fleet.zone_watch import ZoneWatch
from orchestrator.coordinator.jobs.intake.job_intake import JobIntake
from orchestrator.coordinator.jobs.queue.hand_over import HandOver
from orchestrator.coordinator.jobs.queue.scheduler import Scheduler
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.grouped_calls import GroupedCalls
from orchestrator.coordinator.leadership.copies import CopyWatch
from orchestrator.coordinator.leadership.environment import CoordinatorEnvironment
from orchestrator.coordinator.leadership.leadership import Leadership
from orchestrator.coordinator.maintenance.epochs import EpochRepair
from orchestrator.coordinator.maintenance.learned import LearnedTimesKeeper
from orchestrator.coordinator.maintenance.reload import FleetReload
from orchestrator.coordinator.maintenance.wiring import WiringCheck
from orchestrator.coordinator.motion.lead_time import LeadTimeEstimator
from orchestrator.coordinator.motion.publisher import StepPublisher
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.statistics.collector import StatisticsCollector
from orchestrator.coordinator.steps.context import StepContext
from orchestrator.coordinator.steps.motors import switch_motors
from orchestrator.coordinator.user_requests import UserRequests
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import LeaderHeartbeat

T = TypeVar("T")

LEAVE_S = 2.0
MAX_CONTRADICTIONS = 20  # that are reported; more are the same again


class Coordinator:
    """One coordinator of `fleet`."""

    def __init__(self, fleet: Fleet, environment: CoordinatorEnvironment) -> None:
        self._environment = environment
        bus, keys, clock = environment.bus, environment.keys, environment.clock
        tasks = self._owner = TaskOwner(self._report_defect)
        self.leadership = Leadership(fleet, environment, tasks)
        self._latch_keeper = LatchKeeper(bus, keys, clock.utc, environment.latches, environment.execute)
        self.leadership.kept_estop = self._latch_keeper.find_event
        self._log = ProcessLog("coordinator", self.leadership.coordinator[:8], clock, environment.sink, (bus, keys))
        self._log.fleet_ns = lambda: self.leadership.fleet_now_ns() if self.leadership.epoch else None
        self._view = FleetView(fleet, bus, keys, clock, self._log)
        requests = MemberRequests(bus, keys, self.leadership, environment.new_id, self._view)
        pairs = PairMonitor(self._view, clock)
        permits = PermitMonitor(self._view, clock, pairs)
        certificates = CertificateEnds(self._view, clock, environment.certificate)
        access = self._fleet = FleetAccess(
            view=self._view,
            requests=requests,
            permits=permits,
            certificates=certificates,
            clock=clock,
            log=self._log,
            tasks=tasks,
        )
        PairStops(access, pairs)
        self._leases = LeaseRegistry(access, bus, keys)
        calls = self._journal_calls = GroupedCalls(
            environment.journal, environment.execute, clock, lambda: self.leadership.epoch, tasks
        )
        self._copies = CopyWatch(environment.read_journal_health, environment.execute, clock, tasks)
        self._positions = PositionBook(access, environment.journal, calls)
        publisher = StepPublisher(bus, keys)
        motion = MotionServices(
            fleet=access,
            leadership=self.leadership,
            journal=environment.journal,
            execute=calls,
            record_later=calls.later,
            publisher=publisher,
            plan=environment.plan,
            plan_long=environment.plan_long,
            estimator=LeadTimeEstimator(lambda: self._view.fleet.starts.release),
        )
        self._targets = motion.targets
        self._virtual = VirtualObserver(self._view, bus, keys, self._leases)
        self._zones = motion.zones
        self._manual = ManualLeases(access, self._leases, environment.journal, environment.execute, self._zones)
        self._alarms = AlarmService(access, environment, calls, self._manual.find_reserved)
        calls.on_error = self._alarms.note_write
        ZoneWatch(access, motion.zone_memory, self._alarms.report_condition)
        self._statistics = StatisticsCollector(access, environment.journal.statistics, calls)
        self._learned = LearnedTimesKeeper(access, motion.estimator, environment.journal.learned, calls)
        motion.listeners.extend((self._alarms.take_motion, self._statistics.take_motion, self._learned.take_motion))
        services = JobServices(
            bus=bus,
            keys=keys,
            clock=clock,
            journal=environment.journal,
            execute=calls,
            record_later=calls.later,
            decode=environment.decode,
            check=environment.check,
            view=self._view,
            fleet=access,
            motion=motion,
            leases=self._leases,
            positions=self._positions,
            virtual=self._virtual,
            zones=ZoneObserver(self._view, motion.zone_memory),
            alarms=self._alarms.register,
            statistics=self._statistics,
            leadership=self.leadership,
            copies=self._copies,
            log=self._log,
        )
        self.scheduler = Scheduler(services)
        self._positions.on_change = self.scheduler.register.forget_needs
        reload = FleetReload(access, self._leases, environment.save_fleet)
        self._hand_over = HandOver(services, self.scheduler)
        wiring, epochs = WiringCheck(access, self._leases), EpochRepair(access)
        maintenance = (reload, wiring, epochs, self._learned, self._hand_over)
        intake = JobIntake(services, self.scheduler, environment.new_id)
        self._requests = UserRequests(services, intake, self.scheduler, self._manual, maintenance)
        reports = AdoptionReports(
            version=self._alarms.note_version,
            double_answer=self._report_double_answer,
            worked=self.scheduler.ends.end_unknown_work,
            adopted=self._take_adopted,
        )
        self._adoption = FleetAdoption(access, keys, self.leadership, reports)
        self._declared: list[BusDeclaration] = []
        self._contradictions: set[tuple[int, str]] = set()
        self._double_answers: set[str] = set()
        self.leadership_lost = asyncio.Event()
        self.handed_over = self._hand_over.is_left
        """A standby is to lead: the process must end."""
        self.broken = asyncio.Event()
        """A vital task has ended by a defect: the process must be restarted."""

    async def start(self, *, take_over: bool = False, vacant: bool = False) -> None:
        """Become the leader. Raises `AnotherLeader`, `JournalError`. take_over, vacant: see `Leadership.acquire`."""
        self.leadership.on_contradicted = self._report_contradiction
        self._environment.bus.report_double_answers(self._report_double_answer)
        await self._latch_keeper.start(self.leadership.coordinator)
        # Two that begin at once take an epoch each, and the first one may lose its own before it has begun.
        self.leadership.on_lost = self._lose_leadership
        await self.leadership.acquire(take_over=take_over, vacant=vacant)
        self._view.add_arrival_listener(self._adoption.take_arrivals)
        self._virtual.start()
        await self._view.start()
        bus, keys = self._environment.bus, self._environment.keys
        await self._leases.start()
        await self._manual.start()
        await self._positions.start()
        await self._alarms.start(self.leadership.epoch)
        await self._copies.start(self._alarms.report_condition)
        await self._statistics.start()
        await self._learned.start()
        await self.scheduler.start()
        await self._hand_over.start()
        self._declared = [
            await bus.serve(keys.service(), self._requests.answer),
            await bus.announce(keys.live("coordinator", self.leadership.coordinator[:8], f"e{self.leadership.epoch}")),
        ]
        self._log.info("leads the fleet", epoch=self.leadership.epoch, scale=self.leadership.scale.scale_id)

    async def close(self, reason: str = "the coordinator was stopped") -> None:
        """Stop running jobs and leave."""
        for declaration in self._declared:
            await declaration.undeclare()
        self._declared.clear()
        await self._hand_over.close()
        await self.scheduler.close(reason)
        self._manual.close()
        await self._alarms.close()
        await self._statistics.close()
        await self._learned.close()
        await self._leases.close()
        await self._view.close()
        await self._latch_keeper.close()
        await self._journal_calls.flush()
        await self.leadership.close()
        self._owner.cancel_all()

    async def abandon(self) -> None:
        """End all tasks of a coordinator that has lost the leadership: it may change nothing any more."""
        with suppress(TimeoutError):
            async with asyncio.timeout(LEAVE_S):
                await self._owner.end_all()

    async def _take_adopted(self, controller: str) -> None:
        self.scheduler.register.wake_up()
        await self._enable_at_start(controller)

    async def _enable_at_start(self, controller: str) -> None:
        """Enable axes with `enable: at_start` once the controller is idle."""
        axes = self._view.fleet.controllers[controller].axes
        names = [f"{controller}.{name}" for name, axis in axes.items() if axis.enable == "at_start"]
        if not names:
            return
        holder = f"start-{self._environment.new_id()[:8]}"
        try:
            await self._leases.acquire(LeaseUser(holder, "coordinator", "enabling at the start"), names, brief=True)
            context = StepContext(self._fleet, self._targets, self._positions, self._zones, holder, "coordinator")
            await switch_motors(context, names, on=True)
        except Refusal as error:
            self._log.warning(f"not enabled at start: {error.text}", controller=controller)
        finally:
            await self._leases.release(holder)

    def _report_defect(self, error: BaseException, vital: bool) -> None:  # noqa: FBT001 - a callback
        """A task has ended with an exception that nothing handles: a defect, which is logged with its place."""
        frames = traceback.extract_tb(error.__traceback__)
        last_frames = [frame for frame in frames if "site-packages" not in frame.filename][-1:]
        location = f" ({Path(last_frames[0].filename).name}:{last_frames[0].lineno})" if last_frames else ""
        self._log.warning(f"a defect of the coordinator: {error!r}{location}")
        if vital:
            self.broken.set()

    def _report_contradiction(self, heartbeat: LeaderHeartbeat) -> None:
        """Something sends heartbeats of a coordinator that does not answer: an alarm, once for each."""
        self._alarms.note_contradiction(heartbeat)
        sender = (heartbeat.epoch, heartbeat.coordinator)
        if sender not in self._contradictions and len(self._contradictions) < MAX_CONTRADICTIONS:
            self._contradictions.add(sender)
            self._log.warning(
                f"a heartbeat of coordinator {heartbeat.coordinator[:8]}, epoch {heartbeat.epoch}, is on the bus, and "
                "no such coordinator answers; this one continues to lead. Find its sender"
            )

    def _report_double_answer(self, key: str) -> None:
        """Something else serves a key of an adapter or of this coordinator: an alarm, once for each key."""
        self._alarms.note_double_answer(key)
        if key not in self._double_answers and len(self._double_answers) < MAX_CONTRADICTIONS:
            self._double_answers.add(key)
            self._log.warning(f"two processes answer on {key}; one of them should not. Find it before anything moves")

    def _lose_leadership(self, reason: str) -> None:
        """A newer leader exists: answer no request, change nothing. The adapters refuse this coordinator anyhow."""
        self._log.warning(reason, epoch=self.leadership.epoch)

        async def leave() -> None:
            # A process that slept may have lost its router, and closing would wait for it.
            with suppress(TimeoutError):
                async with asyncio.timeout(LEAVE_S):
                    await self._alarms.close()
                    for declaration in self._declared:
                        await declaration.undeclare()
            self._declared.clear()
            self.leadership_lost.set()

        self._spawn(leave())

    def _spawn(self, coroutine: Any) -> None:
        self._owner.spawn(coroutine, vital=False)
