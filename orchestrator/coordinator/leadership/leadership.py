"""Leadership of a fleet: epoch, fleet time and heartbeat of the leader, and the detection of its loss."""

import asyncio
from collections.abc import Callable

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusDeclaration, BusError, BusSample, Priority, RequestRefused
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.fleet import FleetScale
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.leadership.environment import CoordinatorEnvironment, JournalServer
from orchestrator.coordinator.leadership.lease import LeaseKeeper, LeaseTerms
from orchestrator.model.errors import TuttiError
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import HEARTBEAT_NS, LeaderHeartbeat, TimeReply
from orchestrator.model.state import ControllerState
from orchestrator.model.version import PROTOCOL, find_own_version

LEADER_TIMEOUT_NS = 600 * NS_PER_MS  # a live leader is received within this time
ANSWER_S = 0.3  # for a coordinator to answer that it leads
ASK_AGAIN_NS = 1000 * NS_PER_MS  # after an answer, or none


class AnotherLeader(TuttiError):
    """Another coordinator leads this fleet. The text names it, and what to do."""


async def confirm_leader(bus: Bus, keys: FleetKeys, heartbeat: LeaderHeartbeat) -> bool:
    """Ask the coordinator of a heartbeat whether it leads in that epoch. A heartbeat alone is no proof: anything can
    put one on the bus."""
    try:
        answer = await bus.request(keys.leader_answer(heartbeat.coordinator), b"", ANSWER_S)
        message = LeaderHeartbeat.read_message(answer)
    except (BusError, ValueError):
        return False
    return (message.coordinator, message.epoch) == (heartbeat.coordinator, heartbeat.epoch)


