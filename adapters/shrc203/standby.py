"""Axes that wait for an input: a standby runs (WI:, L2633), and the move sits in the prebuffer behind it.

The unit compares all six inputs at once (L2674), so the levels of the others are read at arming and put into the
pattern. Ending a standby starts what is queued behind it (L219): it is overwritten, and that is read back, first.
"""

from adapters.contract import CannotDo, DriverFault
from adapters.shrc203.axes import letter
from adapters.shrc203.lines import Wait
from adapters.shrc203.replies import BITS, STATUS, status
from adapters.shrc203.status import ERRORS
from adapters.shrc203.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock

COMPLETION_LATE_NS = 100 * NS_PER_MS  # a completion line that comes later than this is taken for lost
_NEVER_NS = NS_PER_S  # a standby that is cancelled has ended by then
_TRIES = 2


async def can_wait_at_rest(unit: UnitState) -> bool:
    """Whether the unit takes `WI:` while nothing runs, which the manual leaves open (L2639).

    Asked of an axis whose motor is on: only there can the prebuffer be overwritten again.
    """
    on = [motor for motor in unit.controllable if unit.excited.get(motor)]
    if not on or not await unit.session.try_to_tell(f"WI:{on[0]},0"):
        return not on
    await unit.buffers.clear({on[0]})
    return True


class Standby:
    """The standby of one connection. levels: the value of all inputs at arming."""

    def __init__(self, unit: UnitState, clock: Clock) -> None:
        self._unit = unit
        self._clock = clock
        self._levels = 0

    async def begin(self, wait: Wait, starts: dict[int, int]) -> None:
        """Let the motors of `starts` wait, with nothing behind it yet. starts: where they stand, in pulses.

        Raises `CannotDo`, code `line-level` when the input is active already.
        """
        unit, session = self._unit, self._unit.session
        if session.owed:
            raise CannotDo("busy", "a completion line is still due", "try again")
        self._levels = await self._inputs()
        if bool(self._levels & wait.bit) == wait.active:
            raise CannotDo(
                "line-level",
                f"input {wait.name} (IN{wait.number}) is active already",
                "look at what drives it, and at `active` in the fleet file",
            )
        pattern = self._levels ^ wait.bit
        command = f"WI:{letter(starts)},{','.join([str(pattern)] * len(starts))}"
        if not await session.try_to_tell(command):
            raise CannotDo(
                "start-class",
                f"no start by line: the controller answered NG to {command!r}",
                "let it start by its host: leave its input out of `wiring`",
            )
        found = await unit.buffers.waits()
        if any(found[motor] != pattern for motor in starts):
            held = ", ".join(str(found[motor]) for motor in starts)
            raise CannotDo(
                "load-garbled", f"sent {command!r}, the unit would wait for {held}", "check the cable; arm again"
            )
        unit.waiting = dict(starts)
        await session.tell(f"G:{letter(starts)}")

    async def check(self, wait: Wait) -> None:
        """Still waiting, at the same place, for a pattern that the line can still bring about. Raises `CannotDo`."""
        unit = self._unit
        levels = await self._inputs()
        if bool(levels & wait.bit) == wait.active:
            raise CannotDo("line-level", f"input {wait.name} (IN{wait.number}) has become active too early", "")
        if levels != self._levels:
            changed = [f"IN{number}" for number in range(1, 7) if (levels ^ self._levels) & 1 << (number - 1)]
            raise CannotDo(
                "other-inputs",
                f"{', '.join(changed)} changed since arming; the unit compares all six inputs, and would not start",
                "arm again when they rest, or let the controller start by its host",
            )
        now = status(await unit.session.ask("Q:SPC", STATUS), unit.controllable)
        for motor, counts in unit.waiting.items():
            if not now[motor].busy or now[motor].counts != counts:
                raise CannotDo("not-armed", f"axis {motor} does not wait for input {wait.name} any more", "arm again")

    async def end(self) -> None:
        """Let nothing wait any more, without starting anything. Raises `DriverFault` (code `still-armed`)."""
        unit, session = self._unit, self._unit.session
        if not unit.waiting:
            return
        now = status(await session.ask("Q:SPC", STATUS), unit.controllable)
        # What an emergency stop or a motor that is off has ended takes no command, and nothing starts there.
        motors = {m for m in unit.waiting if now[m].busy or (unit.excited.get(m, True) and not now[m].word & ERRORS)}
        unit.waiting = {motor: counts for motor, counts in unit.waiting.items() if motor in motors}
        if not motors:
            return
        left = motors
        for _ in range(_TRIES):
            await unit.buffers.clear(left)
            left = {motor for motor, queued in (await unit.buffers.moves()).items() if motor in motors and queued}
            if not left:
                break
        if left:
            raise DriverFault(
                "still-armed",
                f"axis {letter(left)} waits for an input, and the unit keeps the move behind it although it was "
                "overwritten",
                "keep the input passive and switch the unit off and on",
            )
        # What they run when they are released is a move of no distance, which may still say that it has ended.
        session.owe(motors)
        for motor in sorted(motors):
            await session.try_to_tell(f"WI:{motor},C")
        await self._until_rest(motors)
        session.owe_nothing()
        unit.waiting = {}

    async def _until_rest(self, motors: set[int]) -> None:
        session = self._unit.session
        give_up_ns = self._clock.now_ns() + _NEVER_NS
        while await self._any_busy(motors):
            if self._clock.now_ns() > give_up_ns:
                raise DriverFault(
                    "still-armed", f"axis {letter(motors)} stays in standby", "switch the unit off and on"
                )
        late_ns = self._clock.now_ns() + COMPLETION_LATE_NS
        while session.owed and self._clock.now_ns() < late_ns:
            await session.wait_changed(late_ns)

    async def _any_busy(self, motors: set[int]) -> bool:
        now = status(await self._unit.session.ask("Q:SPC", STATUS), self._unit.controllable)
        return any(now[motor].busy for motor in motors)

    async def _inputs(self) -> int:
        return int(await self._unit.session.ask("I:", BITS))
