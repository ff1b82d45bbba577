"""The stream of the state: one numbered difference for all readers of one need, made at most 20 times a second.

A reader that is slow gets the newest state as a whole instead of the differences that it has missed; what waits for it
does not grow.
"""

import asyncio
import contextlib

from orchestrator.bus.base import BusDeclaration, BusSample
from orchestrator.bus.states.feed import Arrival, ControllerFeed
from orchestrator.client import Tutti
from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.gateway.stream.fleet_state import FleetState
from orchestrator.gateway.stream.need import EVERYTHING, StreamNeed
from orchestrator.gateway.stream.stream_view import TICK_NS, StreamReader, StreamView
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import ListJobs
from orchestrator.model.operation.alarms import AlarmsListed, ListAlarms
from orchestrator.model.report import FINISHED_STATES, QueueEntry, QueueState

LOOK_NS = 5 * NS_PER_S  # period of asking for what is published on change only
ASK_S = 2.0
MAX_LISTED = 200  # jobs of the queue, as many as are published


class StreamHub:
    """Makes the frames. tutti: the gateway's own connection. `start` it, and `close` it before the bus."""

    def __init__(self, tutti: Tutti, clock: Clock) -> None:
        self.state = FleetState(tutti.keys, clock)
        self._tutti, self.clock = tutti, clock
        self._feed = ControllerFeed(tutti.bus, tutti.keys, clock.now_ns, self, self._find_host)
        self._views: dict[StreamNeed, StreamView] = {}
        self._changed = True
        self._declared: list[BusDeclaration] = []
        self._tasks = TaskOwner()
        self._look_now = asyncio.Event()
        self.state.on_unknown_digest = self._look_now.set

    @property
    def readers(self) -> int:
        """The number of readers."""
        return sum(len(view.readers) for view in self._views.values())

    async def start(self) -> None:
        """Follow the fleet."""
        bus, keys = self._tutti.bus, self._tutti.keys
        for expression in self.state.key_expressions:
            self._declared.append(await bus.subscribe(expression, self._receive))
        for role in ("host", "controller"):
            self._declared.append(await bus.watch(keys.live(role), self._receive_presence))
        await self._feed.start()
        leases = (await bus.request_all(keys.leases, b"", ASK_S)).values()
        for payload in leases:
            self.state.take_sample(BusSample(f"{keys.prefix}/lease/any", payload))
        self._tasks.spawn(self._make_frames())
        self._tasks.spawn(self._look_around())

    async def close(self) -> None:
        """End it."""
        self._tasks.cancel_all()
        await self._feed.close()
        for declaration in self._declared:
            await declaration.undeclare()

    def add_reader(self, need: StreamNeed = EVERYTHING) -> StreamReader:
        """A new reader; its first frame is the whole state, as far as it is needed."""
        view = self._find_view(need)
        reader = StreamReader(view, self._choose_view)
        view.readers.add(reader)
        if not view.number:
            view.advance(changed=True)
        return reader

    def _choose_view(self, reader: StreamReader, need: StreamNeed | None) -> None:
        """Move a reader to another view; None: to none. A view that is new then has its first frame at the next tick: a
        reader that changes its need all the time costs no more than one that does not."""
        reader.view.readers.discard(reader)
        if not reader.view.readers:
            self._views.pop(reader.view.need, None)
        if need is not None:
            reader.view = self._find_view(need)
            reader.view.readers.add(reader)

    def _find_view(self, need: StreamNeed) -> StreamView:
        view = self._views.get(need)
        if view is None:
            view = self._views[need] = StreamView(need, self.state, self.clock)
        return view

    def note_change(self) -> None:
        """The state has changed by itself; a difference is due."""
        self._changed = True

    def _receive(self, sample: BusSample) -> None:
        self.state.take_sample(sample)
        self._changed = True

    def take_arrival(self, arrival: Arrival) -> None:
        """Take what a host has published."""
        self.state.take_arrival(arrival)
        self._changed = True

    def take_bad_frame(self, text: str) -> None:
        """A frame was left out."""
        del text
        self.state.invalid += 1

    def _find_host(self, controller: str) -> str | None:
        fleet = self.state.fleet
        config = None if fleet is None else fleet.controllers.get(controller)
        return None if config is None else config.host

    def _receive_presence(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback of the bus
        self.state.take_presence(key, present)
        self._changed = True

    async def _make_frames(self) -> None:
        pause_ns = TICK_NS
        while True:
            await sleep_ns(self.clock, pause_ns)
            begin_ns = self.clock.now_ns()
            has_changed, self._changed = self._changed or self.state.is_behind, False
            for view in list(self._views.values()):
                view.advance(changed=has_changed)
            # What else the gateway does, jogs above all, has two thirds of its time, however much is asked for.
            pause_ns = max(TICK_NS, 2 * (self.clock.now_ns() - begin_ns))

    # What is published on change only

    async def _look_around(self) -> None:
        """Ask for queue, alarms and configuration: at the start, when they may be others, and from time to time."""
        while True:
            self._look_now.clear()
            await self._ask_leader()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_NS / NS_PER_S):
                    await self._look_now.wait()
            await sleep_ns(self.clock, NS_PER_S)

    async def _ask_leader(self) -> None:
        tutti, fields = self._tutti, self._tutti.request_fields()
        with contextlib.suppress(Refusal):
            alarms = await tutti.request_service("alarms", ListAlarms(**fields, all=False), AlarmsListed, ASK_S)
            self.state.messages.take_alarms(alarms.alarms)
            self.state.take_fleet(await tutti.load_fleet())
            if not self.state.jobs.has_queue:
                self.state.jobs.take_queue(await self._list_queue())
            self._changed = True

    async def _list_queue(self) -> QueueState:
        """The queue as the coordinator publishes it when it changes next."""
        entries: list[QueueEntry] = []
        for states in (None, "queued"):
            request = ListJobs(**self._tutti.request_fields(), limit=MAX_LISTED, state=states)
            queue = await self._tutti.request_service("list", request, QueueState, ASK_S)
            entries += [job for job in queue.jobs if job.state not in FINISHED_STATES]
        jobs = sorted({entry.id: entry for entry in entries}.values(), key=lambda entry: entry.place or 0)
        return queue.model_copy(update={"jobs": jobs[:MAX_LISTED], "total": len(jobs)})
