"""The bus in virtual time: one shared medium in memory, driven by the given clock alone.

It guarantees what Zenoh guarantees and no more, and has the same faults: partitions, dead and hung processes. All
random values come from one seed; nothing depends on the order of a set or on a hash.

A process in virtual time is identified by the context (`contextvars`) that its code runs in. Every callback and
handler therefore runs in the context in which it was declared, and the medium runs in the context in which the
`MemoryNet` was made: make it outside all processes.
"""

import asyncio
import contextvars
import random
from collections.abc import Callable
from functools import partial

from orchestrator.bus.answering import FindAnswers, answer_expression, answer_group
from orchestrator.bus.base import BusClosed, BusDeclaration, BusSample, Priority, RequestHandler, ServedGroup
from orchestrator.bus.budgets import find_most_bytes, is_estop_key
from orchestrator.bus.expression import check_expression, check_key, check_put
from orchestrator.bus.limits import MAX_MESSAGE_BYTES
from orchestrator.bus.memory.disturbances import Disturbances
from orchestrator.bus.memory.medium import BusLatency, BusProcess, CallQueue
from orchestrator.bus.memory.network import Network
from orchestrator.bus.memory.presence import PresenceBoard, PresenceToken
from orchestrator.bus.memory.requests import RequestBoard, ServedExpression
from orchestrator.bus.memory.subscriptions import Subscription, SubscriptionBoard
from orchestrator.bus.memory.traffic import Uncounted
from orchestrator.bus.outcome import RequestOutcome
from orchestrator.bus.requesting import RequestingBus
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.virtual import VirtualClock

LEASE_NS = 10 * NS_PER_S
"""How long a silent process counts as present: Zenoh's default."""

RECONNECT_NS = 200 * NS_PER_MS
"""How long a process needs to reconnect after it was given up."""

DEATH_NS = 2 * NS_PER_MS
"""How long a death takes to be detected: the kernel closes the socket, the router notifies the others."""

QUEUE_LIMIT = 1000
"""Maximum droppable samples that wait for a process that does not run; more are lost."""


