"""The watch on the router: fresh sessions, because a router can serve the old ones and no new one.

Such a router accepts connections and never answers (`eclipse-zenoh/zenoh#2735`, `#2780`). A fleet that runs notices
nothing, until a process restarts or a person wants to stop it from a shell. So a session is opened every ten seconds. A
router that does not answer three times in turn is an alarm, and is restarted: at once if nothing moves, otherwise when
the fleet rests, because a restart takes all sessions from all processes.

A router can also serve no session at all. Then the last states that arrived may say that an axis moves, and no other
ever comes. Such a state counts for as long as a motion can last without the router: the adapters miss the coordinator,
and brake.
"""

from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field

from pydantic import ValidationError

from adapters.host.leader_watch import COORDINATOR_LOST_NS
from orchestrator.bus.base import Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.states.feed import Arrival, ControllerFeed
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.probe import probe_router
from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.clock.live import LiveClock
from orchestrator.coordinator.fleet.view import OTHER_NS, SILENT_NS
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.alarms import AlarmRequest
from orchestrator.model.state import RESTING_MODES, ControllerState

PROBE_NS = 10 * NS_PER_S
AGAIN_NS = NS_PER_S  # after a failure
FAILURES = 3
REST_NS = NS_PER_S  # between two looks at whether the fleet rests
REPEAT_NS = 60 * NS_PER_S  # an alarm that is not repeated for two minutes is over
ROLE, ID = "coordinator", "router-watch"  # of the alarm: `tutti up` has the identity of its coordinator


def find_longest_stop_ns(fleet: Fleet) -> int:
    """For how long an axis can move when nothing reaches its adapter any more, until that has published its rest: the
    watchdog of the coordinator, the longest ramp of an axis, and the longest silence of an adapter that works."""
    limits = [axis.limits for config in fleet.controllers.values() for axis in config.axes.values()]
    ramps_s = (
        limit.velocity / limit.acceleration + (limit.acceleration / limit.jerk if limit.jerk else 0.0)
        for limit in limits
    )
    neighbours = len(fleet.controllers) - 1
    return COORDINATOR_LOST_NS + round(max(ramps_s) * NS_PER_S) + SILENT_NS + OTHER_NS * neighbours


@dataclass(slots=True)
class FleetRest:
    """Whether a fleet rests, by the last state of each controller.

    counts_ns: for how long a state in motion is what is known: see `find_longest_stop_ns`.
    """

    clock: Clock
    counts_ns: int
    _busy_ns: dict[str, int] = field(default_factory=dict[str, int])

    def take_arrival(self, arrival: Arrival) -> None:
        """Take what a host has published; what cannot be read changes nothing."""
        for sample in arrival.samples:
            if sample.key.endswith("/state"):
                with suppress(ValidationError):
                    self._take_state(ControllerState.read_message(sample.payload))

    def take_bad_frame(self, text: str) -> None:
        """The next frame says what this one would have said."""

    def _take_state(self, state: ControllerState) -> None:
        if state.mode in RESTING_MODES:
            self._busy_ns.pop(state.controller, None)
        else:
            self._busy_ns[state.controller] = self.clock.now_ns()

    def list_moving(self) -> list[str]:
        """The controllers that move, or are about to."""
        oldest_ns = self.clock.now_ns() - self.counts_ns
        self._busy_ns = {name: at_ns for name, at_ns in self._busy_ns.items() if at_ns >= oldest_ns}
        return sorted(self._busy_ns)


@dataclass(slots=True)
class RouterWatch:
    """Watches the router at `endpoint`.

    probe: opens a session and closes it; returns why that failed, "" if it did not. list_moving: the controllers that
    move, or may, as far as sessions from before show. raise_alarm: publishes an alarm on such a session. restart: None
    for a router of others, which is an alarm only. say: for people.
    """

    endpoint: str
    clock: Clock
    probe: Callable[[], Awaitable[str]]
    list_moving: Callable[[], list[str]]
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
        said_names: list[str] = []
        while names := self.list_moving():
            if names != said_names:
                self.say(f"the router is restarted when the fleet rests; not at rest: {', '.join(names)}")
            said_names = names
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
    endpoint: str, fleet: Fleet, restart: Callable[[], Awaitable[None]] | None, say: Callable[[str], None]
) -> None:
    """Watch the router of a fleet that runs, until cancelled. Raises `RouterUnreachable` if it does not answer now."""
    clock = LiveClock()
    keys, fleet_rest = FleetKeys(fleet.fleet), FleetRest(clock, find_longest_stop_ns(fleet))
    bus = await open_bus(endpoint)

    async def probe() -> str:
        return await probe_router(endpoint)

    def raise_alarm(request: AlarmRequest) -> None:
        bus.put(keys.alarm_request(ROLE, ID), request.to_json(), Priority.EVENT)

    try:
        await ControllerFeed(bus, keys, clock.now_ns, fleet_rest).start()
        await RouterWatch(
            endpoint=endpoint,
            clock=clock,
            probe=probe,
            list_moving=fleet_rest.list_moving,
            raise_alarm=raise_alarm,
            restart=restart,
            say=say,
        ).run()
    finally:
        await bus.close()
