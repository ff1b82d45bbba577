"""The record of a whole fleet: e-stop, reset, state and queue. It knows no protocol."""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress

from integrations.epics.fields import Field
from integrations.epics.lanes import describe
from integrations.epics.values import Done, Published
from tutti import ControllerState, Refusal, TaskOwner, Tutti, TuttiError, read_job, running

FLEET_FIELDS = {"ESTOP": Field("int", can_put=True), "RESET": Field("int", can_put=True), "STATE": Field("text")}
QUEUE_COLUMNS = ("id", "name", "state", "by")
REFRESH_S = 0.5
RELEASE_S = 2.0
MOST_JOBS = 100
_ENDED = ("done", "failed", "cancelled", "aborted", "interrupted")

Rows = list[tuple[str, ...]]


class FleetRecord(Published):
    """ESTOP and RESET act when 1 is put; ESTOP is 1 while an e-stop is latched. STATE is `e-stop`, `offline`, `fault`,
    `moving` or `idle`. queue: by `QUEUE_COLUMNS`, the jobs that have not ended, the newest first."""

    def __init__(self, tutti: Tutti) -> None:
        super().__init__({"ESTOP": 0, "RESET": 0, "STATE": "idle"})
        self.queue: Rows = []
        self.on_queue: list[Callable[[Rows], None]] = []
        self._tutti = tutti
        self._tasks = TaskOwner()

    def put(self, name: str, raw: object, done: Done) -> None:
        """Put a value, as `MotorRecord.put` does."""
        try:
            value = FLEET_FIELDS[name].convert(name, raw)
        except Refusal as error:
            done(describe(error))
            return
        if not value:
            done(None)
            return
        self._tasks.spawn(self._run(self._estop if name == "ESTOP" else self._reset, done))

    async def submit(self, text: str) -> str:
        """Submit the job in the text of a job file, and return its id. Raises `Refusal`, `FileError`."""
        return str(await self._tutti.submit(read_job(text)))

    async def refresh(self) -> None:
        """Read states and queue. Raises `Refusal`."""
        states = await self._tutti.status()
        self._set("ESTOP", int(_is_latched(states)))
        self._set("STATE", _describe_fleet(states))
        jobs = [entry for entry in await self._tutti.list_jobs(MOST_JOBS) if entry.state not in _ENDED]
        queue: Rows = [(entry.id, entry.name, entry.state, entry.actor) for entry in jobs]
        if queue != self.queue:
            self.queue = queue
            for listener in self.on_queue:
                listener(queue)

    async def _run(self, act: Callable[[], Awaitable[str | None]], done: Done) -> None:
        try:
            error = await act()
            await self.refresh()
        except TuttiError as failure:
            error = describe(failure)
        done(error)

    async def _estop(self) -> str | None:
        latches = await self._tutti.estop("by a client of EPICS")
        names = ", ".join(name for name, is_latched in latches.items() if not is_latched) or "any controller"
        return None if latches and all(latches.values()) else f"no e-stop is confirmed by {names}; use the wired one"

    async def _reset(self) -> str | None:
        refusals = [describe(refusal) for refusal in (await self._tutti.reset()).values() if refusal is not None]
        with suppress(TimeoutError):
            async with asyncio.timeout(RELEASE_S):
                while not refusals and _is_latched(await self._tutti.status()):
                    await asyncio.sleep(REFRESH_S / 10)
        return ", ".join(refusals) or None


def _is_latched(states: Mapping[str, ControllerState]) -> bool:
    return any(state.estop is not None for state in states.values())


def _describe_fleet(states: Mapping[str, ControllerState]) -> str:
    modes = {state.mode for state in states.values()}
    if _is_latched(states):
        return "e-stop"
    for mode in ("offline", "fault"):
        if mode in modes:
            return mode
    return "moving" if modes - {"idle"} else "idle"


@asynccontextmanager
async def open_fleet_record(tutti: Tutti) -> AsyncGenerator[FleetRecord]:
    """The record of the fleet, which is kept up to date while the context lasts."""
    record = FleetRecord(tutti)

    async def follow() -> None:
        while True:
            with suppress(TuttiError):  # the coordinator is away: what is known stays
                await record.refresh()
            await asyncio.sleep(REFRESH_S)

    async with running(follow()):
        yield record
