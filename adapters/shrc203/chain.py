"""Chains of prebuffered moves: each begins by itself when the one before it has ended (L173-L181).

The unit keeps one move an axis besides the one that runs, and overwrites it without a word. So the loader is one
completion ahead: when the completion line of move n comes, move n+1 has left the prebuffer and n+2 is written there.
Every boundary is a full stop. A load that comes too late finds nothing running and is answered `OK` in place of
`OK_D` (L235): the chain has run dry, which is said, and the move is started anew.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import ceil

from adapters.contract import CannotDo
from adapters.shrc203.axes import letter
from adapters.shrc203.fleetaxes import bounds, motor
from adapters.shrc203.replies import COMMAND, DONE, READY, REFUSALS, STATUS, AxisStatus, amounts, entries, status
from adapters.shrc203.session import Line
from adapters.shrc203.standby import COMPLETION_LATE_NS
from adapters.shrc203.status import ERRORS, why_stopped
from adapters.shrc203.trapezoid import Trapezoid
from adapters.shrc203.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Axis, Controller

_LOOK_NS = 50 * NS_PER_MS
_DEFERRED = "OK_D"
_ROOM = 1e-6


@dataclass(frozen=True, slots=True)
class ChainMove:
    """One move of a chain. distance: pulses, with its sign. shape: what the unit makes of it."""

    distance: int
    shape: Trapezoid


@dataclass(frozen=True, slots=True)
class Underrun:
    """The axis stood still after its first `done` moves, because the next one came too late. at_ns: when that was
    known."""

    axis: str
    done: int
    at_ns: int


@dataclass(frozen=True, slots=True)
class ChainReport:
    """How a chain went. done: moves by axis. least_ahead_ns: the shortest time from the answer to a load to the end of
    the move that ran meanwhile. reason: why it did not run to its end, "" if it did."""

    done: Mapping[str, int]
    underruns: tuple[Underrun, ...]
    least_ahead_ns: int | None
    reason: str = ""


@dataclass(slots=True)
class _Thread:
    """One axis of a chain. loaded, done: so many of its moves have been written, and have ended. load: the answer to
    the last one's line, which is `command`. speeds: of it. due_ns: when the running move has ended at the latest.
    free: a completion line has said that the prebuffer is free."""

    name: str
    motor: int
    start: int
    moves: Sequence[ChainMove]
    loaded: int = 0
    done: int = 0
    speeds: str = ""
    load: "asyncio.Future[Line] | None" = None
    command: str = ""
    due_ns: int = 0
    free: bool = False

    @property
    def ended(self) -> bool:
        return self.done == len(self.moves)

    def line(self) -> str:
        """Loads the next move. Its speeds are left out where they are those of the move before it, which runs or has
        run with them: an omitted triple is the present one (L3098), and every move sets it (L3100)."""
        move = self.moves[self.loaded]
        speeds = f"S{move.shape.s}F{move.shape.f}R{move.shape.r}"
        shown = f",{speeds}" if speeds != self.speeds else ""
        self.speeds = speeds
        self.loaded += 1
        return f"MP:{self.motor}{'-' if move.distance < 0 else '+'}P{abs(move.distance)}{shown}"

    def place(self, done: int) -> int:
        """Where the axis stands after so many moves."""
        return self.start + sum(each.distance for each in self.moves[:done])


class Chain:
    """A chain on one connection, whose unit is marked as `chaining` until it has run. say: told of every underrun.
    clock_ppm: largest error of the unit's crystal."""

    def __init__(
        self, config: Controller, clock: Clock, unit: UnitState, clock_ppm: float, say: Callable[[str], None]
    ) -> None:
        self._config = config
        self._clock = clock
        self._unit = unit
        self._slow = 1 + clock_ppm * 1e-6
        self._say = say
        self._threads: dict[int, _Thread] = {}
        self._underruns: list[Underrun] = []
        self._least_ahead_ns: int | None = None
        self._reason = ""
        self._stops: dict[int, int] = {}

    async def run(self, moves: Mapping[str, Sequence[ChainMove]]) -> ChainReport:
        """Run the moves of each axis one after the other, all axes from one start.

        Raises `CannotDo` when nothing has begun. A chain that is stopped, or breaks, is a report with a reason.
        """
        unit = self._unit
        for name in moves:
            number = motor(self._config.axes[name])
            self._stops[number] = unit.stops_given(number)
        try:
            async with unit.loading:
                await self._prepare(moves)
                await self._start()
            await self._follow()
        except BaseException as error:
            if not isinstance(error, CannotDo):
                unit.untidy = True
                with suppress(LinkClosed):
                    unit.brake(self._threads)
            raise
        finally:
            unit.session.owe_nothing()
            unit.chaining = False
        await self._judge()
        return ChainReport(
            {each.name: each.done for each in self._threads.values()},
            tuple(self._underruns),
            self._least_ahead_ns,
            self._reason,
        )

    # Before the start

    async def _prepare(self, moves: Mapping[str, Sequence[ChainMove]]) -> None:
        unit, session = self._unit, self._unit.session
        now = status(await session.ask("Q:SPC", STATUS), unit.controllable)
        for name, each in moves.items():
            axis = self._config.axes[name]
            number = motor(axis)
            if now[number].busy:
                raise CannotDo("moving", f"axis {name} is moving", "wait, or stop it")
            if now[number].word & ERRORS:
                raise CannotDo("fault", why_stopped(name, now[number]), "clear it with `tutti reset`")
            check(name, axis, now[number].counts, each)
            self._threads[number] = _Thread(name, number, now[number].counts, each)
        unit.by_hand -= set(self._threads)
        await unit.make_harmless()
        await session.tell(f"GC:{letter(self._threads)}")

    async def _start(self) -> None:
        """Load the first move of every axis, start them by one line, and load the second ones behind them."""
        session = self._unit.session
        try:
            for thread in self._threads.values():
                line = thread.line()
                text = await session.tell_and_hear(line)
                if text != line:
                    raise CannotDo("load-garbled", f"sent {line!r}, the unit has understood {text!r}", "try again")
            session.owe(set(self._threads), self._completed)
            await session.tell(f"G:{letter(self._threads)}", self._require_no_stop)
        except CannotDo:
            session.owe_nothing()
            await self._unit.make_harmless()
            raise
        now_ns = self._clock.now_ns()
        for thread in self._threads.values():
            self._expect_end(thread, now_ns)
            if thread.loaded == 1:  # a completion line may have been quicker
                self._load(thread)

    def _require_no_stop(self) -> None:
        for thread in self._threads.values():
            self._unit.require_no_stop(thread.name, thread.motor, self._stops[thread.motor])

    @property
    def _stopped(self) -> bool:
        return any(self._unit.stops_given(number) != since for number, since in self._stops.items())

    # While it runs

    def _completed(self, number: int, at_ns: int) -> None:
        """A completion line: its axis has taken its next move over, and the prebuffer is free."""
        thread = self._threads[number]
        if thread.ended or self._stopped:
            return
        thread.done += 1
        self._note_ahead(thread, at_ns)
        self._expect_end(thread, at_ns)
        thread.free = True
        self._go_on(thread)

    def _note_ahead(self, thread: _Thread, at_ns: int) -> None:
        if thread.ended or thread.load is None:
            return
        ahead_ns = at_ns - thread.load.result().at_ns if _answered(thread.load) else 0
        self._least_ahead_ns = ahead_ns if self._least_ahead_ns is None else min(self._least_ahead_ns, ahead_ns)

    def _expect_end(self, thread: _Thread, begun_ns: int) -> None:
        if not thread.ended:
            duration_s = thread.moves[thread.done].shape.duration_s
            thread.due_ns = begun_ns + ceil(duration_s * NS_PER_S * self._slow) + COMPLETION_LATE_NS

    def _load(self, thread: _Thread) -> None:
        """Write the next move, if there is one, without waiting for anything."""
        thread.free = False
        if thread.loaded < len(thread.moves) and not (self._stopped or self._reason):
            thread.command = thread.line()
            thread.load = self._unit.session.send(thread.command, DONE)
            thread.load.add_done_callback(lambda _: self._go_on(thread))
            self._read_back(thread)

    def _read_back(self, thread: _Thread) -> None:
        """Ask what the unit holds of the last loads, once the last of them is loaded; the answer is there before the
        moves begin, or soon after. Distances only: a line with its speeds would take longer to tell than there is."""
        if len(self._unit.controllable) == 1:
            # There a distance of a few pulses would read like a completion line.
            name, command = thread.name, thread.command  # of now: the next one may be loaded before the answer
            self._unit.session.send("?:CMD", COMMAND).add_done_callback(
                lambda heard: self._compare_line(heard, name, command)
            )
        elif all(each.load is None or _answered(each.load) for each in self._threads.values() if each is not thread):
            meant = {number: each.moves[each.loaded - 1].distance for number, each in self._threads.items()}
            self._unit.session.send("?:MPW", amounts(len(self._unit.controllable))).add_done_callback(
                lambda heard: self._compare_distances(heard, meant)
            )

    def _compare_line(self, heard: "asyncio.Future[Line]", name: str, command: str) -> None:
        if _told(heard) and heard.result().text.upper() != command:
            self._halt(f"axis {name}: sent {command!r}, the unit has understood {heard.result().text!r}")

    def _compare_distances(self, heard: "asyncio.Future[Line]", meant: Mapping[int, int]) -> None:
        """What has begun already, and left the prebuffer, is judged by where the axis comes to rest."""
        if not _told(heard):
            return
        found = dict(zip(self._unit.controllable, entries(heard.result().text), strict=True))
        for number, distance in meant.items():
            if found[number] not in (None, distance):
                self._halt(
                    f"axis {self._threads[number].name}: {found[number]} pulses are loaded instead of {distance}"
                )

    def _halt(self, reason: str) -> None:
        self._break(reason)
        self._unit.brake(self._threads)
        self._unit.session.changed.set()

    def _go_on(self, thread: _Thread) -> None:
        """Load the next move when the prebuffer is free. That takes a completion line, and that the last load was taken
        in time: one that finds nothing running stays in the prebuffer, and must not be overwritten."""
        self._unit.session.changed.set()
        taken = thread.load is None or (_answered(thread.load) and thread.load.result().text == _DEFERRED)
        if taken and thread.free:
            self._load(thread)

    async def _follow(self) -> None:
        session = self._unit.session
        while not (self._reason or self._stopped or all(each.ended for each in self._threads.values())):
            await session.wait_changed(self._clock.now_ns() + _LOOK_NS)
            for thread in self._threads.values():
                await self._judge_answer(thread)
                if not thread.ended and self._clock.now_ns() > thread.due_ns:
                    await self._look(thread)
        if self._stopped:
            self._reason = "stopped on request"
        elif self._reason:
            self._unit.brake(self._threads)

    async def _judge_answer(self, thread: _Thread) -> None:
        """An answer to the last load that is not the usual one."""
        load = thread.load
        if load is None or not load.done():
            return
        if (error := load.exception()) is not None:
            self._break(f"axis {thread.name}: {error}")
        elif load.result().text in REFUSALS:
            self._break(f"axis {thread.name}: the controller answered NG to {thread.command!r}")
        elif load.result().text != _DEFERRED:
            await self._found_dry(thread)

    async def _found_dry(self, thread: _Thread) -> None:
        """`OK`: nothing ran any more when the load came. Units that answer so at any time are still busy."""
        if not await self._busy(thread):
            await self._restart(thread)
        else:
            thread.load = None
            self._go_on(thread)

    async def _look(self, thread: _Thread) -> None:
        """No completion line came when it should have. A line may have been lost; where the axis stands tells."""
        if await self._busy(thread):
            self._break(f"axis {thread.name} takes longer than it can over move {thread.done + 1}")
            return
        now = await self._now(thread)
        done = next((n for n in range(thread.done, thread.loaded + 1) if thread.place(n) == now.counts), None)
        if done is None or now.word & ERRORS:
            self._break(self._astray(thread, now))
        elif done < thread.loaded:
            self._break(f"axis {thread.name} does not go on, although move {thread.loaded} is loaded")
        else:
            thread.done, thread.free = done, True
            self._expect_end(thread, self._clock.now_ns())
            self._go_on(thread)

    async def _restart(self, thread: _Thread) -> None:
        """The last load waits for somebody to start it, if its axis has done all before it."""
        waiting = thread.loaded
        now = await self._now(thread)
        if now.counts != thread.place(waiting - 1) or now.word & ERRORS:
            self._break(self._astray(thread, now))
            return
        thread.done = waiting - 1
        self._underruns.append(Underrun(thread.name, thread.done, self._clock.now_ns()))
        self._say(
            f"axis {thread.name} ran out of moves after {thread.done} of {len(thread.moves)}: move {waiting} came too "
            "late; it is started anew"
        )
        try:
            await self._unit.session.tell(f"G:{thread.motor}", self._require_no_stop)
        except CannotDo as error:
            self._break(f"axis {thread.name}: {error}")
            return
        self._expect_end(thread, self._clock.now_ns())
        thread.load = None
        self._load(thread)

    async def _now(self, thread: _Thread) -> AxisStatus:
        return status(await self._unit.session.ask("Q:SPC", STATUS), self._unit.controllable)[thread.motor]

    def _astray(self, thread: _Thread, now: AxisStatus) -> str:
        return why_stopped(thread.name, now) or (
            f"axis {thread.name} stands at {now.counts}, between the places of its chain"
        )

    async def _busy(self, thread: _Thread) -> bool:
        return await self._unit.session.ask(f"!:{thread.motor}S", READY) == "B"

    def _break(self, reason: str) -> None:
        self._reason = self._reason or reason

    # After the end

    async def _judge(self) -> None:
        """Where the axes have come to rest, and that nothing is left behind."""
        unit = self._unit
        give_up_ns = self._clock.now_ns() + 2 * NS_PER_S
        while True:
            now = status(await unit.session.ask("Q:SPC", STATUS), unit.controllable)
            if not any(now[number].busy for number in self._threads) or self._clock.now_ns() > give_up_ns:
                break
        for number, thread in self._threads.items():
            if not self._reason and now[number].counts != thread.place(thread.done):
                self._reason = why_stopped(thread.name, now[number]) or (
                    f"axis {thread.name} stands at {now[number].counts}, not at {thread.place(thread.done)}"
                )
        if any(now[number].word & ERRORS for number in self._threads):
            unit.untidy = True  # an emergency stop lets nothing be overwritten, and nothing start
            return
        async with unit.loading:
            await unit.make_harmless()


