"""The watch on the router: fresh sessions, because a router can serve the old ones and no new one.

Such a router accepts connections and never answers (`eclipse-zenoh/zenoh#2735`, `#2780`). A fleet that runs notices
nothing, until a process restarts or a person wants to stop it from a shell. So a session is opened every ten seconds. A
router that does not answer three times in turn is an alarm, and is restarted: at once if nothing moves, otherwise when
the fleet rests, because a restart takes all sessions from all processes.
"""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from pydantic import ValidationError

from orchestrator.bus.base import BusSample, Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.probe import probe_router
from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.clock.live import LiveClock
from orchestrator.model.operation.alarms import AlarmRequest
from orchestrator.model.state import RESTING_MODES, ControllerState

PROBE_NS = 10 * NS_PER_S
AGAIN_NS = NS_PER_S  # after a failure
FAILURES = 3
REST_NS = NS_PER_S  # between two looks at whether the fleet rests
REPEAT_NS = 60 * NS_PER_S  # an alarm that is not repeated for two minutes is over
ROLE, ID = "coordinator", "router-watch"  # of the alarm: `tutti up` has the identity of its coordinator


@dataclass(slots=True)
class FleetRest:
    """Whether a fleet rests, by the last state of each controller."""

    _busy: set[str] = field(default_factory=set[str])

    def receive_state(self, sample: BusSample) -> None:
        """Take a state; one that cannot be read changes nothing."""
        try:
            state = ControllerState.read_message(sample.payload)
        except ValidationError:
            return
        (self._busy.discard if state.mode in RESTING_MODES else self._busy.add)(state.controller)

    def is_moving(self) -> bool:
        """Whether a controller moves, or is about to."""
        return bool(self._busy)


@dataclass(slots=True)
class RouterWatch:
    """Watches the router at `endpoint`.

    probe: opens a session and closes it; returns why that failed, "" if it did not. is_moving: whether an axis moves,
    or may, as far as sessions from before show. raise_alarm: publishes an alarm on such a session. restart: None for a
    router of others, which is an alarm only. say: for people.
    """

    endpoint: str
    clock: Clock
    probe: Callable[[], Awaitable[str]]
    is_moving: Callable[[], bool]
    raise_alarm: Callable[[AlarmRequest], None]
    restart: Callable[[], Awaitable[None]] | None
    say: Callable[[str], None]
    _raised_ns: int | None = None

    async def run(self) -> None:
        """Watch until cancelled."""
        failures = 0
        while True:
            reason = await self.probe()
            failures = failures + 1 if reason else 0
            if failures >= FAILURES:
                await self._handle_deaf_router(reason)
            elif not failures and self._raised_ns is not None:
                self._report(active=False)
            await sleep_ns(self.clock, AGAIN_NS if 0 < failures < FAILURES else PROBE_NS)

    async def _handle_deaf_router(self, reason: str) -> None:
        if self._raised_ns is None:
            self.say(f"the router at {self.endpoint} serves no new session: {reason}")
        self._report(active=True)
        if self.restart is None:
            return
        if self.is_moving():
            self.say("the router is restarted when the fleet rests")
        while self.is_moving():
            self._report(active=True)
            await sleep_ns(self.clock, REST_NS)
        self.say(f"restarting the router at {self.endpoint}")
        await self.restart()

    def _report(self, *, active: bool) -> None:
        """Publish the alarm, often enough to keep it; or its end."""
        now_ns = self.clock.now_ns()
        if active and self._raised_ns is not None and now_ns - self._raised_ns < REPEAT_NS:
            return
        self._raised_ns = now_ns if active else None
        remedy = (
            "it is restarted when the fleet rests"
            if self.restart is not None
            else "restart it when the fleet rests; until then nothing can connect"
        )
        self.raise_alarm(
            AlarmRequest(
                kind="router",
                subject=self.endpoint,
                text=f"the router at {self.endpoint} serves no new session",
                action=remedy,
                priority="high",
                active=active,
            )
        )


async def watch_live_router(
    endpoint: str, fleet: str, restart: Callable[[], Awaitable[None]] | None, say: Callable[[str], None]
) -> None:
    """Watch the router of a fleet that runs, until cancelled. Raises `RouterUnreachable` if it does not answer now."""
    keys, fleet_rest = FleetKeys(fleet), FleetRest()
    bus = await open_bus(endpoint)

    async def probe() -> str:
        return await probe_router(endpoint)

    def raise_alarm(request: AlarmRequest) -> None:
        bus.put(keys.alarm_request(ROLE, ID), request.to_json(), Priority.EVENT)

    try:
        await bus.subscribe(keys.state(), fleet_rest.receive_state)
        await RouterWatch(
            endpoint=endpoint,
            clock=LiveClock(),
            probe=probe,
            is_moving=fleet_rest.is_moving,
            raise_alarm=raise_alarm,
            restart=restart,
            say=say,
        ).run()
    finally:
        await bus.close()
