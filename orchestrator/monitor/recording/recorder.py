"""The recorder of a fleet: takes every message from the bus, and has them written. It only listens.

It puts nothing on the bus but its presence and its alarms.

It has ordinary priority, and is the first to drop: when the disk is slower than the bus, values that the next ones
replace are left out, then everything. What is left out is counted and recorded. Motion does not wait for it.
"""

from collections import Counter
from contextlib import suppress

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusDeclaration, BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.states.feed import Arrival, ControllerFeed
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.clock.executor import Executor, ThreadLock
from orchestrator.model.state import ControllerState
from orchestrator.monitor.recording.alarms import RecorderAlarms
from orchestrator.monitor.recording.channels import RECORDED_PARTS, find_channel
from orchestrator.monitor.recording.writer import ReceivedMessage, RecordingWriter

WRITE_NS = 200 * NS_PER_MS  # from one batch to the next
HOUSE_NS = NS_PER_S * 8 // 10  # from one closing of the chunks to the next: with a batch, at most 1 s
STILL_NS = NS_PER_S * 9 // 10  # from one state that has not changed to the next: with frames, at most 1.3 s
MAX_REPLACED_BYTES = 32_000_000  # that wait for the disk; then values that the next ones replace are left out
MAX_QUEUED_BYTES = 64_000_000  # then everything
TOO_SLOW = "the disk is slower than the bus"


class FleetRecorder:
    """Records what one fleet publishes. Call `run` in a task until the recorder is to end, then `close`."""

    def __init__(self, bus: Bus, keys: FleetKeys, clock: Clock, writer: RecordingWriter, execute: Executor) -> None:
        self.alarms = RecorderAlarms(bus, keys, clock)
        self._bus, self._keys, self._clock = bus, keys, clock
        self._writer, self._execute = writer, execute
        self._lock = ThreadLock()
        self._queued: list[ReceivedMessage] = []
        self._bytes = 0
        self._dropped: Counter[str] = Counter()
        self._feed = ControllerFeed(bus, keys, clock.now_ns, self)
        self._states: dict[str, tuple[int, ControllerState]] = {}
        """By controller: when its state was queued last, and that."""
        self._subscriptions: list[BusDeclaration] = []

    async def start(self) -> None:
        """Take every message from here on. What hosts publish of their controllers is recorded by controller."""
        for part in RECORDED_PARTS:
            expression = f"{self._keys.prefix}/{part}/**"
            self._subscriptions.append(await self._bus.subscribe(expression, self._receive, direct=True))
        await self._feed.start()

    def take_arrival(self, arrival: Arrival) -> None:
        """Queue what a host has published; a state that holds still, with its instants of now, once a second."""
        now_ns = self._clock.now_ns()
        for sample in arrival.samples:
            self._receive(sample)
            if sample.key.endswith("/state"):
                with suppress(ValidationError):
                    state = ControllerState.read_message(sample.payload)
                    self._states[state.controller] = now_ns, state
        for controller, confirmation in arrival.confirmations.items():
            queued_ns, state = self._states.get(controller, (now_ns, None))
            if state is not None and now_ns - queued_ns >= STILL_NS:
                state = confirmation.apply(state)
                self._states[controller] = now_ns, state
                self._receive(BusSample(self._keys.state(controller), state.to_json()))

    def take_bad_frame(self, text: str) -> None:
        """Record nothing of it: it has no key of a controller."""

    async def run(self) -> None:
        """Write what has come in, until cancelled."""
        house_ns = self._clock.now_ns() + HOUSE_NS
        while True:
            await sleep_ns(self._clock, WRITE_NS)
            await self._write_queued()
            self.alarms.publish_due()
            if self._clock.now_ns() >= house_ns:
                await self._execute(self._writer.keep_house)
                house_ns = self._clock.now_ns() + HOUSE_NS

    async def close(self) -> None:
        """Write what is left, and end all recordings."""
        await self._feed.close()
        for subscription in self._subscriptions:
            await subscription.undeclare()
        await self._write_queued()
        await self._execute(self._writer.close)

    def _receive(self, sample: BusSample) -> None:
        """Queue a message; in a thread of the bus."""
        channel, size = find_channel(sample.key), len(sample.payload)
        if not channel.is_recorded:
            return
        message = ReceivedMessage(sample.key, sample.payload, self._clock.now_ns())
        with self._lock:
            if self._bytes + size > (MAX_REPLACED_BYTES if channel.is_replaced else MAX_QUEUED_BYTES):
                self._dropped[sample.key] += 1
                return
            self._queued.append(message)
            self._bytes += size

    async def _write_queued(self) -> None:
        with self._lock:
            batch, dropped_count = self._queued, self._dropped
            self._queued, self._dropped = [], Counter()
        if dropped_count:
            await self._execute(self._writer.count_drops, TOO_SLOW, dropped_count)
        if batch:
            await self._execute(self._writer.write_messages, batch)
        # Only now: what a slow disk has not taken yet counts as well.
        with self._lock:
            self._bytes -= sum(len(message.payload) for message in batch)
