"""Input waits: a standby command is active (WI:, L2633), and the move is in the prebuffer after it.

The controller compares all six inputs at once (L2674), so the levels of the others are read at arming and included in
the pattern. Ending a wait starts the move queued after it (L219): that move is overwritten, and verified, first.
"""

from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import BITS, STATUS, axis_argument, parse_status
from adapters.shrc203.wire.session import COMPLETION_LATE_NS
from adapters.shrc203.wire.status import ERRORS
from adapters.toolkit.wired_points import WiredInput
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.errors import ControllerFault, Refusal

_NEVER_NS = NS_PER_S  # a wait that is cancelled has ended by then
_TRIES = 2


async def can_wait_at_rest(unit: ShrcState) -> bool:
    """Return whether the controller accepts `WI:` while no move runs, which the manual leaves open (L2639).

    Tested on an axis whose motor is on: only there can the prebuffer be overwritten again.
    """
    on = [motor for motor in unit.controllable if unit.excited.get(motor)]
    if not on or not await unit.session.try_setting(f"WI:{on[0]},0"):
        return not on
    await unit.prebuffers.overwrite_moves({on[0]})
    return True


class InputWait:
    """The input wait of one connection. levels: the value of all inputs at arming."""

    def __init__(self, unit: ShrcState, clock: Clock) -> None:
        self._unit = unit
        self._clock = clock
        self._levels = 0

    async def begin_wait(self, wait: WiredInput, starts: dict[int, int]) -> None:
        """Let the motors of `starts` wait, with no move queued yet. starts: their positions, in pulses.

        Raises `Refusal`, code `line-level` when the input is already active.
        """
        unit, session = self._unit, self._unit.session
        if session.completions.expected:
            raise Refusal("busy", "a completion line is still outstanding", "try again")
        self._levels = await self._read_inputs()
        if wait.is_active(self._levels):
            raise Refusal(
                "line-level",
                f"input {wait.name} (IN{wait.number}) is already active",
                "find the source of its signal, and check `active` in the fleet file",
            )
        pattern = self._levels ^ wait.mask
        command = f"WI:{axis_argument(starts)},{','.join([str(pattern)] * len(starts))}"
        if not await session.try_setting(command):
            raise Refusal(
                "start-class",
                f"no start by trigger line: the controller answered NG to {command!r}",
                "let the host start it: remove its input from `wiring`",
            )
        held_waits = await unit.prebuffers.read_waits()
        if any(held_waits[motor] != pattern for motor in starts):
            waits_text = ", ".join(str(held_waits[motor]) for motor in starts)
            raise Refusal(
                "load-garbled",
                f"sent {command!r}, the controller would wait for {waits_text}",
                "check the cable; arm it again",
            )
        unit.waiting = dict(starts)
        await session.send_setting(f"G:{axis_argument(starts)}")

    async def check_wait(self, wait: WiredInput) -> None:
        """Check that the motors are still waiting, at the same position, for a pattern that the trigger line can still
        produce. Raises `Refusal`."""
        unit = self._unit
        levels = await self._read_inputs()
        if wait.is_active(levels):
            raise Refusal("line-level", f"input {wait.name} (IN{wait.number}) has become active too early", "")
        if levels != self._levels:
            changed_inputs = [f"IN{number}" for number in range(1, 7) if (levels ^ self._levels) & 1 << (number - 1)]
            raise Refusal(
                "other-inputs",
                f"{', '.join(changed_inputs)} changed since arming; the controller compares all six inputs, and "
                "would not start",
                "arm again when these inputs are stable, or let the host start the controller",
            )
        states = parse_status(await unit.session.send_query("Q:SPC", STATUS), unit.controllable)
        for motor, counts in unit.waiting.items():
            if not states[motor].is_busy or states[motor].counts != counts:
                raise Refusal("not-armed", f"axis {motor} no longer waits for input {wait.name}", "arm it again")

    async def end_wait(self) -> None:
        """End all waits without starting anything. Raises `ControllerFault` (code `still-armed`)."""
        unit, session = self._unit, self._unit.session
        if not unit.waiting:
            return
        states = parse_status(await session.send_query("Q:SPC", STATUS), unit.controllable)
        # A wait that was ended by an emergency stop or a motor switched off accepts no command, and no move starts
        # there.
        motors = {
            m for m in unit.waiting if states[m].is_busy or (unit.excited.get(m, True) and not states[m].word & ERRORS)
        }
        unit.waiting = {motor: counts for motor, counts in unit.waiting.items() if motor in motors}
        if not motors:
            return
        motors_left = motors
        for _ in range(_TRIES):
            await unit.prebuffers.overwrite_moves(motors_left)
            motors_left = {
                motor
                for motor, queued_move in (await unit.prebuffers.read_moves()).items()
                if motor in motors and queued_move
            }
            if not motors_left:
                break
        if motors_left:
            raise ControllerFault(
                "still-armed",
                f"axis {axis_argument(motors_left)} waits for an input, and the controller keeps the queued move "
                "although it was overwritten",
                "keep the input passive and switch the controller off and on",
            )
        # The ended waits run a move of no distance, which may still send a completion line.
        session.completions.expect(motors)
        for motor in sorted(motors):
            await session.try_setting(f"WI:{motor},C")
        await self._wait_for_rest(motors)
        session.completions.expect_none()
        unit.waiting = {}

    async def _wait_for_rest(self, motors: set[int]) -> None:
        session = self._unit.session
        give_up_ns = self._clock.now_ns() + _NEVER_NS
        while await self._any_busy(motors):
            if self._clock.now_ns() > give_up_ns:
                raise ControllerFault(
                    "still-armed",
                    f"axis {axis_argument(motors)} stays in its input wait",
                    "switch the controller off and on",
                )
        late_ns = self._clock.now_ns() + COMPLETION_LATE_NS
        while session.completions.expected and self._clock.now_ns() < late_ns:
            await session.wait_changed(late_ns)

    async def _any_busy(self, motors: set[int]) -> bool:
        states = parse_status(await self._unit.session.send_query("Q:SPC", STATUS), self._unit.controllable)
        return any(states[motor].is_busy for motor in motors)

    async def _read_inputs(self) -> int:
        return int(await self._unit.session.send_query("I:", BITS))
