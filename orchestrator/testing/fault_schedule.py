"""Faults of the campaign in a test: by name, at a time, until a time or a repair."""

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from contextvars import Context
from random import Random
from typing import Any

from orchestrator.campaign.faults import FAULTS, FaultInjector, FaultKind
from orchestrator.campaign.injection.repairs import Repair, do_nothing
from orchestrator.client.api import Tutti
from orchestrator.clock.base import sleep_ns
from orchestrator.clock.virtual import VirtualClock
from orchestrator.model.errors import Refusal
from orchestrator.model.report import FINISHED_STATES
from orchestrator.runtime.virtual.fleet import VirtualFleet
from orchestrator.testing.client_bus import ClientBus
from orchestrator.testing.errors import BadTest, find_choice, find_controller
from orchestrator.testing.virtual_worker import VirtualWorker


def _raise_error(done: asyncio.Task[None]) -> None:
    if not done.cancelled():
        done.result()


class InjectedFault:
    """One fault of a test. affected: controllers, once it has begun."""

    def __init__(self, schedule: "FaultSchedule", kind: FaultKind, controller: str) -> None:
        self.kind = kind
        self.controller = controller
        self.begun = False
        self.over = False
        self.affected: list[str] = []
        self.undo: Repair = do_nothing
        self._schedule = schedule

    def __repr__(self) -> str:
        state = "repaired" if self.over else "in force" if self.begun else "to come"
        return f"<fault {self.kind.name} of {self.controller}: {state}>"

    def repair(self) -> None:
        """Repair it now; a fault that has not begun yet never does."""
        self._schedule.repair_now(self)


class FaultSchedule:
    """All faults of one virtual fleet. clients: the buses of the test's clients."""

    def __init__(self, fleet: VirtualFleet, clock: VirtualClock, worker: VirtualWorker, draw: Random) -> None:
        self.faults: list[InjectedFault] = []
        self.clients: list[ClientBus] = []
        self._fleet = fleet
        self._clock = clock
        self._worker = worker
        self._injector = FaultInjector(fleet, clock, draw)

    def add_fault(self, controller: str | None, name: str, at_ns: int | None, until_ns: int | None) -> InjectedFault:
        """Inject a fault now, or `at_ns` from now; repair it `until_ns` from now. Raises `UnknownName`, `BadTest`."""
        kind = FAULTS[find_choice("fault", name, FAULTS)]
        if until_ns is not None and until_ns <= (at_ns or 0):
            raise BadTest(f"fault {name}: until= must be later than at=")
        fault = InjectedFault(self, kind, self._find_member(kind, controller))
        self.faults.append(fault)
        if at_ns is None and not self._clock.loop.is_running():
            self._worker.run_coroutine(self._begin_fault(fault))
        else:
            self.start_task(self._sleep_then(at_ns or 0, self._begin_fault(fault)))
        if until_ns is not None:
            self.start_task(self._sleep_then(until_ns, self._end_fault(fault)))
        return fault

    def _find_member(self, kind: FaultKind, controller: str | None) -> str:
        fleet = self._fleet.fleet
        if controller is None:
            if kind.reach != "fleet":
                raise BadTest(f"fault {kind.name}: name its controller: one of {', '.join(fleet.controllers)}")
            controller = next(iter(fleet.controllers))
        make = find_controller(fleet, controller).adapter
        if kind.makes and make not in kind.makes:
            raise BadTest(f"{kind.name} is a fault of {' and '.join(kind.makes)}; {controller} is a {make}")
        if kind.of_databases:
            raise BadTest(
                f"{kind.name}: the journal of this fleet is a file; see `tutti sim campaign --fault {kind.name}`"
            )
        if kind.name == "permit-lost" and not fleet.permits:
            raise BadTest("permit-lost: the fleet has no permit that could be lost; add `permits` to its file")
        return controller

    def start_task(self, work: Coroutine[Any, Any, None]) -> None:
        """Run `work` outside every process of the fleet; an error in it ends the run."""
        task: asyncio.Task[None] = Context().run(self._clock.loop.create_task, work)
        task.add_done_callback(_raise_error)

    async def _sleep_then(self, after_ns: int, work: Coroutine[Any, Any, None]) -> None:
        await sleep_ns(self._clock, after_ns)
        await work

    async def _begin_fault(self, fault: InjectedFault) -> None:
        if fault.over:
            return
        fault.affected = self._injector.find_affected(fault.kind, fault.controller)
        if fault.kind.name == "operator-lost":
            fault.undo = self._silence_clients()
        elif fault.kind.name == "operator-interrupts":
            await self._cancel_jobs()
        else:
            fault.undo = await self._injector.inject_fault(fault.kind, fault.controller)
        fault.begun = True

    def _silence_clients(self) -> Repair:
        """The clients of the test give no signs of life any more, as after `kill -9`."""

        def set_silent(*, silent: bool) -> None:
            for client in self.clients:
                client.silent = silent

        set_silent(silent=True)
        return lambda: set_silent(silent=False)

    async def _cancel_jobs(self) -> None:
        """Cancel all running jobs, as the commands that wait for them do when they are interrupted."""
        operator: Tutti = self._fleet.make_client("operator")
        for job in (await operator.list_jobs()).jobs:
            if job.terms.session is not None and job.state not in FINISHED_STATES:
                with suppress(Refusal):
                    await operator.cancel_job(job.id)
        await operator.close()

    # Repair

    def repair_now(self, fault: InjectedFault) -> None:
        """Repair one fault; inside a call of the fleet, as soon as that waits."""
        if self._clock.loop.is_running():
            self.start_task(self._end_fault(fault))
        else:
            self._worker.run_coroutine(self._end_fault(fault))

    async def end_all(self) -> None:
        """Repair all that is still in force; what has not begun yet never does."""
        for fault in self.faults:
            await self._end_fault(fault)

    async def _end_fault(self, fault: InjectedFault) -> None:
        if fault.over:
            return
        fault.over = True
        if fault.begun:
            await self._injector.repair_fault(fault.undo)