class Leadership:
    """Acquires the leadership and keeps it.

    on_lost: called once, when a coordinator with a newer epoch has answered that it leads, or the lease in the journal
    has ended. on_contradicted: called with
    the heartbeat of a coordinator that does not answer.
    """

    def __init__(self, fleet: Fleet, environment: CoordinatorEnvironment, tasks: TaskOwner) -> None:
        self._tasks = tasks
        self._fleet = fleet.fleet
        self._bus = environment.bus
        self._keys = environment.keys
        self._clock = environment.clock
        self._journal = environment.journal
        self._execute = environment.execute
        self._lease = self._make_lease(fleet, environment.journal_server)
        self.coordinator = environment.new_id()
        self.epoch = 0
        self.scale = FleetScale("", 0)
        self.over = False
        self.on_lost: Callable[[str], None] = lambda _: None
        self.on_contradicted: Callable[[LeaderHeartbeat], None] = lambda _: None
        self.kept_estop: Callable[[], str] = lambda: ""
        """Returns the event of the e-stop that this process keeps; empty: none."""
        self._asking: asyncio.Task[None] | None = None
        self._ask_again_ns = 0
        self._last_heartbeat: LeaderHeartbeat | None = None
        self._seq = 0
        self._declared: list[BusDeclaration] = []
        self._beat: asyncio.Task[None] | None = None

    async def acquire(self, *, take_over: bool, vacant: bool = False) -> None:
        """Become the leader. Raises `AnotherLeader` if another coordinator leads, unless `take_over`. vacant: it is
        known already that there is no leader."""
        self._declared.append(await self._bus.subscribe(self._keys.leader, self._receive_heartbeat))
        if not vacant:
            await sleep_ns(self._clock, LEADER_TIMEOUT_NS)
        heartbeat = self._last_heartbeat
        if heartbeat is not None and not await confirm_leader(self._bus, self._keys, heartbeat):
            self.on_contradicted(heartbeat)
            heartbeat = None
        if heartbeat is not None and not take_over:
            await self.close()
            raise AnotherLeader(
                f"coordinator {heartbeat.coordinator[:8]} leads fleet {self._fleet} (epoch {heartbeat.epoch}); "
                "stop it first, or start with --take-over"
            )
        if self._lease is not None and not take_over and not vacant:
            await self._lease.wait_for_end()
        highest_epoch = 0 if heartbeat is None else heartbeat.epoch
        for payload in (await self._bus.request_all(self._keys.state(), b"", timeout_s=1.0)).values():
            try:
                highest_epoch = max(highest_epoch, ControllerState.read_message(payload).epoch)
            except ValidationError:
                continue
        if self._lease is not None:
            await self._lease.connect()
        self.epoch = await self._execute(self._journal.take_epoch, highest_epoch)
        if self._lease is not None:
            await self._lease.start()
        now_ns = self._clock.now_ns()
        scale_id = f"{self.epoch}-{self.coordinator[:8]}"
        scale_id, origin_ns = await self._execute(
            self._journal.fleet_time_scale, self._clock.kernel_id, now_ns, scale_id
        )
        self.scale = FleetScale(scale_id, origin_ns)
        self._declared.append(await self._bus.serve(self._keys.time, self._reply_fleet_time))
        answer = self._keys.leader_answer(self.coordinator)
        self._declared.append(await self._bus.serve(answer, self._reply_leads))
        self._beat = self._tasks.spawn(self._send_heartbeats(), vital=True)

    async def close(self) -> None:
        """Resign: send no more heartbeats, and give the lease back."""
        for task in (self._beat, self._asking):
            if task is not None:
                task.cancel()
        for declaration in self._declared:
            await declaration.undeclare()
        self._declared.clear()
        if self._lease is not None:
            await self._lease.close()

    def _make_lease(self, fleet: Fleet, server: JournalServer | None) -> LeaseKeeper | None:
        if server is None:
            return None
        terms = LeaseTerms(server.lease, server.run_lease, fleet.journal.lease)
        return LeaseKeeper(terms, self._clock, lambda: self.epoch, self._lose)

    def _lose(self, reason: str) -> None:
        if not self.over:
            self.over = True
            self.on_lost(reason)

    def fleet_now_ns(self) -> int:
        return self.scale.to_fleet_ns(self._clock.now_ns())

    def make_heartbeat(self) -> LeaderHeartbeat:
        """The heartbeat as of now."""
        return LeaderHeartbeat(
            fleet=self._fleet,
            epoch=self.epoch,
            coordinator=self.coordinator,
            seq=self._seq,
            scale_id=self.scale.scale_id,
            kernel_id=self._clock.kernel_id,
            origin_host_ns=self.scale.origin_host_ns,
            utc=self._clock.utc(),
            estop=self.kept_estop(),
            tutti=find_own_version(),
            protocol=str(PROTOCOL),
        )

    async def _send_heartbeats(self) -> None:
        while not self.over and (self._lease is None or self._lease.holds):
            self._seq += 1
            self._bus.put(self._keys.leader, self.make_heartbeat().to_json(), Priority.EVENT)
            await sleep_ns(self._clock, HEARTBEAT_NS)

    def _receive_heartbeat(self, sample: BusSample) -> None:
        try:
            heartbeat = LeaderHeartbeat.read_message(sample.payload)
        except ValidationError:
            return
        if heartbeat.coordinator == self.coordinator:
            return
        self._last_heartbeat = heartbeat
        contradicts = self.epoch and not self.over and heartbeat.epoch >= self.epoch
        if contradicts and self._asking is None and self._clock.now_ns() >= self._ask_again_ns:
            self._asking = self._tasks.spawn(self._ask_other(heartbeat), vital=False)

    async def _ask_other(self, heartbeat: LeaderHeartbeat) -> None:
        """Step down for a coordinator that answers, and for no other."""
        try:
            leads = await confirm_leader(self._bus, self._keys, heartbeat)
        finally:
            self._asking = None
            self._ask_again_ns = self._clock.now_ns() + ASK_AGAIN_NS
        if not leads:
            self.on_contradicted(heartbeat)
        else:
            self._lose(
                f"coordinator {heartbeat.coordinator[:8]} leads with epoch {heartbeat.epoch}; "
                f"this one had epoch {self.epoch}"
            )

    async def _reply_leads(self, _: BusSample) -> bytes:
        if self.over or not self.epoch:
            raise RequestRefused("this coordinator does not lead")
        return self.make_heartbeat().to_json()

    async def _reply_fleet_time(self, _: BusSample) -> bytes:
        return TimeReply(scale_id=self.scale.scale_id, fleet_ns=self.fleet_now_ns()).to_json()
