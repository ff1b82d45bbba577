"""A complete fleet in virtual time: simulators, connections, adapter hosts with a guardian, coordinators, one bus.

Each part is a `Process` of its own, so that it can be frozen and killed separately.
"""

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from contextvars import Context, copy_context
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any, TypeVar

from adapters.controller.state.store import FileStore
from adapters.host.host import AdapterHost, HostEnvironment
from adapters.host.makes import stops_by_line
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.limits import MAX_HOST_MESSAGE_BYTES
from orchestrator.bus.memory.bus import MemoryBus, MemoryNet
from orchestrator.bus.memory.medium import BusLatency
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.clock.crystal import ComputerClock
from orchestrator.clock.virtual import VirtualClock, VirtualProcess
from orchestrator.coordinator.coordinator import Coordinator
from orchestrator.coordinator.journal.sqlite.database import MEMORY
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.leadership.environment import RunCommand, run_no_command
from orchestrator.link.base import LinkRefused, OpenLink
from orchestrator.link.direct import DirectWire
from orchestrator.link.memory import MemoryWire, WireLink, WireModel, can_wire, serial_wire
from orchestrator.model.fleet import (
    CanBusLink,
    Controller,
    Fleet,
    SerialLink,
    WireConnection,
    group_by_link,
)
from orchestrator.model.links import InProcessLink
from orchestrator.model.state import CertificateEnd, ControllerState
from orchestrator.runtime.live.bridge import network_wire
from orchestrator.runtime.simulated import find_timing, make_simulator_options
from orchestrator.runtime.virtual.coordinators import VirtualCoordinators
from orchestrator.runtime.virtual.disk import VirtualDisk
from orchestrator.runtime.virtual.journal import JournalCalls
from sim.core.controller import DeviceSpec, FirmwareTiming, LineEndpoint, SimulatedController, build_line
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

# Latency of the live bus, through a router on one machine (measured: 0.3 ms a sample, 0.8 ms a request).
BUS_LATENCY = BusLatency(least_ns=200 * NS_PER_US, median_ns=300 * NS_PER_US, most_ns=600 * NS_PER_US)
GUARDIAN_TIMEOUT_NS = 300 * NS_PER_MS  # timeout of a guardian
RESTART_NS = 200 * NS_PER_MS
MAX_WAKE_DELAY_NS = 60 * NS_PER_US  # largest wake-up delay of the firing process
T = TypeVar("T")


@dataclass(slots=True)
class _RunningHost:
    """An adapter host and the number of its start."""

    name: str
    process: VirtualProcess
    links: list[WireLink] = field(default_factory=list[WireLink])


