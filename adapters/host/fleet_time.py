"""Fleet time on one computer: exact beside the coordinator, elsewhere asked for again and again."""

from collections.abc import Callable, Coroutine
from typing import Any

from pydantic import ValidationError

from adapters.host.leader_watch import LeaderWatch
from orchestrator.bus.base import Bus, BusError, find_only_server
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.estimator import CounterSample
from orchestrator.clock.fleet import LEAST_EXCHANGES, FleetScale, FleetTimeEstimator, exact_scale
from orchestrator.model.errors import TuttiError
from orchestrator.model.messages import LeaderHeartbeat, TimeReply

EXCHANGE_NS = NS_PER_S
"""From one request for fleet time to the next: crystals wander by less than a microsecond in that time."""
FIRST_EXCHANGE_NS = 10 * NS_PER_MS
RETRY_NS = 100 * NS_PER_MS
TIME_ANSWER_S = 1.0


class OtherScale(TuttiError):
    """The answer is of another fleet time than that which is followed."""


class FleetTime:
    """The fleet time of the coordinator that was followed last.

    leaders: what is known of the pace of its heartbeats; void when a clock has jumped. spawn: runs a coroutine in the
    background. jumped: called when the clock of this computer or of the coordinator's has jumped: whatever is timed by
    the scale before must stop.
    """

    def __init__(
        self,
        bus: Bus,
        keys: FleetKeys,
        leaders: LeaderWatch,
        spawn: Callable[[Coroutine[Any, Any, None]], None],
        jumped: Callable[[], None],
    ) -> None:
        self._bus = bus
        self._keys = keys
        self._clock = leaders.clock
        self._leaders = leaders
        self._spawn = spawn
        self._jumped = jumped
        self._leader: LeaderHeartbeat | None = None
        self._server = ""
        self.scale: FleetScale | None = None
        """None while it is not known."""

    def follow(self, leader: LeaderHeartbeat) -> None:
        """Use the fleet time of this coordinator. A successor on the same computer continues that of the one before."""
        known_leader, self._leader = self._leader, leader
        if known_leader is not None and known_leader.scale_id == leader.scale_id:
            return
        self._server = ""
        self.scale = exact_scale(leader, self._clock)
        if self.scale is None:
            self._spawn(self._exchange_times(leader.scale_id))

    async def _exchange_times(self, scale_id: str) -> None:
        """Ask a coordinator on another computer, until another scale is followed."""
        estimator, count = FleetTimeEstimator(scale_id), 0
        while (leader := self._leader) is not None and leader.scale_id == scale_id:
            try:
                exchange = await self._exchange_time(leader)
                if self._leader.scale_id != scale_id:
                    return
                count += 1
                if not estimator.add_exchange(exchange):
                    count = 1
                    self.scale = None
                    self._jumped()
                    self._leaders.restart_pace(await self._ask_heartbeat(leader))
            except (BusError, ValidationError, OtherScale):
                self._server = ""
                await sleep_ns(self._clock, RETRY_NS)
                continue
            if (scale := estimator.estimate_scale()) is not None:
                self.scale = scale
            await sleep_ns(self._clock, EXCHANGE_NS if count >= LEAST_EXCHANGES else FIRST_EXCHANGE_NS)

    async def _exchange_time(self, leader: LeaderHeartbeat) -> CounterSample:
        """One request. Raises `BusError`, `ValidationError`, `OtherScale`."""
        if not self._server:
            leads = self._keys.leader_answer(leader.coordinator)
            self._server = await find_only_server(self._bus, leads, TIME_ANSWER_S)
        sent_ns = self._clock.now_ns()
        reply = await self._bus.request(self._keys.time, b"", TIME_ANSWER_S, self._server)
        received_ns = self._clock.now_ns()
        answer = TimeReply.read_message(reply)
        if answer.scale_id != leader.scale_id:
            raise OtherScale(f"{answer.scale_id} instead of {leader.scale_id}")
        return CounterSample(sent_ns, received_ns, answer.fleet_ns)

    async def _ask_heartbeat(self, leader: LeaderHeartbeat) -> LeaderHeartbeat:
        """The heartbeat of the coordinator as its own answer. Raises `BusError`, `ValidationError`."""
        leads = self._keys.leader_answer(leader.coordinator)
        return LeaderHeartbeat.read_message(await self._bus.request(leads, b"", TIME_ANSWER_S, self._server))
