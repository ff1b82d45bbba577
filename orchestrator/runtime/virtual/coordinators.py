"""The coordinators of a virtual fleet, whose journal is a file of their computer, or in databases."""

from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.latch import FileLatchStore
from orchestrator.bus.limits import MAX_COORDINATOR_MESSAGE_BYTES
from orchestrator.bus.memory.bus import MemoryBus, MemoryNet
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.crystal import ComputerClock
from orchestrator.clock.owner import running
from orchestrator.clock.virtual import VirtualClock, VirtualProcess
from orchestrator.coordinator.coordinator import Coordinator
from orchestrator.coordinator.journal.records import HistoryLost, JournalError
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.leadership.environment import CoordinatorEnvironment, RunCommand
from orchestrator.coordinator.leadership.leadership import AnotherLeader
from orchestrator.coordinator.leadership.lease import LeaseWatch
from orchestrator.coordinator.leadership.standby import stand_by
from orchestrator.model.fleet import Fleet
from orchestrator.model.state import CertificateEnd
from orchestrator.runtime.virtual.disk import VirtualDisk
from orchestrator.runtime.virtual.journal import JournalCalls

if TYPE_CHECKING:
    from collections.abc import Callable

    from orchestrator.runtime.virtual.databases.client import JournalClient
    from orchestrator.runtime.virtual.databases.site import DatabaseSite

RETRY_NS = NS_PER_S  # of a standby, after an error of the journal


class VirtualCoordinators:
    """What a virtual fleet starts coordinators with."""

    fleet: Fleet
    computers: dict[str, ComputerClock]
    certificates: dict[str, CertificateEnd]
    clock: VirtualClock
    net: MemoryNet
    keys: FleetKeys
    lines: list[str]
    journal: SqliteJournal
    """What the coordinators' journal contains at present."""
    site: "DatabaseSite | None"
    coordinators: dict[str, tuple[VirtualProcess, Coordinator]]
    journal_clients: "dict[str, JournalClient]"
    """By coordinator, where the journal is in databases."""
    coordinator_disk: VirtualDisk
    journal_calls: JournalCalls
    run_command: RunCommand
    wrap_bus: "Callable[[MemoryBus], Bus]"

    def draw_id(self) -> str:
        """Draw an id."""
        raise NotImplementedError

    def make_name(self, name: str) -> str:
        """Name a process that is started."""
        raise NotImplementedError

    def save_fleet(self, fleet: Fleet) -> None:
        """Store a reloaded fleet."""
        raise NotImplementedError

    def use_databases(self, site: "DatabaseSite") -> None:
        """Have the journal in databases, instead of a file on the coordinators' disk. Before the start."""
        self.site, self.journal = site, site.journal

    def start_coordinator(self, name: str, *, take_over: bool = False, standby: bool = False) -> VirtualProcess:
        """Start a coordinator on the fleet's journal; an error at its start is appended to `lines`.

        standby: it leads as soon as no other coordinator does, and ends the previous one, if the journal is a file of
        their computer. With databases it tries again after an error of the journal, and ends with its leadership, as
        `orchestrator.coordinator.process` does."""
        label = self.make_name(f"coordinator-{name}")
        process = VirtualProcess(self.clock.loop, label)
        bus = self.net.join_process(label, MAX_COORDINATOR_MESSAGE_BYTES)
        self._add_coordinator(name, process, bus)
        process.add_death_callback(lambda: self.net.kill_process(label))

        async def run_coordinator() -> None:
            while True:
                process, coordinator = self.coordinators[name]
                try:
                    if standby:
                        await self._stand_by(name, bus)
                    await coordinator.start(take_over=take_over, vacant=standby)
                except AnotherLeader as error:
                    self.lines.append(str(error))
                except JournalError as error:
                    if self.site is None or not standby or isinstance(error, HistoryLost):
                        raise
                    self.lines.append(f"cannot lead: {error}")
                    await sleep_ns(self.clock, RETRY_NS)
                    self._add_coordinator(name, process, bus)
                    continue
                break
            if self.site is not None:
                await coordinator.leadership_lost.wait()
                process.kill()

        process.start_task(run_coordinator())
        return process

    def _add_coordinator(self, name: str, process: VirtualProcess, bus: MemoryBus) -> None:
        if self.site is not None:
            from orchestrator.runtime.virtual.databases.client import JournalClient

            clock = self.computers.get("", self.clock)
            self.journal_clients[name] = JournalClient(self.site, self.fleet, clock, name, lambda: process.alive)
        client = self.journal_clients.get(name)
        coordinator = process.run_inside(lambda: Coordinator(self.fleet, self._make_environment(bus, client)))
        self.coordinators[name] = (process, coordinator)

    async def _stand_by(self, name: str, bus: MemoryBus) -> None:
        client = self.journal_clients.get(name)
        if client is not None:
            watch = LeaseWatch(client.terms, self.clock)
            async with running(watch.keep_looking()):
                await stand_by(bus, self.keys, self.clock, name, lambda: watch.is_over)
            return
        await stand_by(bus, self.keys, self.clock, name)
        for other_name, (silent, _) in self.coordinators.items():
            if other_name != name and silent.alive:
                silent.kill()

    def _make_environment(self, bus: MemoryBus, client: "JournalClient | None") -> CoordinatorEnvironment:
        return CoordinatorEnvironment(
            bus=self.wrap_bus(bus),
            keys=self.keys,
            clock=self.computers.get("", self.clock),
            journal=self.journal if client is None else client.journal,
            execute=self.journal_calls.make_executor() if client is None else client.execute,
            new_id=self.draw_id,
            sink=self.lines.append,
            save_fleet=self.save_fleet,
            latches=FileLatchStore(Path("estop.json"), self.coordinator_disk.access_files()),
            run_command=lambda words, text, variables, timeout_ns: self.run_command(words, text, variables, timeout_ns),
            find_free=self.coordinator_disk.find_free,
            certificate=self.certificates.get(""),
            journal_server=None if client is None else client.server,
        )
