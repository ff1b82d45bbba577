"""An adapter host: the controller supervisors of one machine, and the messages for all of them (leadership, e-stop)."""

import asyncio
from collections.abc import Callable, Coroutine, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError

from adapters.contract import DriverSetup, TimedWriter
from adapters.controller.publishing.log import ControllerLog
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.poll_timer import find_poll_grid_ns
from adapters.controller.state.store import AdapterStore, PersistentMemory
from adapters.controller.supervisor import ControllerSupervisor
from adapters.host.batch import BatchAnswers
from adapters.host.fleet_time import FleetTime
from adapters.host.frames import FrameSource, HostFrames
from adapters.host.kept_latches import find_kept_latches
from adapters.host.leader_watch import COORDINATOR_LOST_NS, LeaderWatch
from adapters.host.makes import find_make_or_substitute
from adapters.host.served import ServedControllers, ServedHost, answer_behind
from adapters.toolkit.firing import apply_writer_delay
from orchestrator.bus.base import Bus, BusDeclaration, BusSample, RequestHandler
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.latch import read_estop
from orchestrator.bus.log import LogSink, ProcessLog
from orchestrator.bus.session_signs import SessionSigns
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.clock.executor import Executor
from orchestrator.clock.owner import TaskOwner
from orchestrator.link.base import Link, OpenLink
from orchestrator.link.trace import TracedLink, TraceRing
from orchestrator.model.fleet import Controller, Fleet
from orchestrator.model.messages import KeptEstop, LeaderHeartbeat
from orchestrator.model.problems import first_error_text
from orchestrator.model.state import CertificateEnd, EstopLatch

REPLY_SEND_NS = 20 * NS_PER_MS  # for the reply to `configure` to be sent before its supervisor is closed
BACKLOG_LIMIT = 200  # samples; some seconds of states and events


@dataclass(frozen=True, slots=True)
class HostEnvironment:
    """The environment of a host: everything that differs between live and virtual runs. certificate: of its session, if
    it has one."""

    bus: Bus
    keys: FleetKeys
    clock: Clock
    timed_writer: TimedWriter
    open_link: Callable[[str, Controller], OpenLink]
    store: Callable[[str], AdapterStore]
    runs: Executor
    sink: LogSink
    instance: str
    certificate: CertificateEnd | None = None


@dataclass(slots=True)
class _SharedPort:
    """The objects that the controllers on one port share. link: the one that was opened last."""

    shared: dict[str, Any] = field(default_factory=dict[str, Any])
    trace: TraceRing = field(default_factory=TraceRing)
    link: Link | None = None


