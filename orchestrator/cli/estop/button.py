"""A button for the e-stop that keeps its session open, so that a press waits for no connection and no module.

It says whether it is connected: adapters publish states several times a second. A press is repeated until every
controller that was seen reports the latch; one that finds no connection is sent as soon as there is one.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from orchestrator.bus.base import Bus, BusSample
from orchestrator.bus.estop import put_estop
from orchestrator.bus.keys import ANY_HOST_STATES, ANY_OLD_CONTROLLER, FleetKeys
from orchestrator.bus.states.frame import BadFrame, decode_frame
from orchestrator.clock.owner import TaskOwner, running

SILENCE_S = 1.5  # hosts publish at least every 0.4 s
POLL_S = 0.1
REMIND_S = 5.0  # how often it is said that there is no connection
CONFIRM_S = 10.0  # for the controllers to report the latch, before the e-stop counts as not confirmed

Report = Callable[[str, str], None]
"""Shows a line: its kind, for programs, and its text."""

FindLatched = Callable[[Bus], Awaitable[dict[str, bool]]]
"""Returns which controllers report an e-stop latch, by `fleet/controller`; waits a little for it."""

WIRED = "use the wired e-stop"


class EstopButton:
    """The button. fleet: None stops every fleet. new_event: makes the unique name of an e-stop."""

    def __init__(
        self,
        fleet: str | None,
        reason: str,
        new_event: Callable[[], tuple[str, str]],
        find_latched: FindLatched,
        report: Report,
    ) -> None:
        self._fleet = fleet
        self._reason = reason
        self._new_event = new_event
        self._find_latched = find_latched
        self._report = report
        self._bus: Bus | None = None
        self._seen: dict[str, float] = {}
        self._old = set[str]()
        self._tasks = TaskOwner()
        self._connected: bool | None = None
        self._reminded_s = 0.0
        self._pending: tuple[str, str] | None = None
        self._pressed = asyncio.Event()

    @property
    def is_connected(self) -> bool:
        """Whether states of controllers arrive now."""
        now_s = asyncio.get_running_loop().time()
        return any(now_s - seen_s <= SILENCE_S for seen_s in self._seen.values())

    def press(self) -> None:
        """Send the e-stop now, and repeat it until it is confirmed. A press meanwhile repeats the same one."""
        self._pending = self._pending or self._new_event()
        self._put_pending()
        if self.is_connected:
            self._report("sent", "E-STOP SENT")
        else:
            self._report("not-sent", f"E-STOP NOT SENT: no connection; {WIRED}. It is sent as soon as there is one")
        self._pressed.set()

    async def run(self, connect: Callable[[], Awaitable[Bus]]) -> None:
        """Keep the button connected until cancelled. connect: opens the bus, however long that takes."""
        async with running(self._watch_connection()):
            self._bus = await connect()
            keys = None if self._fleet is None else FleetKeys(self._fleet)
            await self._bus.subscribe(ANY_HOST_STATES if keys is None else keys.host_states(), self._receive_frame)
            await self._bus.watch(ANY_OLD_CONTROLLER if keys is None else keys.live("controller"), self._note_old)
            while True:
                await self._pressed.wait()
                self._pressed.clear()
                await self._repeat_pending(self._bus)

    def _receive_frame(self, sample: BusSample) -> None:
        """Take note of the controllers of a host. Their own keys are not subscribed to: then every host would publish
        each controller singly, for as long as the button is armed."""
        with suppress(BadFrame):
            fleet, now_s = sample.key.split("/")[2], asyncio.get_running_loop().time()
            for controller in decode_frame(sample.payload).confirmations:
                self._seen[f"{fleet}/{controller}"] = now_s

    def _note_old(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback
        """A controller of a host without frames."""
        fleet, controller = key.split("/")[2], key.split("/")[5]
        if present and self._bus is not None and (name := f"{fleet}/{controller}") not in self._old:
            self._old.add(name)
            self._tasks.spawn(self._follow_old(self._bus, FleetKeys(fleet).state(controller)))

    async def _follow_old(self, bus: Bus, state_key: str) -> None:
        await bus.subscribe(state_key, self._receive_state)

    def _receive_state(self, sample: BusSample) -> None:
        chunks = sample.key.split("/")
        self._seen[f"{chunks[2]}/{chunks[4]}"] = asyncio.get_running_loop().time()

    async def _watch_connection(self) -> None:
        while True:
            now_s, is_connected = asyncio.get_running_loop().time(), self.is_connected
            if is_connected and not self._connected:
                await asyncio.sleep(SILENCE_S)  # for the other controllers, so that all are named
                self._report("armed", f"armed: connected to {', '.join(sorted(self._seen))}")
            elif not is_connected and (self._connected is not False or now_s - self._reminded_s >= REMIND_S):
                self._reminded_s = now_s
                self._report("not-connected", f"NOT CONNECTED: a press stops nothing now; {WIRED}")
            self._connected = is_connected
            await asyncio.sleep(POLL_S)

    def _put_pending(self) -> None:
        if self._bus is not None and self._pending is not None:
            event, actor = self._pending
            put_estop(self._bus, self._fleet, event, actor, self._reason)

    async def _repeat_pending(self, bus: Bus) -> None:
        """Repeat the e-stop until it is confirmed, or was not within the time that it has for that."""
        left_s = CONFIRM_S
        while self._pending is not None:
            began_s, missing_names = asyncio.get_running_loop().time(), sorted(self._seen)
            if self.is_connected:
                self._put_pending()
                latches = await self._find_latched(bus)
                missing_names = [name for name in sorted(self._seen) if not latches.get(name)]
                if not missing_names:
                    self._pending = None
                    self._report("latched", f"E-STOP LATCHED: {', '.join(sorted(latches))}; `tutti reset` releases it")
                    return
            await asyncio.sleep(POLL_S)
            if self.is_connected:
                left_s -= asyncio.get_running_loop().time() - began_s
            if left_s <= 0:
                self._pending = None
                self._report("not-latched", f"E-STOP NOT CONFIRMED by {', '.join(missing_names)}; {WIRED}")
