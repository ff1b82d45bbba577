"""The moves of the axes of a connection, in live jobs: one entry in the journal, however many moves there are.

Plans move several axes by several calls at the same moment (`bps.mv(x, 1, y, 2)`, the points of a grid). What is asked
for within `GATHER_S` is one synchronised move. A live job holds the controllers of the axes that it moves: of staged
axes until they are unstaged, else until nothing was asked for during `IDLE_S`.
"""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

from tutti import JobFailed, LiveJob, Refusal, StepReport, TaskOwner, Tutti, TuttiError, controller_of

GATHER_S = 0.005
"""Between the first call of a plan stub and the last one are some 0.3 ms an axis."""

IDLE_S = 1.0
"""Others may have the axes this long after the last move of axes that are not staged."""


class StoppedWith(TuttiError):
    """A move that was stopped because another axis of it was."""


@dataclass(eq=False, slots=True)
class _Session:
    """A live job. users: moves and flights that are under way in it."""

    live: LiveJob
    controllers: frozenset[str]
    users: int = 0
    timer: asyncio.TimerHandle | None = None

    @property
    def is_open(self) -> bool:
        return self.live.result is None


@dataclass(eq=False, slots=True)
class _Batch:
    """Moves that are asked for together. targets, speeds: by axis; stopped_by: the axis that was stopped."""

    task: "asyncio.Task[StepReport]"
    targets: dict[str, float] = field(default_factory=dict[str, float])
    speeds: dict[str, str] = field(default_factory=dict[str, str])
    stopped_by: str = ""


class FleetMoves:
    """Moves axes of one fleet. open_fleet: the connected client. name: of the live jobs."""

    def __init__(self, open_fleet: Callable[[], Awaitable[Tutti]], name: str) -> None:
        self._open_fleet = open_fleet
        self._name = name
        self._sessions: list[_Session] = []
        self._staged: dict[str, int] = {}
        self._gathering: _Batch | None = None
        self._turn = asyncio.Lock()
        self._freed = asyncio.Condition()
        self._endings = TaskOwner()

    # Staging

    def stage(self, axis: str) -> None:
        """A plan begins to use an axis: its live job lasts until the axis is unstaged."""
        self._staged[axis] = self._staged.get(axis, 0) + 1

    async def unstage(self, axis: str) -> None:
        """A plan has ended with an axis; the live job of axes that no plan uses any more ends at once."""
        self._staged[axis] = max(0, self._staged.get(axis, 0) - 1)
        for session in list(self._sessions):
            if session.users == 0 and not self._is_staged(session):
                await self._end(session)

    def _is_staged(self, session: _Session) -> bool:
        return any(count and controller_of(axis) in session.controllers for axis, count in self._staged.items())

    # Moves

    async def move(self, axis: str, target: float, speed: str) -> StepReport:
        """Move an axis, together with others that are moved now, and return the report of the step when it is done. A
        cancelled task stops them. Raises `Refusal`, `StepFailed`, `JobFailed`, and `StoppedWith` if another axis of the
        same move was stopped."""
        batch = self._gathering
        if batch is None or axis in batch.targets:
            batch = self._begin_batch()
        batch.targets[axis], batch.speeds[axis] = target, speed
        try:
            return await asyncio.shield(batch.task)
        except asyncio.CancelledError:
            if batch.stopped_by:
                text = f"{axis} was moved together with {batch.stopped_by}, which was stopped"
                raise StoppedWith(text) from None
            batch.stopped_by = axis
            batch.task.cancel()
            raise

    def _begin_batch(self) -> _Batch:
        async def run() -> StepReport:
            await asyncio.sleep(GATHER_S)
            if self._gathering is batch:
                self._gathering = None
            return await self._run_batch(batch)

        self._gathering = batch = _Batch(asyncio.get_running_loop().create_task(run()))
        # Each caller has what it raises, or has gone.
        batch.task.add_done_callback(lambda task: task.cancelled() or task.exception())
        return batch

    async def _run_batch(self, batch: _Batch) -> StepReport:
        async with self.use_live(batch.targets) as live:
            return await live.move(dict(batch.targets), speed=dict(batch.speeds))

    # Live jobs

    @asynccontextmanager
    async def use_live(self, axes: Iterable[str]) -> AsyncGenerator[LiveJob]:
        """The live job that holds the controllers of axes, begun if there is none, and kept while the context lasts.
        Raises `Refusal` and `JobFailed` when entered."""
        session = await self._take_session({controller_of(axis) for axis in axes})
        try:
            yield session.live
        finally:
            await self._give_back(session)

    async def release(self, axes: Iterable[str]) -> None:
        """End the live jobs that hold the controllers of axes, once nothing moves in them: for a job of its own."""
        controllers = {controller_of(axis) for axis in axes}
        async with self._turn:
            await self._end_overlapping(controllers)

    async def close(self) -> None:
        """Stop what moves, and end all live jobs."""
        if self._gathering is not None:
            self._gathering.task.cancel()
        for session in list(self._sessions):
            self._forget(session)
            await session.live.cancel()

    async def _take_session(self, controllers: set[str]) -> _Session:
        async with self._turn:
            for session in list(self._sessions):
                if not session.is_open:  # by a stop, an e-stop, a fault; the next move begins another one
                    self._forget(session)
            fitting = next((session for session in self._sessions if controllers <= session.controllers), None)
            if fitting is None:
                fitting = await self._begin(controllers)
            fitting.users += 1
            if fitting.timer is not None:
                fitting.timer.cancel()
            return fitting

    async def _give_back(self, session: _Session) -> None:
        session.users -= 1
        if session.users == 0 and not self._is_staged(session):
            session.timer = asyncio.get_running_loop().call_later(IDLE_S, self._end_idle, session)
        async with self._freed:
            self._freed.notify_all()

    async def _begin(self, controllers: set[str]) -> _Session:
        staged_controllers = {controller_of(axis) for axis, count in self._staged.items() if count}
        held_controllers = {name for session in self._sessions for name in session.controllers}
        wanted_controllers = controllers | (staged_controllers - held_controllers)
        await self._end_overlapping(wanted_controllers)
        tutti = await self._open_fleet()
        live = tutti.live(sorted(wanted_controllers), name=self._name)
        await live.begin()
        session = _Session(live, frozenset(wanted_controllers))
        self._sessions.append(session)
        return session

    async def _end_overlapping(self, controllers: set[str]) -> None:
        """End the live jobs that hold some of the controllers, once nothing moves in them."""
        for session in [entry for entry in self._sessions if entry.controllers & controllers]:
            async with self._freed:
                await self._freed.wait_for(lambda used=session: used.users == 0)
            await self._end(session)

    def _end_idle(self, session: _Session) -> None:
        if session.users == 0 and session in self._sessions:
            self._endings.spawn(self._end(session))

    async def _end(self, session: _Session) -> None:
        self._forget(session)
        with suppress(Refusal, JobFailed):  # it has ended by itself
            await session.live.end()

    def _forget(self, session: _Session) -> None:
        if session.timer is not None:
            session.timer.cancel()
        with suppress(ValueError):
            self._sessions.remove(session)
