"""The alarms of a fleet as one part of its leader: the register, its sources, and the notices."""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress

from orchestrator.bus.base import BusDeclaration
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.coordinator.alarms.conditions import AlarmConditions
from orchestrator.coordinator.alarms.fleet_sources import FleetAlarms, is_of_axes
from orchestrator.coordinator.alarms.motion_sources import MotionAlarms
from orchestrator.coordinator.alarms.notifier import AlarmNotifier
from orchestrator.coordinator.alarms.register import AlarmRegister
from orchestrator.coordinator.alarms.service_sources import REQUEST_NS, ServiceAlarms
from orchestrator.coordinator.alarms.store import AlarmStore
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.listening import keep_apart
from orchestrator.coordinator.fleet.positions import JournalCalls
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.leadership.environment import CoordinatorEnvironment
from orchestrator.model.operation.alarms import AlarmCause, AlarmRecord

TICK_NS = NS_PER_S
# Nothing reports that they are over.
FLEETING = ("second-leader", "double-answer", "notify", "disk", "link-errors", "version", "unknown-controller")


class AlarmService:
    """All about alarms. find_reserved: returns the axes that are reserved for work, each with the words for it."""

    def __init__(
        self,
        access: FleetAccess,
        environment: CoordinatorEnvironment,
        execute: JournalCalls,
        find_reserved: Callable[[], Mapping[str, str]],
    ) -> None:
        self._access = access
        self._environment = environment
        self._execute = execute
        self._tables = environment.journal.alarms
        bus, keys, clock, view = environment.bus, environment.keys, environment.clock, access.view
        self._store = AlarmStore(self._tables, execute, clock)
        self.register = AlarmRegister(access, self._store, bus, keys)
        self._notifier = AlarmNotifier(environment.run_command, self._store, access)
        conditions = self._conditions = AlarmConditions(self.register, clock, lambda: view.fleet)
        self._fleet = FleetAlarms(view, conditions, clock)
        self._motion = MotionAlarms(view, conditions)
        self._service = ServiceAlarms(conditions, clock, access.log, lambda: view.fleet.alarms)
        self.take_motion = keep_apart(access.tasks, self._motion.take_motion)
        self.report_condition = conditions.report
        self.note_write = keep_apart(access.tasks, self._service.note_write)
        self.note_contradiction = keep_apart(access.tasks, self._service.note_contradiction)
        self.note_double_answer = keep_apart(access.tasks, self._service.note_double_answer)
        view.on_unknown = keep_apart(access.tasks, self._service.note_unknown)
        self.note_version = keep_apart(access.tasks, self._service.note_version)
        self.register.explain_absence = lambda record: _explain_reservation(find_reserved(), record)
        # What is reserved is out of service, and so no part of an alarm that others have to look at.
        conditions.folding.is_apart = lambda cause: bool(_explain_reservation(find_reserved(), cause))
        self.register.needs_notice = self._notifier.needs_notice
        self.register.on_notice = self._notifier.add_notice
        self._notifier.on_result = self._service.note_command
        self._store.on_result = self.note_write
        self._declared: list[BusDeclaration] = []
        self._tasks: list[asyncio.Task[None]] = []

    async def start(self, epoch: int) -> None:
        """Go on where the last leader ended. Raises `JournalError`."""
        self.register.epoch = epoch
        records, damaged_names = await self._execute(self._tables.load_alarms)
        for name in damaged_names:
            self._access.log.warning(f"alarm {name}: its record in the journal is damaged; it begins anew")
        self.register.restore(records)
        for record in records:
            over = record.kind in FLEETING or not self._fleet.names(record)
            self._conditions.restore(record, holds=not over, for_ns=REQUEST_NS if record.source else None)
        self._notifier.restore(await self._execute(self._tables.load_notices))
        self._conditions.started = True
        view, bus, keys = self._access.view, self._environment.bus, self._environment.keys
        tasks = self._access.tasks
        for listener in (self._fleet.take_state, self._motion.take_state):
            view.add_state_listener(keep_apart(tasks, listener))
        view.add_event_listener(keep_apart(tasks, self._fleet.take_event))
        self._declared = [
            await bus.subscribe(keys.alarm_request(), keep_apart(tasks, self._service.take_request)),
        ]
        # Not vital: without alarms a fleet moves as before.
        self._tasks = [
            tasks.spawn(work, vital=False) for work in (self._store.run(), self._notifier.run(), self._tick())
        ]

    async def close(self) -> None:
        """Report, notify and serve nothing any more, and write what is pending."""
        self._conditions.started = False
        for task in self._tasks:
            task.cancel()
        declarations, self._declared = self._declared, []
        for declaration in declarations:
            await declaration.undeclare()
        await self.register.close()
        with suppress(JournalError):
            await self._store.write_pending()

    async def _tick(self) -> None:
        check = keep_apart(self._access.tasks, self._check_time)
        while True:
            check()
            await self.register.serve_new()
            await self._service.check_disk(self._environment.find_free)
            await sleep_ns(self._environment.clock, TICK_NS)

    def _check_time(self) -> None:
        """Look at what changes with time alone."""
        self._fleet.tick()
        self._conditions.tick()
        self.register.check_service()
        self.register.end_shelving()


def _explain_reservation(reserved: Mapping[str, str], record: AlarmRecord | AlarmCause) -> str:
    """Why an alarm is out of service; empty: it is not."""
    return next((words for axis, words in reserved.items() if is_of_axes(record, {axis})), "")
