"""A fleet live on this machine: router, simulators, adapter hosts under guardians, coordinator, as child processes.

A child that dies is restarted with growing pauses. Children have sessions of their own, so that Ctrl-C reaches only
this process, which ends them in order: the coordinator first, because it stops what moves. When this process is
killed its children end by themselves: the kernel signals those that registered their parent, simulators detect that
their input is closed.
"""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncGenerator, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, closing, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from orchestrator.bus.endpoint import BadEndpoint, make_socket_endpoint
from orchestrator.bus.identity import VARIABLE
from orchestrator.bus.logfile import rotate_if_large, rotate_open_file
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.service_manager import READY, STOPPING, ServiceManager
from orchestrator.keys.places import find_identity_folder
from orchestrator.model.errors import Refusal
from orchestrator.model.files.private_files import open_for_append, open_private_file, replace_private_file
from orchestrator.model.fleet import CanBusLink, Controller, Fleet, SerialLink, group_by_link
from orchestrator.model.links import InProcessLink
from orchestrator.runtime.live.bridge import bridge_baud
from orchestrator.runtime.live.commands import EXISTING_JOURNAL, make_coordinator_command
from orchestrator.runtime.live.killing import kill_process
from orchestrator.runtime.live.leader_probe import find_leader
from orchestrator.runtime.live.router_watch import watch_live_router
from orchestrator.runtime.live.run import FleetRun
from orchestrator.runtime.live.start_wait import START_LIMIT_S, wait_for_start
from orchestrator.runtime.services.parts import (
    COORDINATOR,
    GATEWAY,
    HOST,
    PARTS,
    RECORDER,
    ROUTER,
    list_certificate_options,
    list_gateway_options,
    list_recorder_options,
)
from orchestrator.runtime.simulated import find_timing, make_simulator_options
from orchestrator.runtime.state.folder import (
    ADAPTERS,
    FLEET_FILE,
    RECORDINGS,
    ROUTER_LATCH,
    UP_LOG,
    USERS_FILE,
    StateLock,
    UpFailed,
)
from sim.link.arguments import NEXT

