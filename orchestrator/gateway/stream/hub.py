"""The stream of the state: one numbered difference for all readers, made at most 20 times a second.

A reader that is slow gets the newest state as a whole instead of the differences that it has missed; what waits for it
does not grow.
"""

import asyncio
import contextlib
import json
from collections.abc import Callable
from typing import Any

from pydantic import ValidationError

from orchestrator.bus.base import BusDeclaration, BusSample
from orchestrator.client import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.gateway.stream.clock_history import ClockHistory
from orchestrator.gateway.stream.fleet_state import FleetState
from orchestrator.gateway.stream.merge_patch import make_patch
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import ListJobs
from orchestrator.model.operation.alarms import AlarmsListed, ListAlarms
from orchestrator.model.report import FINISHED_STATES, QueueEntry, QueueState
from orchestrator.model.state import ClockMapping

TICK_NS = 50 * NS_PER_MS
QUIET_NS = 500 * NS_PER_MS  # longest time without a difference, also if nothing has changed
LOOK_NS = 5 * NS_PER_S  # period of asking for what is published on change only
ASK_S = 2.0
MAX_LISTED = 200  # jobs of the queue, as many as are published


def encode(value: Any) -> str:
    """Compact JSON."""
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


class StreamReader:
    """One reader. `wake` is called when there is something new; `take_frame` returns it."""

    def __init__(self, hub: "StreamHub", wake: Callable[[], None]) -> None:
        self.wake = wake
        self._hub = hub
        self._number: int | None = None

    def take_frame(self) -> str | None:
        """The newest difference, or the whole state if the reader has missed one; None: nothing is new."""
        hub = self._hub
        if self._number == hub.number:
            return None
        frame = hub.patch if self._number == hub.number - 1 else hub.make_state_frame()
        self._number = hub.number
        return frame

    def forget(self) -> None:
        """Let the next frame be the whole state."""
        self._number = None
        self.wake()

    def close(self) -> None:
        """End it."""
        self._hub.remove_reader(self)


class StreamHub:
    """Makes the frames. tutti: the gateway's own connection. `start` it, and `close` it before the bus."""

    def __init__(self, tutti: Tutti, clock: Clock) -> None:
        self.state = FleetState(tutti.keys, clock)
        self.clock_history = ClockHistory()
        self.number = 0
        self.patch = ""
        self._tutti, self.clock = tutti, clock
        self._shown: dict[str, Any] = {}
        self._readers: set[StreamReader] = set()
        self._changed = True
        self._framed_ns = clock.now_ns()
        self._state_frame: tuple[int, str] | None = None
        self._declared: list[BusDeclaration] = []
        self._tasks = TaskOwner()
        self._look_now = asyncio.Event()
        self.state.on_unknown_digest = self._look_now.set

    @property
    def readers(self) -> int:
        """The number of readers."""
        return len(self._readers)

    async def start(self) -> None:
        """Follow the fleet."""
        bus, keys = self._tutti.bus, self._tutti.keys
        for expression in self.state.key_expressions:
            self._declared.append(await bus.subscribe(expression, self._receive))
        self._declared.append(await bus.subscribe(keys.clock(), self._receive_mapping))
        self._declared.append(await bus.watch(keys.live("controller"), self._receive_presence))
        with contextlib.suppress(Refusal):
            self.state.take_states(await self._tutti.status(ASK_S))
        leases = (await bus.request_all(keys.leases, b"", ASK_S)).values()
        for payload in leases:
            self.state.take_sample(BusSample(f"{keys.prefix}/lease/any", payload))
        self._tasks.spawn(self._make_frames())
        self._tasks.spawn(self._look_around())

    async def close(self) -> None:
        """End it."""
        self._tasks.cancel_all()
        for declaration in self._declared:
            await declaration.undeclare()

    def add_reader(self, wake: Callable[[], None]) -> StreamReader:
        """A new reader; its first frame is the whole state."""
        if not self._readers:
            self._advance({})
        reader = StreamReader(self, wake)
        self._readers.add(reader)
        return reader

    def remove_reader(self, reader: StreamReader) -> None:
        self._readers.discard(reader)

    def make_state_frame(self) -> str:
        """The frame with the whole state, as of the newest difference."""
        if self._state_frame is None or self._state_frame[0] != self.number:
            self._state_frame = self.number, encode({"n": self.number, "state": self._shown})
        return self._state_frame[1]

    def note_change(self) -> None:
        """The state has changed by itself; a difference is due."""
        self._changed = True

    def _receive(self, sample: BusSample) -> None:
        self.state.take_sample(sample)
        self._changed = True

    def _receive_mapping(self, sample: BusSample) -> None:
        with contextlib.suppress(ValidationError):
            mapping = ClockMapping.read_message(sample.payload)
            self.clock_history.take_mapping(mapping, self.clock.now_ns())

    def _receive_presence(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback of the bus
        self.state.take_presence(key, present)
        self._changed = True

    async def _make_frames(self) -> None:
        while True:
            await sleep_ns(self.clock, TICK_NS)
            is_due = self.clock.now_ns() - self._framed_ns >= QUIET_NS
            if not self._readers or not (self._changed or is_due):
                continue
            self._changed = False
            state = self.state.compose()
            patch = make_patch(self._shown, state)
            if patch or is_due:
                self._advance(patch, state)

    def _advance(self, patch: dict[str, Any], shown: dict[str, Any] | None = None) -> None:
        self._shown = self.state.compose() if shown is None else shown
        self._framed_ns = self.clock.now_ns()
        self.number += 1
        self.patch = encode({"n": self.number, "patch": patch})
        for reader in list(self._readers):
            reader.wake()

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
            self.state.take_alarms(alarms.alarms)
            self.state.take_fleet(await tutti.load_fleet())
            if not self.state.has_queue:
                self.state.take_queue(await self._list_queue())
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