class AdapterHost:
    """Run the controllers of `fleet` whose `host` is `name`."""

    def __init__(self, name: str, fleet: Fleet, environment: HostEnvironment) -> None:
        self._name = name
        self._environment = environment
        self._log = ProcessLog("host", name, environment.clock, environment.sink, (environment.bus, environment.keys))
        self._leaders = LeaderWatch(environment.clock)
        self._time = FleetTime(
            environment.bus,
            environment.keys,
            self._leaders,
            self._spawn_task,
            self._stop_for_jump,
        )
        self._congested = False
        self._fetching_estop = False
        self._declared: list[BusDeclaration] = []
        self._owner = TaskOwner(self._report_defect)
        self._broken = False
        self._starts = 0
        self._lines: dict[str, _SharedPort] = {}
        self._lowering_lock = asyncio.Lock()
        self._sessions = SessionSigns(environment.clock)
        own_controllers = {c: config for c, config in fleet.controllers.items() if config.host == name}
        bus, keys, clock = environment.bus, environment.keys, environment.clock
        self._poll_grid_ns = find_poll_grid_ns(len(own_controllers))
        source = FrameSource(name, environment.instance, bus, keys, clock, self._fleet_ns)
        self._frames = HostFrames(source, own_controllers)
        self.supervisors = {
            controller: self._create_supervisor(controller, config) for controller, config in own_controllers.items()
        }
        self._batch_answers = BatchAnswers(environment.keys, environment.clock, self._handler_of)

    def _create_supervisor(self, controller: str, config: Controller) -> ControllerSupervisor:
        around, line = self._environment, _SharedPort()
        if config.shares_port:
            line = self._lines.setdefault(config.link.endpoint, line)
        self._starts += 1
        make = find_make_or_substitute(config.adapter)
        open_plain = around.open_link(controller, config)

        async def open_link() -> Link:
            line.link = TracedLink(await open_plain(), line.trace)
            return line.link

        options = apply_writer_delay(around.timed_writer, make.options_model.model_validate(config.options))
        driver_log = ProcessLog("controller", controller, around.clock, around.sink)
        driver_log.fleet_ns = self._fleet_ns
        driver = make.create_driver(
            DriverSetup(
                controller=controller,
                config=config,
                options=options,
                clock=around.clock,
                open_link=open_link,
                timed_writer=around.timed_writer,
                shared=line.shared,
                log=ControllerLog(driver_log, controller, lambda: self._leaders.epoch),
            )
        )
        log = ProcessLog("controller", controller, around.clock, around.sink, (around.bus, around.keys))
        log.fleet_ns = self._fleet_ns
        seat = ControllerContext(
            controller=controller,
            config=config,
            make=make,
            driver=driver,
            keys=around.keys,
            clock=around.clock,
            outlet=self._frames,
            open_link=open_link,
            current_link=lambda: line.link,
            trace=line.trace,
            log=log,
            instance=f"{around.instance}-{self._starts}",
            scale=lambda: self._time.scale,
            follow_leader=self._follow_leader,
            replace_supervisor=lambda controller, config: self._spawn_task(
                self._replace_supervisor(controller, config)
            ),
            sessions=self._sessions,
            certificate=around.certificate,
            lowering_lock=self._lowering_lock,
            poll_grid_ns=self._poll_grid_ns,
        )
        return ControllerSupervisor(seat, PersistentMemory(around.store(controller), around.runs))

    def _fleet_ns(self) -> int | None:
        scale = self._time.scale
        return None if scale is None else scale.to_fleet_ns(self._environment.clock.now_ns())

    async def start(self) -> None:
        """Subscribe, announce the host, and start all supervisors."""
        bus, keys = self._environment.bus, self._environment.keys
        batch = answer_behind(self._frames.send_before_reply, self._batch_answers.answer_batch)
        served_host = ServedHost(keys, self._name, batch, self._frames.answer_states)
        self._declared = [
            await bus.subscribe(keys.estop, self._handle_estop),
            await bus.subscribe(keys.leader, self._handle_leadership),
            await bus.subscribe(keys.session(), self._sessions.receive_sign),
            await bus.announce(keys.live("host", self._name, self._environment.instance)),
            await bus.serve_group(keys.served_by_host(self._name), served_host),
        ]
        # A router with keys lets a host declare what it may serve, and no wildcard that others serve as well.
        has_keys = self._environment.certificate is not None
        controllers = ServedControllers(keys, self.supervisors, self._frames.send_before_reply)
        for expression in map(keys.served_of_controller, self.supervisors if has_keys else (None,)):
            self._declared.append(await bus.serve_group(expression, controllers))
        await self._frames.start()
        latches = await find_kept_latches(bus, keys)
        for unit in self.supervisors.values():
            await unit.start(latches)
        self._owner.spawn(self._watch_coordinator(), vital=True)

    @property
    def is_sound(self) -> bool:
        """Whether everything that must run does: the watchdog on coordinators, and the supervision of every link. A
        host that is not sound sends no signs of life, so that its guardian stops the controllers and restarts it."""
        return not self._broken and all(unit.is_supervising for unit in self.supervisors.values())

    async def close(self) -> None:
        for unit in self.supervisors.values():
            await unit.close()
        await self._frames.close()
        for declaration in self._declared:
            await declaration.undeclare()
        self._batch_answers.cancel_all()
        self._owner.cancel_all()

    def _handler_of(self, controller: str, verb: str) -> RequestHandler | None:
        """What handles a verb for a controller: a command, or the question for its information."""
        unit = self.supervisors.get(controller)
        return None if unit is None else unit.find_handler("info" if verb == "info" else "cmd")

    async def _replace_supervisor(self, controller: str, config: Controller) -> None:
        """Replace a supervisor; the new one keeps the memory of the old one, and must be adopted."""
        await sleep_ns(self._environment.clock, REPLY_SEND_NS)
        await self.supervisors[controller].close()
        unit = self.supervisors[controller] = self._create_supervisor(controller, config)
        self._log.info("another configuration", controller=controller, digest=config.digest)
        await unit.start(await find_kept_latches(self._environment.bus, self._environment.keys))

    # The e-stop

    def _handle_estop(self, sample: BusSample) -> None:
        self._apply_estop(read_estop(sample.payload, self._environment.clock.utc()), self.supervisors.values())

    def _apply_estop(self, latch: EstopLatch, units: Iterable[ControllerSupervisor]) -> None:
        # Moving controllers first: a controller at rest can wait the millisecond that the stops of 16 others take.
        for unit in sorted(units, key=lambda unit: not unit.is_moving):
            self._spawn_task(unit.stops.apply_estop(latch))

    # Leadership

    def _handle_leadership(self, sample: BusSample) -> None:
        try:
            heartbeat = LeaderHeartbeat.read_message(sample.payload)
        except ValidationError as error:
            self._log.warning(f"unreadable leader message: {first_error_text(error)}")
            return
        event = heartbeat.estop if self._leaders.receive_heartbeat(heartbeat) else ""
        if (
            event
            and not self._fetching_estop
            and any(unit.stops.misses_estop(event) for unit in self.supervisors.values())
        ):
            self._fetching_estop = True
            self._spawn_task(self._fetch_estop(event))

    async def _fetch_estop(self, event: str) -> None:
        """The coordinator keeps an e-stop that did not arrive here, because the bus was partly broken: fetch it, and
        apply it where it is still missing. Without an answer the next heartbeat begins anew."""
        keys = self._environment.keys
        try:
            kept_latches = await self._environment.bus.request_all(keys.kept_estop(), b"", timeout_s=1.0)
        finally:
            self._fetching_estop = False
        for key in sorted(kept_latches):
            with suppress(ValidationError):
                latch = KeptEstop.read_message(kept_latches[key]).estop
                if latch is not None and latch.event == event:
                    self._apply_estop(
                        latch, [unit for unit in self.supervisors.values() if unit.stops.misses_estop(event)]
                    )
                    return

    def _follow_leader(self, controller: str, leader: LeaderHeartbeat) -> None:
        """A coordinator has adopted `controller`: its heartbeat counts, and its fleet time is used."""
        newest = self._leaders.epoch
        self._leaders.follow(controller, leader)
        if newest is not None and leader.epoch < newest:
            return
        self._time.follow(leader)

    def _stop_for_jump(self) -> None:
        """A clock has jumped: what was timed by the scale before would run at other instants than promised."""
        reason = "the clock of this computer or of the coordinator's has jumped"
        self._log.warning(f"{reason}; moving axes are stopped")
        for unit in self.supervisors.values():
            self._spawn_task(unit.stops.handle_coordinator_loss(reason))

    async def _watch_coordinator(self) -> None:
        clock = self._environment.clock
        while True:
            await sleep_ns(clock, COORDINATOR_LOST_NS // 5)
            self._watch_backlog()
            for controller, silent_ns in self._leaders.find_lost().items():
                reason = f"the coordinator has been silent for {silent_ns // NS_PER_MS} ms"
                self._spawn_task(self.supervisors[controller].stops.handle_coordinator_loss(reason))

    def _watch_backlog(self) -> None:
        """Log once that the bus does not keep up, and once that it does again."""
        is_congested = self._environment.bus.backlog > BACKLOG_LIMIT
        if is_congested != self._congested:
            self._congested = is_congested
            queue_length = self._environment.bus.backlog
            self._log.warning(
                f"the bus does not keep up: {queue_length} samples are queued"
                if is_congested
                else "the bus keeps up again"
            )

    def _spawn_task(self, coroutine: Coroutine[Any, Any, None]) -> None:
        self._owner.spawn(coroutine, vital=False)

    def _report_defect(self, error: BaseException, vital: bool) -> None:  # noqa: FBT001 - a callback
        self._log.warning(f"a defect of the adapter host: {error!r}")
        self._broken = self._broken or vital
