"""An adapter host: the units of one machine, and what they all hear (the reign, the e-stop)."""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import entry_points
from typing import Any, cast

from pydantic import ValidationError

from adapters.contract import Firer, Make, Setup
from adapters.controller.context import Seat
from adapters.controller.store import Remembered, Store
from adapters.controller.supervisor import Unit
from adapters.host.batch import AnswersTogether
from adapters.toolkit.firing import as_punctual_as
from orchestrator.bus.base import Bus, Declared, Handler, NoReply, RequestRefused, RequestTimeout, Sample
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log, Sink
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.clock.executor import Runs
from orchestrator.clock.fleet import Exchange, FleetScale, estimated_scale, exact_scale
from orchestrator.link.base import Link, OpenLink
from orchestrator.link.trace import TracedLink, TraceRing
from orchestrator.model.fleet import Controller, Fleet
from orchestrator.model.messages import Estop, Reign, TimeReply
from orchestrator.model.state import EstopLatch

# A coordinator that is silent for so long is lost: five of its heartbeats. Then what is armed is unloaded, and
# what moves is stopped by its own ramp.
COORDINATOR_LOST_NS = 500 * NS_PER_MS
TIME_EXCHANGES = 8
ANSWER_LEAVES_NS = 20 * NS_PER_MS  # for the answer to `configure` to be on its way before its unit is closed
BACKLOG_LIMIT = 200  # samples; some seconds of states and events


@cache
def find_make(name: str) -> Make:
    """The make that the entry points of `tutti.adapters` give for `name`; `ValueError` lists the known ones."""
    known = entry_points(group="tutti.adapters")
    for entry in known:
        if entry.name == name:
            return cast(Make, entry.load())
    raise ValueError(f"no adapter {name!r}; known adapters: {', '.join(sorted(each.name for each in known))}")


def check_controller(name: str, config: Controller) -> None:
    """Check a controller's part of the fleet file with its make. `ValueError` names controller, field and remedy."""
    try:
        make = find_make(config.adapter)
        make.options.model_validate(config.options)
        make.check(config)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"]))
        raise ValueError(f"controllers.{name}.options.{field}: {first['msg']}") from None
    except ValueError as error:
        raise ValueError(f"controllers.{name}: {error}") from None