END_TIMEOUT_S = 8.0
ROTATE_S = 10.0
RESTART_PAUSES_S = (0.2, 0.5, 1.0, 2.0, 5.0)
# These exit codes are final: a restart would give the same (bad input, port or leadership taken, journal unusable).
FINAL_EXIT_CODES = frozenset({2, 4, 5})
EXIT_PORT_IN_USE = 4  # of the router: another process uses its port
STANDBY = "coordinator/standby"
# What is recorded ends before the recorder.
_END_ORDER = [GATEWAY.name, COORDINATOR.name, HOST.name, RECORDER.name, "sim", ROUTER.name]
BUS_SOCKET = "bus.sock"
HAS_WORLDS = sys.platform != "win32"
"""Whether simulated controllers have named pipes, for changes of what surrounds them and wires between them."""
_OWN_SESSION: dict[str, Any] = (
    {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if sys.platform == "win32" else {"start_new_session": True}
)
"""Keeps Ctrl-C at a terminal from a child."""
# Of the coordinator, once it has led: another leads now, and the adapter hosts serve that one.
EXIT_LEADERSHIP_LOST = frozenset({4, 6})
CONTROLLERS_PER_SIMULATOR = 8  # simulated controllers on Ethernet in one process: the last one waits for all before it
# What a simulator's ready line reports as its endpoint, by the kind of the simulated link.
_ENDPOINT_FIELDS = {
    "tcp": ("host", "port"),
    "udp": ("host", "port"),
    "serial": ("device",),
    "can": ("interface", "channel"),
}

PrintLine = Callable[[str], None]


@dataclass(slots=True)
class ChildProcess:
    """One process of the fleet.

    ready_lines: number of lines that it prints when it is ready.
    ready_output: those lines."""

    name: str
    command: Sequence[str]
    log: Path
    ready_lines: int = 1
    process: asyncio.subprocess.Process | None = None
    starts: int = 0
    ready_output: Sequence[str] = ()
    ended: bool = False
    keeper: "asyncio.Task[None] | None" = None

    @property
    def part(self) -> str:
        """The part of the fleet that it is, or `sim`."""
        return self.name.partition("/")[0]

    @property
    def pid(self) -> int:
        """Process id of the current start."""
        return self.process.pid if self.process else 0

    @property
    def exit_code(self) -> int | None:
        """Exit code of the current start; None while it runs."""
        return self.process.returncode if self.process else None

    def add_option(self, option: str) -> None:
        """Give it an option from its next start on."""
        if option not in self.command:
            self.command = [*self.command, option]

    def last_error_line(self) -> str:
        """The last line that it wrote to standard error; "" if it wrote none."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1] if lines else ""


@dataclass(slots=True)
class LiveFleet:
    """All processes of a fleet on this machine. `say` receives lines for people.

    state: the folder of journal, latches and logs. run: how it runs. connect: the router, from the start on.
    """

    fleet: Fleet
    state: Path
    say: PrintLine
    run: FleetRun = field(default_factory=FleetRun)
    connect: str = field(init=False)
    page: str = ""
    """The address of the operators' page; empty: it is not served."""
    children: dict[str, ChildProcess] = field(default_factory=dict[str, ChildProcess])
    failed: "asyncio.Future[str] | None" = None
    _next_port: int = field(init=False)
    _lock: StateLock | None = None
    _tasks: TaskOwner = field(default_factory=TaskOwner)
    _manager: ServiceManager = field(default_factory=ServiceManager)
    _router_watch: TaskOwner = field(default_factory=TaskOwner)
    _beside: "asyncio.Future[tuple[None, None]] | None" = None

    def __post_init__(self) -> None:
        self.connect = self.run.connect
        self._next_port = self.run.first_port

    async def start(self) -> None:
        """Start all processes, in order. Raises `UpFailed`; then no process is left running."""
        async with self._starting() as lock:
            await self._start_router()
            lock.describe_fleet(self.fleet.fleet, self.connect)
            file = self.state / FLEET_FILE
            self._beside = asyncio.gather(self._start_recorder(file), self._start_gateway())
            if self.run.simulated:
                await self._start_simulators()
            replace_private_file(file, self.fleet.to_json())
            await self._start_hosts()
            command = [*make_coordinator_command(self.run, self.connect, self.state, file), *self._feed_option]
            coordinator = await self._start_child("coordinator", command)
            coordinator.add_option(EXISTING_JOURNAL)
            if self.run.standby:
                # Whichever of the two is restarted becomes the standby of the other.
                coordinator.add_option("--standby")
                await self._start_child(STANDBY, coordinator.command)
            await self._beside
            restart = self._restart_router if "router" in self.children else None
            watch = watch_live_router(self.connect, self.fleet, restart, self.say)
            self._router_watch.spawn(watch)
            self._manager.notify(READY)

    async def start_coordinator(self) -> None:
        """Start only a coordinator, which leads as soon as no other one does, for routers and hosts that run elsewhere.
        Raises `UpFailed`; then no process is left running."""
        async with self._starting() as lock:
            lock.describe_fleet(self.fleet.fleet, self.connect, COORDINATOR.name)
            file = self.state / FLEET_FILE
            replace_private_file(file, self.fleet.to_json())
            command = make_coordinator_command(self.run, self.connect, self.state, file)
            coordinator = await self._start_child(COORDINATOR.name, [*command, "--standby", *self._feed_option])
            coordinator.add_option(EXISTING_JOURNAL)
            self._manager.notify(READY)

    async def start_simulators(self) -> None:
        """Start only the simulated controllers, for other drivers than those of Tutti. Raises `UpFailed`; then no
        process is left running."""
        async with self._starting():
            await self._start_simulators()
            replace_private_file(self.state / FLEET_FILE, self.fleet.to_json())

    async def start_hosts(self) -> None:
        """Start only adapter hosts, with their simulators, for a coordinator on another computer. Raises `UpFailed`;
        then no process is left running."""
        async with self._starting() as lock:
            assert self.run.hosts is not None
            lock.describe_fleet(self.fleet.fleet, self.connect, "+".join(sorted(self.run.hosts)))
            if self.run.simulated:
                await self._start_simulators()
            self.save_fleet(self.fleet)
            await self._start_hosts(*self._feed_option)
            self._manager.notify(READY)

    @asynccontextmanager
    async def _starting(self) -> AsyncGenerator[StateLock]:
        """Lock the state folder, and start what the block starts; if that fails no process is left running."""
        self.failed = asyncio.get_running_loop().create_future()
        try:
            self._lock = StateLock(self.state)
            self._tasks.spawn(self._rotate_logs())
            yield self._lock
        except BaseException:
            await self.close()
            raise

    async def _start_hosts(self, *options: str) -> None:
        """Start the guardians of the adapter hosts that run here."""
        for host in self.fleet.hosts:
            if self.run.hosts is None or host in self.run.hosts:
                command = self._make_host_command(host, self.state / FLEET_FILE)
                await self._start_child(f"host/{host}", [*command, *options])

    @property
    def _feed_option(self) -> list[str]:
        """For the part of a service that feeds its watchdog: the coordinator, or without one each guardian."""
        return ["--feed-watchdog"] if self._manager.watchdog_s is not None else []

    def save_fleet(self, fleet: Fleet) -> None:
        """Use another fleet file for processes that are started from now on, with the simulators that run here."""
        controllers = {
            name: config.model_copy(update={"simulate": self.fleet.controllers[name].simulate})
            if name in self.fleet.controllers
            else config
            for name, config in fleet.controllers.items()
        }
        self.fleet = fleet.model_copy(update={"controllers": controllers})
        replace_private_file(self.state / FLEET_FILE, self.fleet.to_json())

    def change_simulation(self, controller: str, **change: object) -> None:
        """Change the physical environment of a simulated controller, e.g. `input=(1, True)`; see
        `sim/link/world.py`."""
        pipe = open_private_file(simulation_pipe(self.state, controller), os.O_WRONLY | os.O_NONBLOCK)
        with os.fdopen(pipe, "wb") as line:
            line.write(json.dumps(change).encode() + b"\n")

    async def close(self) -> None:
        """End all children, the coordinator first and the router last."""
        self._manager.notify(STOPPING)
        if self._beside is not None:
            # Not while they start: they would come into being behind this.
            self._beside.cancel()
            await asyncio.wait([self._beside])
        await self._router_watch.end_all()
        # Both coordinators at once: the standby must not take over from the other.
        coordinators = [self.children[name] for name in ("coordinator", STANDBY) if name in self.children]
        await asyncio.gather(*(self._end_child(child) for child in coordinators))
        for child in sorted(self.children.values(), key=lambda process: _END_ORDER.index(process.part)):
            await self._end_child(child)
        self._tasks.cancel_all()
        if self._lock is not None:
            self._lock.release()

    # Parts

    async def _start_simulators(self) -> None:
        """Replace every link of a controller here by that of a simulated controller."""
        controllers: dict[str, Controller] = {}
        for lines in _group_links(self._own_controllers()):
            command = [sys.executable, "-m", "sim.link.process"]
            for names in lines:
                command += [*([NEXT] if names is not lines[0] else []), *self._make_simulator_arguments(names)]
            child = await self._start_child(f"sim/{'+'.join(chain(*lines))}", command, len(lines))
            for names, ready in zip(lines, child.ready_output, strict=True):
                device = json.loads(ready)
                for name in names:
                    config = self.fleet.controllers[name]
                    link = config.link.model_copy(
                        update={field: device[field] for field in _ENDPOINT_FIELDS[config.link.kind]}
                    )
                    simulate = config.simulate.model_copy(update={"link": link})
                    controllers[name] = config.model_copy(update={"simulate": simulate})
                    self.say(f"{name}: simulated {config.adapter} on {link.endpoint}")
        if self.fleet.connections and not HAS_WORLDS:
            self.say("the wires between controllers are not simulated on this system")
        for connection in self.fleet.connections if HAS_WORLDS else ():
            if connection.target not in controllers:
                continue
            if connection.source not in controllers:
                self.say(f"{connection.source}.{connection.output} is on another computer: that wire is not simulated")
            self.change_simulation(connection.target, input=(connection.feeds.number, connection.input_level(on=False)))
        self.fleet = self.fleet.model_copy(update={"controllers": {**self.fleet.controllers, **controllers}})

    def _own_controllers(self) -> dict[str, Controller]:
        """The controllers of the adapter hosts here."""
        hosts_here = self.run.hosts
        return {
            name: controller
            for name, controller in self.fleet.controllers.items()
            if hosts_here is None or controller.host in hosts_here
        }

    async def _start_router(self) -> None:
        if self.connect:
            other_leader = None if self.run.take_over else await find_leader(self.connect, self.fleet.fleet)
            if other_leader is not None:
                # Checked before adapter hosts are started, which would be second drivers of the same controllers.
                raise UpFailed(
                    f"coordinator {other_leader.coordinator[:8]} leads fleet {self.fleet.fleet} (epoch "
                    f"{other_leader.epoch}) on {self.connect}; end its `tutti up` first, or start with "
                    "--take-over"
                )
            return
        endpoint = self._choose_endpoint()
        try:
            latch_arguments = [self.fleet.fleet, str(self.state / ROUTER_LATCH)]
            command = ROUTER.make_command(sys.executable, endpoint, str(os.getpid()), *latch_arguments)
            await self._start_child(ROUTER.name, command)
        except UpFailed:
            if self.children["router"].exit_code != EXIT_PORT_IN_USE:
                raise
            if self.run.private:
                raise UpFailed(self.children["router"].last_error_line()) from None
            raise UpFailed(
                f"port {self.run.port} of 127.0.0.1 is in use; choose another for the router: --port "
                f"{self.run.port + 1}; or, if a router listens there, use it: --connect {endpoint}"
            ) from None
        self.connect = endpoint
        self.say(f"router on {endpoint}")

    async def _restart_router(self) -> None:
        """Kill the router; it is started again as soon as it has ended. One that hangs does not end by itself."""
        process = self.children["router"].process
        if process is not None and process.returncode is None:
            await kill_process("router", process, self.say)

    def _choose_endpoint(self) -> str:
        """Where the router listens. Raises `UpFailed`."""
        if not self.run.private:
            return f"tcp/127.0.0.1:{self.run.port}"
        try:
            return make_socket_endpoint(str((self.state / BUS_SOCKET).absolute()))
        except BadEndpoint as error:
            raise UpFailed(f"{error}; choose another folder: --state") from None

    def _make_environment(self, name: str) -> dict[str, str] | None:
        """The environment of a process, with the identity of its role; None: that of this process."""
        name_of_part, _, host = name.partition("/")
        part = PARTS.get(name_of_part)
        if self.run.keys is None or part is None or part is ROUTER:
            return None
        try:
            folder = find_identity_folder(self.run.keys, part.role, host if part is HOST else None)
        except Refusal as error:
            raise UpFailed(f"{name}: {error.text}; {error.remedy}") from None
        return {**os.environ, VARIABLE: str(folder.absolute())}

    async def _start_recorder(self, file: Path) -> None:
        """Start the recorder; a fleet runs without it as well."""
        if self.run.record_quota is None:
            return
        folder, log = self.state / RECORDINGS, self.state / "log" / "recorder.jsonl"
        options = list_recorder_options(self.fleet.fleet, str(file), self.connect, str(folder), self.run.record_quota)
        command = RECORDER.make_command(sys.executable, *options, "--log", str(log))
        if self.run.metrics_port is not None:
            command += ["--metrics-port", str(self.run.metrics_port)]
        try:
            recorder = await self._start_child(RECORDER.name, [*command, "--parent", str(os.getpid())])
            if recorder.ready_output[0]:
                self.say(recorder.ready_output[0])
        except UpFailed as error:
            self.say(f"nothing is recorded: {error}")

    async def _start_gateway(self) -> None:
        """Start the gateway; a fleet runs without it as well."""
        web = self.run.web
        if web is None:
            return
        if self.run.private and not (self.state / USERS_FILE).exists():
            # Otherwise every user of this computer would be an operator, by the page.
            self.say("no page: with --private it needs users: `tutti user add NAME --role operator`, then start again")
            return
        log = self.state / "log" / "gateway.jsonl"
        options = list_gateway_options(self.fleet.fleet, self.connect, str(self.state), str(log))
        command = GATEWAY.make_command(sys.executable, *options, "--parent", str(os.getpid()))
        command += ["--address", web.host, *([] if web.jobs is None else ["--jobs", str(web.jobs)])]
        if web.certificate is not None:
            command += list_certificate_options(*map(str, web.certificate))
        port_options = [] if web.port is None else ["--port", str(web.port)]
        try:
            gateway = await self._start_child(GATEWAY.name, [*command, *port_options])
        except UpFailed as error:
            self.say(f"no page: {error}")
            return
        self.say(gateway.ready_output[0])
        self.page = gateway.ready_output[0].partition(" on ")[2]
        # A restart serves under the same address again.
        gateway.command = [*command, "--port", self.page.rstrip("/").rpartition(":")[2]]

    def _make_simulator_arguments(self, names: Sequence[str]) -> list[str]:
        """Return the arguments of a simulator for the controllers of one link."""
        name, config = "+".join(names), self.fleet.controllers[names[0]]
        if isinstance(config.link, CanBusLink):
            listen = ["--listen", f"pty:{self.state / 'ports' / name}"]
        elif isinstance(config.link, SerialLink):
            # A restart listens at the same endpoint again: the symlink is stable.
            listen = ["--listen", f"pty:{self.state / 'ports' / name}", "--baud", str(config.link.baud)]
            listen += ["--frame", format_serial_frame(config.link)]
        else:
            listen = [
                "--listen",
                f"{config.link.kind}:127.0.0.1:{self._choose_port()}",
                "--baud",
                str(bridge_baud(config)),
            ]
        arguments = ["--model", config.adapter, "--name", name, *listen]
        for unit in names:
            arguments += ["--unit", json.dumps(self._make_simulated_controller(unit))]
        return arguments

    def _choose_port(self) -> int:
        """Return the port of the next simulated controller on Ethernet."""
        if not self._next_port:
            return find_free_port()
        self._next_port += 1
        return self._next_port - 1

    def _make_simulated_controller(self, name: str) -> dict[str, object]:
        """Return the value of `--unit` for a controller."""
        config = self.fleet.controllers[name]
        link, simulate = config.link, config.simulate
        return {
            "name": name,
            "address": link.address if isinstance(link, SerialLink | CanBusLink) else None,
            "options": make_simulator_options(config),
            "timing": find_timing(config)._asdict(),
            "oscillator": {
                "offset_ns": round(simulate.offset_s * 1e9),
                "drift_ppm": simulate.drift_ppm,
                "wander_ppm": simulate.wander_ppm,
            },
            "world": str(simulation_pipe(self.state, name)) if HAS_WORLDS else None,
            "truth": str(self.state / "truth" / f"{name}.jsonl") if self.run.truth else None,
            "wires": [
                {
                    "output": connection.driven_by.number,
                    "world": str(simulation_pipe(self.state, connection.target)),
                    "input": connection.feeds.number,
                    "level_when_on": connection.input_level(on=True),
                    "delay_us": sum(connection.delay_us) // 2,
                }
                for connection in self.fleet.connections
                if HAS_WORLDS and connection.source == name and connection.target in self._own_controllers()
            ],
        }

    def _make_host_command(self, host: str, file: Path) -> list[str]:
        command = HOST.make_command(sys.executable, "--fleet", str(file), "--host", host)
        command += ["--connect", self.connect, "--state", str(self.state / ADAPTERS), "--parent", str(os.getpid())]
        return [*command, "--log", str(self.state / "log" / f"host-{host}.jsonl")]

    async def _rotate_logs(self) -> None:
        """Limit the files that children, and a detached `tutti up`, have open as their standard error."""
        folder = self.state / "log"
        while True:
            await asyncio.sleep(ROTATE_S)
            for path in (*folder.glob("*.err"), folder / UP_LOG):
                # A full disk must not end the fleet.
                with suppress(OSError):
                    rotate_open_file(path)

    # Children

    async def _start_child(self, name: str, command: Sequence[str], tells: int = 1) -> ChildProcess:
        log = self.state / "log" / f"{name.replace('/', '-')}.err"
        child = self.children[name] = ChildProcess(name, command, log, tells)
        await self._spawn_process(child)
        child.keeper = self._tasks.spawn(self._supervise_child(child))
        return child

    async def _spawn_process(self, child: ChildProcess) -> None:
        """Start the process and wait for its ready lines. Raises `UpFailed` with its output."""
        rotate_if_large(child.log)
        with os.fdopen(open_for_append(child.log), "ab") as errors:
            child.process = await asyncio.create_subprocess_exec(
                *child.command,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=errors,
                **_OWN_SESSION,
                env=self._make_environment(child.name),
            )
        child.starts += 1
        assert child.process.stdout is not None
        try:
            lines = await wait_for_start(child.name, _read_lines(child.process.stdout, child.ready_lines), self.say)
        except TimeoutError:
            raise UpFailed(f"{child.name} is not ready after {START_LIMIT_S:g} s; see {child.log}") from None
        if not all(lines):
            exit_text = _describe_exit(await child.process.wait())
            raise UpFailed(f"{child.name} ended ({exit_text}): {child.last_error_line() or f'see {child.log}'}")
        child.ready_output = [line.decode().strip() for line in lines]

    async def _supervise_child(self, child: ChildProcess) -> None:
        """Restart a child that died, unless its exit code is final."""
        while True:
            assert child.process is not None
            code = await child.process.wait()
            if child.ended:
                return
            if child.name == "coordinator" and code in EXIT_LEADERSHIP_LOST and "--standby" not in child.command:
                self.say(
                    f"{child.name} has lost leadership, another coordinator leads; the adapter hosts here "
                    "serve that one"
                )
                return
            consequence = PARTS[child.part].missing if child.part in PARTS else ""
            if code in FINAL_EXIT_CODES and consequence:
                self.say(f"{consequence}: {child.last_error_line() or f'exit code {code}'}")
                return
            if code in FINAL_EXIT_CODES:
                self._report_failure(f"{child.name} ended: {child.last_error_line() or f'exit code {code}'}")
                return
            pause_s = RESTART_PAUSES_S[min(child.starts, len(RESTART_PAUSES_S)) - 1]
            self.say(f"{child.name} ended ({_describe_exit(code)}); restarting it in {pause_s:g} s")
            await asyncio.sleep(pause_s)
            if child.ended:
                return
            try:
                await self._spawn_process(child)
            except UpFailed as error:
                self.say(str(error))
                if child.process.returncode is None:
                    child.process.kill()

    def _report_failure(self, text: str) -> None:
        self.say(text)
        if self.failed is not None and not self.failed.done():
            self.failed.set_result(text)

    async def _end_child(self, child: ChildProcess) -> None:
        child.ended = True
        process = child.process
        if process is not None and process.returncode is None:
            _request_end(process)
            try:
                async with asyncio.timeout(END_TIMEOUT_S):
                    await process.wait()
            except TimeoutError:
                self.say(f"{child.name} did not end within {END_TIMEOUT_S:g} s and is killed")
                await kill_process(child.name, process, self.say)
        if child.keeper is not None:
            child.keeper.cancel()


def _request_end(process: asyncio.subprocess.Process) -> None:
    if sys.platform == "win32":
        # No signal lets it end by itself. Only simulators run there, which end with their input.
        assert process.stdin is not None
        process.stdin.close()
        return
    # In this order: a signal to a child that has just ended takes its exit code from asyncio's watcher.
    process.send_signal(signal.SIGCONT)
    process.send_signal(signal.SIGTERM)


def _group_links(controllers: Mapping[str, Controller]) -> Iterator[list[list[str]]]:
    """Group the links whose controllers one process simulates.

    Controllers of one make on Ethernet share processes: a process that was asleep is woken for each exchange, finds
    its caches overwritten, and takes several times as long."""
    ethernet: dict[str, list[list[str]]] = {}
    for names in group_by_link(controllers):
        config = controllers[names[0]]
        if isinstance(config.link, InProcessLink):
            continue  # it is simulated where its adapter is
        if isinstance(config.link, SerialLink | CanBusLink):
            yield [names]
        else:
            ethernet.setdefault(config.adapter, []).append(names)
    for lines in ethernet.values():
        for at in range(0, len(lines), CONTROLLERS_PER_SIMULATOR):
            yield lines[at : at + CONTROLLERS_PER_SIMULATOR]


def simulation_pipe(state: Path, controller: str) -> Path:
    """Return the pipe for lines that change the physical environment of a simulated controller."""
    return state / "world" / controller


def format_serial_frame(link: SerialLink) -> str:
    """Return data bits, parity and stop bits in the usual short form, e.g. `8N1`."""
    return f"{link.data_bits}{link.parity[0].upper()}{link.stop_bits}"


def find_free_port() -> int:
    """Return a TCP port that is not in use."""
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


async def _read_lines(stream: asyncio.StreamReader, count: int) -> list[bytes]:
    return [await stream.readline() for _ in range(count)]


def _describe_exit(code: int) -> str:
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
