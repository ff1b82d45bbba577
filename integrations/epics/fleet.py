"""The record of a whole fleet: e-stop, reset, state and queue. It knows no protocol."""

from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager

from integrations.epics.fields import Field
from integrations.epics.values import Done, Published
from integrations.whole_fleet import describe, describe_fleet, estop_fleet, is_latched, refreshing, reset_fleet
from tutti import FINISHED_STATES, Refusal, TaskOwner, Tutti, TuttiError, read_job

FLEET_FIELDS = {"ESTOP": Field("int", can_put=True), "RESET": Field("int", can_put=True), "STATE": Field("text")}
QUEUE_COLUMNS = ("id", "name", "state", "by")
REFRESH_S = 0.5
MOST_JOBS = 100

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
        self._set("ESTOP", int(is_latched(states)))
        self._set("STATE", describe_fleet(states))
        jobs = [entry for entry in await self._tutti.list_jobs(MOST_JOBS) if entry.state not in FINISHED_STATES]
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
        return await estop_fleet(self._tutti, "by a client of EPICS") or None

    async def _reset(self) -> str | None:
        return ", ".join(map(describe, await reset_fleet(self._tutti))) or None


@asynccontextmanager
async def open_fleet_record(tutti: Tutti) -> AsyncGenerator[FleetRecord]:
    """The record of the fleet, which is kept up to date while the context lasts."""
    record = FleetRecord(tutti)
    async with refreshing(record.refresh, REFRESH_S):
        yield record
