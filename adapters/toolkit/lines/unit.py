"""The state of one connected controller with text lines: its status in counts, its session number, its stops."""

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.contract import DriverLog, TimedWrite, TimedWriter
from adapters.toolkit.lines.dialect import LineDialect, LineStatus
from adapters.toolkit.lines.lowering import CountScale
from adapters.toolkit.lines.session import LineReply, LineSession
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller

_RETRY_NS = 50 * NS_PER_MS
_TRIES = 5


@dataclass(frozen=True, slots=True)
class LineUnitState:
    """A status with the counts of each axis."""

    status: LineStatus
    reply: LineReply
    counts: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class LineTools:
    """What a unit works with."""

    config: Controller
    dialect: LineDialect
    scales: Mapping[str, CountScale]
    clock: Clock
    timed_writer: TimedWriter
    log: DriverLog


class LineUnit:
    """One connection. number: the session number that the controller should hold."""

    def __init__(self, tools: LineTools, session: LineSession, enabled: set[str], number: int) -> None:
        self.session = session
        self.dialect = tools.dialect
        self.clock = tools.clock
        self.timed_writer = tools.timed_writer
        self.enabled = enabled
        self.number = number
        self.stops = 0
        """Number of stops written: a command that waits for its turn must not start a motion after one."""
        self.commanding = asyncio.Lock()
        self.is_searching = False
        self.has_lost_session = False
        self._tools = tools
        self._tidying: asyncio.Task[None] | None = None
        self._untidy: ControllerFault | None = None
        self.must_number = False
        """The controller must get its session number as soon as it accepts it, and before it moves: in an alarm it
        takes none, and another client may clear the alarm."""
        self._followers: set[asyncio.Task[None]] = set()

    async def read_state(self) -> LineUnitState:
        """Read the status. Raises `ControllerFault`, `LinkClosed`."""
        status, reply = await self.session.ask_status()
        return LineUnitState(status, reply, self.count_axes(status))

    def count_axes(self, status: LineStatus) -> dict[str, int]:
        """Return the counts of all axes of the fleet file. Raises `ControllerFault` for an axis without a position."""
        counts: dict[str, int] = {}
        for name, axis in self._tools.config.axes.items():
            axis_status = status.axes.get(axis.motors[0])
            if axis_status is None or not abs(axis_status.position) < 1e12:
                raise ControllerFault(
                    "garbage",
                    f"{self.session.link.endpoint} reports no position of {axis.motors[0]}",
                    f"it reports {', '.join(status.axes) or 'none'}; correct `motors` in the fleet file",
                )
            counts[name] = self._tools.scales[name].to_counts(axis_status.position)
        return counts

    async def read_number(self) -> int:
        """Read the session number."""
        number, _ = await self.session.ask(self.dialect.ask_session(), self.dialect.read_session)
        return number

    async def write_number(self) -> None:
        """Write the session number, and read it back: without one no restart would be noticed. Raises `Refusal`."""
        await self.session.run_procedure(self.dialect.write_session(self.number))
        number = await self.read_number()
        if number != self.number:
            source = self.dialect.traits.session_place
            raise ControllerFault(
                "config-mismatch",
                f"the session number {self.number} was written, and {number} is read back"
                + f" ({source})" * bool(source),
                "is it the right make? if so, another value must be the session number: a volatile one that lasts",
            )
        self.must_number = False

    async def is_restarted(self, state: LineUnitState) -> bool:
        """Return whether the controller has lost the session number. It is read at rest only."""
        if self.session.restarted:
            return True
        if state.status.state != "idle" or self.must_number or self._tidying is not None:
            return False
        self.has_lost_session = await self.read_number() != self.number
        return self.has_lost_session

    async def require_ready(self, axes: Sequence[str]) -> None:
        """Raise `Refusal` unless the controller is at rest and sound, and the axes are enabled."""
        disabled_axes = [name for name in axes if name not in self.enabled]
        if disabled_axes:
            names = ", ".join(disabled_axes)
            raise Refusal("not-enabled", f"axis {names} is not enabled", f"enable {names} first")
        state = await self.read_state()
        if state.status.state == "alarm":
            raise Refusal("alarm", f"the controller reports {state.status.alarm}", "clear it with `tutti reset`")
        if state.status.state != "idle":
            raise Refusal("moving", f"the controller is {state.status.state}", "wait for its end, or stop it")
        await self.number_again()
        if await self.is_restarted(state):
            raise Refusal("restarted", "the controller has restarted", "home it again")

    def require_no_stop(self, since: int) -> None:
        """Raise `Refusal` when a stop was written since `stops` was `since`, or the controller has restarted."""
        if self.stops != since:
            raise Refusal("stopped", "the controller was stopped meanwhile", "try again")
        if self.session.restarted or self.has_lost_session:
            raise Refusal("restarted", "the controller has restarted", "home it again")

    # Stops

    def write_stop(self) -> None:
        """Write a stop at once; afterwards the controller is brought to rest with nothing loaded."""
        self.stops += 1
        stop = self.dialect.stop_search_bytes if self.is_searching else self.dialect.stop_bytes
        self.session.write_at_once(stop)
        self.session.disturb()
        self.begin_tidying()

    def stop_after(self, order: TimedWrite | None) -> None:
        """Write another stop as soon as `order` is written."""

        async def stop_then() -> None:
            if order is not None:
                with suppress(asyncio.CancelledError, LinkClosed):
                    await order.wait_until_written()
            with suppress(LinkClosed):
                self.write_stop()

        task = asyncio.get_running_loop().create_task(stop_then())
        self._followers.add(task)
        task.add_done_callback(self._followers.discard)

    def begin_tidying(self) -> None:
        """Begin to bring the controller to rest after a stop."""
        if self._tidying is None:
            self._tidying = asyncio.get_running_loop().create_task(self._tidy_up())

    async def wait_until_tidy(self) -> None:
        """Wait until the last stop is completed. Raises `ControllerFault` when it cannot be."""
        while self._tidying is not None:
            await asyncio.wait({self._tidying})
        if self._untidy is not None:
            error, self._untidy = self._untidy, None
            self.begin_tidying()
            raise error

    async def _tidy_up(self) -> None:
        """Complete a stop: the controller comes to rest, and forgets what was loaded."""
        self._untidy = None
        stop_count = -1
        error: ControllerFault | None = None
        try:
            for _ in range(_TRIES):
                stop_count = self.stops
                try:
                    await self._complete_stop()
                    error = None
                except ControllerFault as fault:
                    error = fault
                except Refusal as refusal:
                    error = ControllerFault(refusal.code, refusal.text, refusal.remedy)
                if error is None and stop_count == self.stops:
                    return
                await sleep_ns(self.clock, _RETRY_NS)
        except LinkClosed:
            return
        finally:
            self._tidying = None
            self._untidy = error

    async def _complete_stop(self) -> None:
        """Run the make's procedure. A controller that loses its session number by it gets it again, if its position is
        still the same: otherwise it has restarted."""
        session, traits = self.session, self.dialect.traits
        counts_before: dict[str, int] | None = None
        session.is_resetting = not traits.keeps_session
        try:
            for step in self.dialect.finish_stop():
                if step.data:
                    await session.run_step(step)
                if step.until:
                    counts = self.count_axes(await session.wait_for_state(step))
                    counts_before = counts if counts_before is None else counts_before
        finally:
            session.is_resetting = False
        if traits.keeps_session:
            return
        state = await self.read_state()
        if counts_before is not None and state.counts != counts_before:
            self.has_lost_session = True
        elif state.status.state == "alarm":
            self.must_number = True
        elif not session.restarted:
            await session.run_procedure(self.dialect.write_session(self.number))

    async def clear_alarm(self) -> None:
        """Clear the controller's alarm. Raises `Refusal`."""
        await self.session.run_procedure(self.dialect.clear_alarm())
        state = await self.read_state()
        if state.status.state == "alarm":
            raise Refusal("alarm", f"the controller still reports {state.status.alarm}", "see the controller")
        await self.number_again()

    async def number_again(self) -> None:
        """Write the session number if it could not be written before. Raises `Refusal`, `ControllerFault`."""
        if self.must_number and (await self.read_state()).status.state == "idle":
            await self.write_number()

    def cancel(self) -> None:
        """End what runs by itself."""
        for task in (*self._followers, *([] if self._tidying is None else [self._tidying])):
            task.cancel()