def stops_by_line(controllers: Mapping[str, Controller]) -> list[tuple[list[str], bytes]]:
    """For each line the names of its controllers, and what stops all of them: a line is opened once."""
    lines: dict[str, tuple[list[str], list[bytes]]] = {}
    for name, config in controllers.items():
        names, stops = lines.setdefault(config.link.place, ([], []))
        names.append(name)
        stop = find_make(config.adapter).stop_bytes(config)
        # What reaches all units of a line need not be said for each.
        if stop not in stops:
            stops.append(stop)
    return [(names, b"".join(stops)) for names, stops in lines.values()]


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a host is given: everything that differs between live and virtual."""

    bus: Bus
    keys: Keys
    clock: Clock
    firer: Firer
    open_link: Callable[[str, Controller], OpenLink]
    store: Callable[[str], Store]
    runs: Runs
    sink: Sink
    instance: str


@dataclass(frozen=True, slots=True)
class _SharedLine:
    """What the units on one port have in common."""

    shared: dict[str, Any] = field(default_factory=dict[str, Any])
    trace: TraceRing = field(default_factory=TraceRing)


class AdapterHost:
    """Runs the controllers of `fleet` whose `host` is `name`."""

    def __init__(self, name: str, fleet: Fleet, around: Surroundings) -> None:
        self._name = name
        self._around = around
        self._log = Log("host", name, around.clock, around.sink, around.bus, around.keys)
        self._scale: FleetScale | None = None
        self._reign: Reign | None = None
        self._heard_ns: int | None = None
        self._congested = False
        self._declared: list[Declared] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._starts = 0
        self._lines: dict[str, _SharedLine] = {}
        self._lowering = asyncio.Lock()
        mine = {c: config for c, config in fleet.controllers.items() if config.host == name}
        self.units = {controller: self._unit(controller, config) for controller, config in mine.items()}
        self._together = AnswersTogether(around.keys, around.clock, self._answer_of)

    def _unit(self, controller: str, config: Controller) -> Unit:
        around, line = self._around, _SharedLine()
        if config.shares:
            line = self._lines.setdefault(config.link.place, line)
        self._starts += 1
        make = find_make(config.adapter)
        open_plain = around.open_link(controller, config)

        async def open_link() -> Link:
            return TracedLink(await open_plain(), line.trace)

        options = as_punctual_as(around.firer, make.options.model_validate(config.options))
        driver = make.driver(Setup(controller, config, options, around.clock, open_link, around.firer, line.shared))
        log = Log("controller", controller, around.clock, around.sink, around.bus, around.keys)
        log.fleet_ns = self._fleet_ns
        seat = Seat(
            controller=controller,
            config=config,
            make=make,
            driver=driver,
            bus=around.bus,
            keys=around.keys,
            clock=around.clock,
            open_link=open_link,
            trace=line.trace,
            log=log,
            instance=f"{around.instance}-{self._starts}",
            scale=lambda: self._scale,
            reconfigure=lambda controller, config: self._spawn(self._reconfigure(controller, config)),
            lowering=self._lowering,
        )
        return Unit(seat, Remembered(around.store(controller), around.runs))

    def _fleet_ns(self) -> int | None:
        return None if self._scale is None else self._scale.fleet_ns(self._around.clock.now_ns())

    async def start(self) -> None:
        """Listen, be present, and start all units."""
        bus, keys = self._around.bus, self._around.keys
        self._declared = [
            await bus.subscribe(keys.estop, self._hear_estop),
            await bus.subscribe(keys.reign, self._hear_reign),
            await bus.announce(keys.live("host", self._name, self._around.instance)),
        ]
        for unit in self.units.values():
            await unit.start()
        self._declared.append(await bus.serve(keys.together(self._name), self._together.answer))
        self._spawn(self._watch_reign())

    async def close(self) -> None:
        for unit in self.units.values():
            await unit.close()
        for declared in self._declared:
            await declared.undeclare()
        self._together.close()
        for task in list(self._tasks):
            task.cancel()

    def _answer_of(self, controller: str) -> Handler | None:
        unit = self.units.get(controller)
        return None if unit is None else unit.answer

    async def _reconfigure(self, controller: str, config: Controller) -> None:
        """Replace a unit; the new one knows what the old one has remembered, and must be adopted."""
        await sleep_ns(self._around.clock, ANSWER_LEAVES_NS)
        await self.units[controller].close()
        unit = self.units[controller] = self._unit(controller, config)
        self._log.info("another configuration", controller=controller, digest=config.digest)
        await unit.start()

    # The e-stop

    def _hear_estop(self, sample: Sample) -> None:
        """Anything on that key is an e-stop, a payload that nobody understands too."""
        try:
            heard = Estop.model_validate_json(sample.payload)
        except ValidationError:
            heard = Estop(event="garbled", actor="unknown", reason="an e-stop whose payload could not be read")
        latch = EstopLatch(event=heard.event, actor=heard.actor, reason=heard.reason, utc=self._around.clock.utc())
        # Who rests can wait for the millisecond that the orders to sixteen others take.
        for unit in sorted(self.units.values(), key=lambda unit: not unit.moves):
            self._spawn(unit.estop(latch))

    # The reign

    def _hear_reign(self, sample: Sample) -> None:
        try:
            reign = Reign.model_validate_json(sample.payload)
        except ValidationError as error:
            self._log.warning(f"a reign that can not be read: {error.errors()[0]['msg']}")
            return
        known = self._reign
        if known is not None and reign.epoch < known.epoch:
            return
        self._reign, self._heard_ns = reign, self._around.clock.now_ns()
        if self._scale is not None and self._scale.scale_id == reign.scale_id:
            return
        self._scale = exact_scale(reign, self._around.clock)
        if self._scale is None:
            self._spawn(self._estimate_scale(reign))

    async def _estimate_scale(self, reign: Reign) -> None:
        """Fleet time of a coordinator on another kernel."""
        exchanges: list[Exchange] = []
        clock = self._around.clock
        while len(exchanges) < TIME_EXCHANGES:
            sent_ns = clock.now_ns()
            try:
                reply = await self._around.bus.request(self._around.keys.time, b"", timeout_s=1.0)
            except (NoReply, RequestTimeout, RequestRefused):
                await sleep_ns(clock, 100 * NS_PER_MS)
                continue
            answer = TimeReply.model_validate_json(reply)
            if answer.scale_id != reign.scale_id:
                return
            exchanges.append(Exchange(sent_ns, clock.now_ns(), answer.fleet_ns))
        self._scale = estimated_scale(reign.scale_id, exchanges)

    async def _watch_reign(self) -> None:
        clock = self._around.clock
        while True:
            await sleep_ns(clock, COORDINATOR_LOST_NS // 5)
            self._watch_backlog()
            heard_ns = self._heard_ns
            if heard_ns is not None and clock.now_ns() - heard_ns > COORDINATOR_LOST_NS:
                self._heard_ns = None
                silent_ms = (clock.now_ns() - heard_ns) // NS_PER_MS
                for unit in self.units.values():
                    self._spawn(unit.coordinator_lost(f"the coordinator has been silent for {silent_ms} ms"))

    def _watch_backlog(self) -> None:
        """Say once that the bus does not keep up, and once that it does again."""
        congested = self._around.bus.backlog > BACKLOG_LIMIT
        if congested != self._congested:
            self._congested = congested
            waiting = self._around.bus.backlog
            self._log.warning(
                f"the bus does not keep up: {waiting} samples wait" if congested else "the bus keeps up again"
            )

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