class MemoryNet:
    """The shared medium. Only the code that injects faults holds it; processes get the result of `join_process`."""

    def __init__(
        self,
        clock: VirtualClock,
        *,
        seed: int = 0,
        latency: BusLatency | None = None,
        queue_limit: int = QUEUE_LIMIT,
    ) -> None:
        self.clock = clock
        self._rng = random.Random(seed)
        self._latency = latency or BusLatency()
        self._queue_limit = queue_limit
        self._context = contextvars.copy_context()
        self._buses: dict[str, MemoryBus] = {}
        self._sides: dict[str, int] = {}
        self._lost_sides: dict[str, int] = {}
        self._cuts = 0
        self._blocked_ways: set[tuple[str | None, str]] = set()
        self._joined = 0
        self._lossy: dict[str, float] = {}
        self.traffic = Uncounted()  # replaced by what counts
        self.network = Network(seed)
        self.disturbances = Disturbances()
        self.subscriptions = SubscriptionBoard(self)
        self.presence = PresenceBoard(self)
        self.requests = RequestBoard(self)

    # Faults

    def cut_computer(self, computer: str, *, receives: bool = False, sends: bool = False) -> None:
        """Cut a computer off the others, or only one direction of that; presence is lost after the lease."""
        self.network.cut_computer(computer, receives=receives, sends=sends)
        self._follow_cut(computer, self.clock.now_ns() + LEASE_NS)

    def mend_computer(self, computer: str) -> None:
        """End what `cut_computer` began. Messages pass at once; presence returns when all have reconnected."""
        self.network.mend_computer(computer)
        self.presence.refresh_watches()
        self._follow_cut(computer, self.clock.now_ns() + RECONNECT_NS)

    def _follow_cut(self, computer: str, at_ns: int) -> None:
        def follow() -> None:
            self.network.set_lost(computer, lost=self.network.is_cut_off(computer))
            self.presence.refresh_watches()

        self.schedule_call(at_ns, follow)

    def join_process(self, name: str, max_message_bytes: int = MAX_MESSAGE_BYTES, computer: str = "") -> "MemoryBus":
        """Connect the process `name`, which may be a new start of one that left or was killed.

        max_message_bytes: larger messages are left out before they are read; an e-stop counts all the same. computer:
        where it runs, see `network`.
        """
        if name in self._buses:
            raise ValueError(f"{name!r} is on the bus already")
        bus = MemoryBus(self, name, self._queue_limit, max_message_bytes, computer)
        self._buses[name] = bus
        return bus

    def partition_net(self, *sides: set[str]) -> None:
        """Split the medium: samples and requests between sides are lost from now on, presence after the lease.

        A process that is in no side reaches all. Replaces an earlier partition.
        """
        self._sides = {name: number for number, side in enumerate(sides) for name in sorted(side)}
        self._cuts += 1
        cut = self._cuts

        def lose_presence() -> None:
            if self._cuts == cut:
                self._lost_sides = self._sides
                self.presence.refresh_watches()

        self.schedule_call(self.clock.now_ns() + LEASE_NS, lose_presence)

    def heal_partition(self) -> None:
        """End the partition. Samples and requests pass at once; presence returns when all have reconnected."""
        self._sides = {}
        self._cuts += 1
        cuts = self._cuts
        self.presence.refresh_watches()

        def restore_presence() -> None:
            if self._cuts == cuts:
                self._lost_sides = {}
                self.presence.refresh_watches()

        self.schedule_call(self.clock.now_ns() + RECONNECT_NS, restore_presence)

    def block_way(self, sender: str | None, receiver: str) -> None:
        """Lose all samples, requests and replies from `sender` (None: any process) to `receiver` from now on. The other
        direction stays open. For less than the lease: presence stays as it was."""
        self._blocked_ways.add((sender, receiver))

    def open_way(self, sender: str | None, receiver: str) -> None:
        """End what `block_way` began."""
        self._blocked_ways.discard((sender, receiver))
        self.presence.refresh_watches()

    def set_loss(self, name: str, share: float) -> None:
        """Drop this share (0 to 1) of a process's droppable samples."""
        self._lossy[name] = share

    def kill_process(self, name: str) -> None:
        """Kill the process: nothing leaves or reaches it any more. Others detect it within milliseconds.

        This method, `suspend_process` and `resume_process` do nothing if the process has left the bus before.
        """
        bus = self._buses.pop(name, None)
        if bus is None:
            return
        bus.alive = False
        self.drop_declarations(bus)

        def remove_presence() -> None:
            self.requests.fail_requests(bus)
            self.presence.remove_process(bus)

        self.schedule_call(self.clock.now_ns() + DEATH_NS, remove_presence)

    def suspend_process(self, name: str) -> None:
        """Suspend the process: what it sends or receives waits, requests to it time out, presence lasts for a lease."""
        bus = self._buses.get(name)
        if bus is None:
            return
        bus.hung = True
        bus.hangs += 1
        hang = bus.hangs

        def give_up() -> None:
            if bus.alive and bus.hung and bus.hangs == hang:
                bus.given_up = True
                self.requests.fail_requests(bus)
                self.presence.refresh_watches()

        self.schedule_call(self.clock.now_ns() + LEASE_NS, give_up)

    def resume_process(self, name: str) -> None:
        """Resume the process: what waited is delivered. If it was given up, it reconnects a little later."""
        bus = self._buses.get(name)
        if bus is None:
            return
        bus.hung = False
        bus.outgoing.run_calls()
        bus.incoming.run_calls()
        hang = bus.hangs

        def reconnect() -> None:
            if bus.alive and not bus.hung and bus.hangs == hang:
                bus.given_up = False
                self.presence.refresh_watches()

        if bus.given_up:
            self.schedule_call(self.clock.now_ns() + RECONNECT_NS, reconnect)

    # Used by the parts of the medium

    def draw_server(self) -> str:
        """A name for the connection of a process, never used before."""
        self._joined += 1
        return f"server-{self._joined}"

    def schedule_call(self, at_ns: int, call: Callable[[], None]) -> None:
        """Schedule a call of the medium in its own context, whatever the caller's context."""
        self.clock.call_at_ns(at_ns, call, context=self._context)

    def arrival_ns(self, sender: BusProcess, receiver: BusProcess, priority: Priority = Priority.EVENT) -> int:
        """The arrival time of something that is sent now."""
        least_ns = self._latency.least_ns
        latency_ns = least_ns if priority is Priority.ESTOP else self._latency.draw_ns(self._rng)
        return self.clock.now_ns() + latency_ns + self.network.delay_ns(sender, receiver)

    def is_cut(self, sender: BusProcess, receiver: BusProcess) -> bool:
        """Whether nothing passes from one process to the other now."""
        return (
            sender.given_up
            or receiver.given_up
            or _are_apart(self._sides, sender, receiver)
            or self.network.is_cut(sender, receiver)
            or (bool(self._blocked_ways) and _is_way_blocked(self._blocked_ways, sender, receiver))
        )

    def is_lost(self, one: BusProcess, other: BusProcess) -> bool:
        """Whether two processes count each other as gone."""
        is_lost = _are_apart(self._lost_sides, one, other) or self.network.is_lost(one, other)
        return one.given_up or other.given_up or is_lost

    def deliver_call(self, bus: BusProcess, priority: Priority, call: Callable[[], None]) -> None:
        """Deliver something to a process: now, or when the process runs again."""
        if not bus.alive:
            return
        if bus.hung:
            bus.incoming.add_call(priority, call)
        else:
            call()

    def leave_net(self, bus: "MemoryBus") -> None:
        """A process disconnects in good order."""
        if self._buses.get(bus.name) is bus:
            del self._buses[bus.name]
        self.drop_declarations(bus)
        self.requests.cancel_answers(bus)
        self.schedule_call(self.arrival_ns(bus, bus), partial(self.requests.fail_requests, bus))
        self.presence.remove_process(bus)

    # Samples

    def drop_declarations(self, bus: "MemoryBus") -> None:
        """Remove the subscriptions and served keys of a process."""
        self.subscriptions.remove_process(bus)
        self.requests.remove_servers(bus)

    def send_sample(self, sender: "MemoryBus", sample: BusSample, priority: Priority) -> None:
        """Send a sample to all subscribers."""
        share = self._lossy.get(sender.name, 0.0) if priority is Priority.STATE else 0.0
        lane = (sender.name, sample.key, priority)
        self.traffic.count_sent(sender.name, sample.key, len(sample.payload))
        copies = self.disturbances.deal(sample)
        for receiver, subscriptions in self.subscriptions.find_receivers(sample.key):
            if self.is_cut(sender, receiver) or (share and self._rng.random() < share):
                continue
            at_ns = max(self.arrival_ns(sender, receiver, priority), receiver.last_arrivals_ns.get(lane, 0))
            receiver.last_arrivals_ns[lane] = at_ns
            deliver = partial(self._deliver_sample, sender, receiver, subscriptions, sample, priority)
            for late_ns in copies:
                self.schedule_call(at_ns + late_ns, deliver)

    def _deliver_sample(
        self,
        sender: "MemoryBus",
        receiver: BusProcess,
        subscriptions: list[Subscription],
        sample: BusSample,
        priority: Priority,
    ) -> None:
        if self.is_cut(sender, receiver):
            return
        if len(sample.payload) > find_most_bytes("sample", sample.key, receiver.max_message_bytes):
            if priority is not Priority.ESTOP and not is_estop_key(sample.key):
                return
            sample = sample._replace(payload=b"")
        self.traffic.count_received(receiver.name, self.clock.now_ns())
        if receiver.hung:
            self.deliver_call(receiver, priority, partial(_call_subscriptions, subscriptions, sample))
        else:
            _call_subscriptions(subscriptions, sample)