def _answered(load: "asyncio.Future[Line]") -> bool:
    return load.done() and load.exception() is None


def _told(query: "asyncio.Future[Line]") -> bool:
    """Whether there is an answer; a query that was garbled on its way is refused."""
    return _answered(query) and query.result().text not in REFUSALS


def check(name: str, axis: Axis, start: int, moves: Sequence[ChainMove]) -> None:
    """Raises `CannotDo` for a chain with a move that goes beyond the axis's limits, or is none."""
    limits, soft = bounds(axis), axis.soft_limits_counts
    place = start
    for number, move in enumerate(moves, 1):
        shape = move.shape
        if move.distance == 0 or abs(move.distance) != shape.distance:
            raise CannotDo(
                "bad-move", f"axis {name}, move {number}: {move.distance} pulses by a shape of {shape.distance}"
            )
        if shape.peak > limits.speed * (1 + _ROOM) or not limits.start_min <= shape.s <= limits.start_max:
            raise CannotDo("velocity-limit", f"axis {name}, move {number}: {shape} is beyond its speed or start rate")
        if shape.acceleration > limits.acceleration * (1 + _ROOM):
            raise CannotDo("acceleration-limit", f"axis {name}, move {number}: {shape} is beyond its acceleration")
        place += move.distance
        if soft is not None and not soft[0] <= place <= soft[1]:
            raise CannotDo(
                "soft-limit",
                f"axis {name}, move {number} ends at {place} pulses; its soft limits are {soft[0]} to {soft[1]}",
            )