class VirtualFleet(VirtualCoordinators):
    """A simulation of the whole `fleet`; all randomness comes from `seed`. Create it outside every process.

    wired: the real wiring, where it differs from the fleet file.
    """

    def __init__(
        self,
        fleet: Fleet,
        clock: VirtualClock,
        seed: int = 0,
        wired: Fleet | None = None,
        *,
        guardian: bool = True,
    ) -> None:
        self.fleet = fleet
        self.computers: dict[str, ComputerClock] = {}
        """Clocks of adapter hosts that run on computers of their own, to be set before the start; the others, the
        coordinator, clients and the router are on one computer, whose clock is `computers[""]`, or virtual time."""
        self.certificates: dict[str, CertificateEnd] = {}
        """By adapter host, "" for the coordinator: the certificates of those that start from now on."""
        self.clock = clock
        self.net = MemoryNet(clock, seed=seed, latency=BUS_LATENCY)
        self.keys = FleetKeys(fleet.fleet)
        self.lines: list[str] = []
        self.site = None
        self.journal = SqliteJournal(MEMORY)
        self.controllers: dict[str, SimulatedController] = {}
        self.wires: dict[str, MemoryWire] = {}
        self.crystals: dict[str, Oscillator] = {}
        self.simulators: dict[str, VirtualProcess] = {}
        self.hosts: dict[str, _RunningHost] = {}
        self.adapter_hosts: dict[str, AdapterHost] = {}
        self.coordinators: dict[str, tuple[VirtualProcess, Coordinator]] = {}
        self.journal_clients = {}
        self.coordinator_disk = VirtualDisk(clock)
        self.journal_calls = JournalCalls(self.coordinator_disk)
        self.host_disks = {config.host: VirtualDisk(clock) for config in fleet.controllers.values()}
        self.run_command: RunCommand = run_no_command
        """Runs the command of `notify`."""
        self._guardian = guardian
        self.wrap_bus: Callable[[MemoryBus], Bus] = lambda bus: bus
        """Wraps the bus of a coordinator that starts, e.g. to observe it."""
        self._draw = Random(seed)
        self._starts = 0
        for names in group_by_link(fleet.controllers):
            self._start_simulator(names)
        for connection in (wired or fleet).connections:
            self._connect_wire(connection)

    # Start, wait, client

    async def start(self) -> None:
        """Start all adapter hosts and one coordinator; return when every controller is adopted and idle."""
        for host in self.fleet.hosts:
            self.start_host(host)
        self.start_coordinator("first")
        await self.wait_until(lambda states: all(state.epoch and state.mode == "idle" for state in states.values()))

    async def wait_until(
        self, holds: Callable[[dict[str, ControllerState]], bool], limit_s: float = 60.0
    ) -> dict[str, ControllerState]:
        """Wait until `holds` is true of the states of all controllers. Raises `TimeoutError` with the current
        states."""
        client = self.make_client("until")
        states: dict[str, ControllerState] = {}
        try:
            async with asyncio.timeout(limit_s):
                while True:
                    states = await client.status()
                    if len(states) == len(self.fleet.controllers) and holds(states):
                        return states
                    await sleep_ns(self.clock, 50 * NS_PER_MS)
        except TimeoutError:
            shown_modes = {name: (state.mode, state.epoch, state.faults) for name, state in states.items()}
            raise TimeoutError(f"after {limit_s} s the states are {shown_modes}") from None
        finally:
            await client.close()

    def make_client(self, name: str = "client") -> Tutti:
        """Return a client of the fleet, with a bus session of its own."""
        return Tutti(self.net.join_process(self.make_name(name)), self.fleet.fleet, name, self.draw_id)

    def draw_id(self) -> str:
        return f"{self._draw.getrandbits(128):032x}"

    # Simulated controllers

    def _start_simulator(self, names: Sequence[str]) -> None:
        """Simulate the controllers of one link: one process, one connection."""
        config = self.fleet.controllers[names[0]]
        process = VirtualProcess(self.clock.loop, f"sim/{'+'.join(names)}")
        units = {name: self._make_device(self.fleet.controllers[name]) for name in names}
        line = process.run_inside(lambda: build_line(find_simulator(config.adapter), self.clock, units))
        link = config.link
        make_wire = DirectWire if isinstance(link, InProcessLink) else MemoryWire
        wire = make_wire(
            clock=self.clock,
            model=_make_wire(config, line.endpoint),
            far=line.endpoint,
            port=link.kind if link.kind in line.endpoint.port_names else line.endpoint.port_names[0],
            endpoint=link.endpoint,
            far_context=process.run_inside(copy_context),
            seed=units[names[0]].seed,
        )
        for name in names:
            self.simulators[name], self.controllers[name], self.wires[name] = process, line.devices[name], wire
            self.crystals[name] = units[name].oscillator

    def _make_device(self, config: Controller) -> DeviceSpec:
        link, simulate, seed = config.link, config.simulate, self._draw.getrandbits(32)
        return DeviceSpec(
            address=link.address if isinstance(link, SerialLink | CanBusLink) else None,
            options=make_simulator_options(config),
            oscillator=Oscillator(round(simulate.offset_s * NS_PER_S), simulate.drift_ppm, simulate.wander_ppm, seed),
            timing=FirmwareTiming(*find_timing(config)),
            seed=seed,
        )

    def _connect_wire(self, connection: WireConnection) -> None:
        """Make an input follow an output after a delay; the delay of each wire is fixed, and lies within its bounds."""
        least_ns, most_ns = (delay_us * NS_PER_US for delay_us in connection.delay_us)
        delay_ns = self._draw.randint(least_ns, most_ns)
        source, number = self.controllers[connection.source], connection.driven_by.number

        def set_input(*, on: bool) -> None:
            level = connection.input_level(on=on)
            self.act_on_controller(connection.target, lambda unit: unit.set_input(connection.feeds.number, level=level))

        def on_output_change(output: int, *, on: bool) -> None:
            if output == number:
                # A wire belongs to no process.
                self.clock.call_at_ns(self.clock.now_ns() + delay_ns, lambda: set_input(on=on), context=Context())

        self.act_on_controller(
            connection.source, lambda unit: unit.on_output(lambda output, on: on_output_change(output, on=on))
        )
        set_input(on=source.output_level(number))

    def act_on_controller(self, controller: str, action: Callable[[SimulatedController], None]) -> None:
        """Act on the physical environment of a simulated controller, inside its own process."""
        self.simulators[controller].run_inside(lambda: action(self.controllers[controller]))

    # Adapter hosts

    def start_host(self, name: str) -> None:
        """Start (or restart) the adapter host `name`; with a guardian, it is supervised from now on."""
        label = self.make_name(f"host-{name}")
        process = VirtualProcess(self.clock.loop, label)
        host = self.hosts[name] = _RunningHost(name, process)
        computer = name if name in self.computers else ""
        clock = self.computers.get(computer, self.clock)
        bus = self.net.join_process(label, MAX_HOST_MESSAGE_BYTES, computer)

        def open_link(controller: str, config: Controller) -> OpenLink:
            async def open_memory_link() -> WireLink:
                link = await self.wires[controller].open_link(clock)
                host.links.append(link)
                return link

            return open_memory_link

        draw = Random(self._draw.getrandbits(32))
        disk = self.host_disks[name]
        environment = HostEnvironment(
            bus=bus,
            keys=self.keys,
            clock=clock,
            timed_writer=LoopTimedWriter(clock, lambda: draw.randrange(MAX_WAKE_DELAY_NS)),
            open_link=open_link,
            store=lambda controller: FileStore(Path(f"{controller}.json"), disk.access_files()),
            runs=disk.make_executor(),
            sink=self.lines.append,
            instance=label,
            certificate=self.certificates.get(name),
        )
        process.add_death_callback(lambda: self._clean_up_host(host, label))

        async def run_host() -> None:
            adapter_host = self.adapter_hosts[name] = AdapterHost(name, self.fleet, environment)
            await adapter_host.start()

        process.start_task(run_host())
        if self._guardian:
            self._run_outside(self._guard_host(host))

    def _clean_up_host(self, host: _RunningHost, label: str) -> None:
        """Clean up after a dead host, as the kernel does."""
        self.net.kill_process(label)
        for link in host.links:
            link.hang_up()

    async def _guard_host(self, host: _RunningHost) -> None:
        """The guardian: end a dead or hung host, stop its controllers, and restart it."""
        while host.process.alive and not host.process.frozen:
            await sleep_ns(self.clock, 50 * NS_PER_MS)
        await sleep_ns(self.clock, GUARDIAN_TIMEOUT_NS)
        if host.process.alive and not host.process.frozen:
            self._run_outside(self._guard_host(host))
            return
        host.process.kill()
        await sleep_ns(self.clock, NS_PER_MS)
        configs = {name: config for name, config in self.fleet.controllers.items() if config.host == host.name}
        await asyncio.gather(*(self._stop_link(names[0], stop) for names, stop in stops_by_line(configs)))
        await sleep_ns(self.clock, RESTART_NS)
        self.start_host(host.name)

    async def _stop_link(self, name: str, stop: bytes) -> None:
        """Stop everything on a controller's link."""
        try:
            link = await self.wires[name].open_link()
        except LinkRefused:
            return
        link.write(stop)
        await sleep_ns(self.clock, 50 * NS_PER_MS)
        await link.close()

    def save_fleet(self, fleet: Fleet) -> None:
        """Set the fleet file for hosts and coordinators that start from now on."""
        self.fleet = fleet

    # Processes by name, for faults

    def find_process(self, name: str) -> VirtualProcess:
        """Return the process `host/NAME`, `coordinator/NAME` or `sim/NAME` that runs now."""
        kind, _, host = name.partition("/")
        if kind == "host":
            return self.hosts[host].process
        return self.coordinators[host][0] if kind == "coordinator" else self.simulators[host]

    def freeze(self, name: str) -> None:
        """Like SIGSTOP."""
        process = self.find_process(name)
        process.freeze()
        if not name.startswith("sim/"):
            self.net.suspend_process(process.name)

    def resume(self, name: str) -> None:
        """Like SIGCONT."""
        process = self.find_process(name)
        if process.alive:
            process.resume()
            if not name.startswith("sim/"):
                self.net.resume_process(process.name)

    def kill(self, name: str) -> None:
        """Like SIGKILL."""
        self.find_process(name).kill()

    def make_name(self, name: str) -> str:
        self._starts += 1
        return f"{name}-{self._starts}"

    def _run_outside(self, coroutine: Coroutine[Any, Any, None]) -> None:
        """Run `coroutine` outside every process."""
        Context().run(self.clock.loop.create_task, coroutine)


def _make_wire(config: Controller, far: LineEndpoint) -> WireModel:
    """Return the connection from an adapter host to the device or bus of a controller."""
    hold_ns = round(config.simulate.hold_ms * NS_PER_MS)
    if isinstance(config.link, SerialLink):
        return serial_wire(config.link.baud, hold_ns=hold_ns)
    if isinstance(config.link, CanBusLink):
        return can_wire(hold_ns)
    return network_wire(config, far)