def _is_way_blocked(blocked_ways: set[tuple[str | None, str]], sender: BusProcess, receiver: BusProcess) -> bool:
    ways = ((sender.name, receiver.name), (None, receiver.name))
    return sender is not receiver and not blocked_ways.isdisjoint(ways)


def _are_apart(sides: dict[str, int], one: BusProcess, other: BusProcess) -> bool:
    if not sides or one.name not in sides or other.name not in sides:
        return False
    return sides[one.name] != sides[other.name]


def _call_subscriptions(subscriptions: list[Subscription], sample: BusSample) -> None:
    loop = asyncio.get_running_loop()
    for subscription in subscriptions:
        loop.call_soon(subscription.deliver_sample, sample, context=subscription.context)


class MemoryBus(RequestingBus):
    """One process's connection to a `MemoryNet`."""

    def __init__(self, net: MemoryNet, name: str, queue_limit: int, max_message_bytes: int, computer: str = "") -> None:
        super().__init__()
        self.net = net
        self.name = name
        self.computer = computer
        self.server = net.draw_server()
        self.max_message_bytes = max_message_bytes
        self.alive = True
        self.hung = False
        self.hangs = 0
        self.given_up = False
        self.incoming = CallQueue(queue_limit)
        self.outgoing = CallQueue(queue_limit)
        self.last_arrivals_ns: dict[tuple[str, str, Priority], int] = {}
        self._closed = False
        self._asking: dict[int, RequestOutcome] = {}
        self._asked = 0

    def put(self, key: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        self._check_open()
        self.send_call(
            priority, partial(self.net.send_sample, self, BusSample(check_put(key, priority), payload), priority)
        )

    async def subscribe(
        self, expression: str, callback: Callable[[BusSample], None], *, direct: bool = False
    ) -> BusDeclaration:
        self._check_open()
        subscription = Subscription(self.net.subscriptions, self, check_expression(expression), callback)
        self.net.subscriptions.add_subscription(subscription)
        return subscription

    async def serve(self, expression: str, handler: RequestHandler) -> BusDeclaration:
        return self._add_server(expression, answer_expression(expression, handler))

    async def serve_group(self, expression: str, group: ServedGroup) -> BusDeclaration:
        return self._add_server(expression, answer_group(group))

    def _add_server(self, expression: str, find_answers: FindAnswers) -> BusDeclaration:
        self._check_open()
        served_expression = ServedExpression(self.net.requests, self, check_expression(expression), find_answers)
        self.net.requests.add_server(served_expression)
        return served_expression

    async def _collect_replies(self, outcome: RequestOutcome, payload: bytes, timeout_s: float) -> None:
        self._check_open()
        clock = self.net.clock
        timer = clock.call_at_ns(clock.now_ns() + round(timeout_s * NS_PER_S), outcome.end_by_timeout)
        number = self._asked
        self._asked += 1
        self._asking[number] = outcome
        self.send_call(Priority.EVENT, partial(self.net.requests.send_request, self, payload, outcome))
        try:
            await outcome.settled
        finally:
            timer.cancel()
            del self._asking[number]

    async def announce(self, key: str) -> BusDeclaration:
        self._check_open()
        self.net.traffic.count_declared(self.name)
        token = PresenceToken(self.net.presence, self, check_key(key))
        self.net.presence.add_token(token)
        return token

    async def watch(self, expression: str, callback: Callable[[str, bool], None]) -> BusDeclaration:
        self._check_open()
        return self.net.presence.add_watch(self, check_expression(expression), callback)

    async def watch_subscribers(self, expression: str, callback: Callable[[bool], None]) -> BusDeclaration:
        self._check_open()
        return self.net.subscriptions.add_watch(self, check_expression(expression), callback)

    @property
    def backlog(self) -> int:
        return len(self.outgoing)

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        if self.alive:
            self.alive = False
            self.net.leave_net(self)
        self.incoming.discard_calls()
        self.outgoing.discard_calls()
        for outcome in self._asking.values():
            outcome.end_by_error(BusClosed(f"the bus of {self.name!r} was closed during a request for {outcome.key}"))

    def send_call(self, priority: Priority, call: Callable[[], None]) -> None:
        """Send something from this process: now, or when the process runs again."""
        if self.hung:
            self.outgoing.add_call(priority, call)
        elif self.alive:
            call()

    def _check_open(self) -> None:
        if self._closed:
            raise BusClosed(f"the bus of {self.name!r} is closed")
