"""Meeting a unit: is it one, is it set as the fleet file says, and is it left alone by everybody else."""

import re

from adapters.contract import CannotDo, DriverFault
from adapters.smc30.frames import Reply, line
from adapters.smc30.options import Options
from adapters.smc30.session import Busy, Session
from adapters.smc30.unitstate import EITHER, SENTINEL, SENTINEL_REGISTER, STATUS, UnitState
from orchestrator.clock.base import NS_PER_S, Clock

TOP_RATE = re.compile(r"T\d{2,5}|B")


async def meet(unit: UnitState) -> None:
    """See that an SMC30 answers as the switches should be set; leave Programming Mode. Nothing is stopped."""
    session = unit.session
    try:
        answer = await session.ask("F", STATUS)
    except (DriverFault, CannotDo) as error:
        if isinstance(error, DriverFault) and await _answers_otherwise(session):
            raise _other_checksum(session) from None
        if isinstance(error, DriverFault):
            raise
        raise DriverFault(error.refusal.code, error.refusal.text, "is it an SMC30?") from None
    if answer.text == "B":
        return
    await _leave_programming(session)
    try:
        await session.ask("VT", TOP_RATE)
    except Busy:
        return
    except CannotDo as error:
        text = f"{error.refusal.text}; an SMC30 gives its top rate"
        raise DriverFault("wrong-make", text, "check adapter and link") from None


async def _leave_programming(session: Session) -> None:
    """PX; in Standby it is refused or does nothing (L1893-L1899)."""
    try:
        await session.ask("PX", EITHER)
    except Busy:
        return
    except CannotDo as error:
        raise DriverFault(error.refusal.code, error.refusal.text, error.refusal.remedy) from None


async def _answers_otherwise(session: Session) -> bool:
    """Whether the unit answers F in the other form, with or without a checksum."""
    sent = line("F", session.unit, not session.with_checksum)

    def any_reply(replies: list[Reply]) -> bool:
        return bool(replies)

    try:
        _, replies = await session.line.exchange(session.unit, sent, any_reply)
    except DriverFault:
        return False
    # With its checksum a reply looks like a longer one, and without one like a garbled one.
    if session.with_checksum:
        return bool(replies) and replies[0].text is None and replies[0].characters == len("R\r")
    return bool(replies) and replies[0].text in ("RR", "BB")


def _other_checksum(session: Session) -> DriverFault:
    wanted, found = ("on", "off") if session.with_checksum else ("off", "on")
    return DriverFault(
        "config-mismatch",
        f"{session.name}: the switch CHS is {found}; option `checksum` says {wanted}",
        f"set the switch, and switch the unit off and on, or say `checksum: {str(not session.with_checksum).lower()}`",
    )


async def configure(unit: UnitState, options: Options, clock: Clock) -> bool:
    """Wait for what the unit does to end, and load what it needs; whether its volatile memory was lost before."""
    session = unit.session
    if await unit.rest(clock.now_ns() + round(options.busy_wait_s * NS_PER_S)) is None:
        raise DriverFault(
            "busy",
            f"{session.name} executes a program, and has not ended it within {options.busy_wait_s:g} s",
            "wait for its end, or stop it: `tutti stop`, its Stop input, or switch it off and on",
        )
    await _leave_programming(session)
    try:
        fresh = not await unit.holds_sentinel()
        # A factor that somebody has left would change every length (L3048-L3064).
        for command in ("con=1.0000", f"CS{options.standby_ma if unit.enabled else 0}", *_currents(options)):
            await session.tell(command)
        if fresh:
            unit.program = None
            await session.tell(f"R{SENTINEL_REGISTER}={SENTINEL}")
            if not await unit.holds_sentinel():
                raise DriverFault(
                    "config-mismatch",
                    f"{session.name}: register R{SENTINEL_REGISTER} does not hold {SENTINEL} after it was written",
                    "is it an SMC30?",
                )
        unit.rest_counts = await unit.position()
    except Busy:
        raise DriverFault("busy", f"{session.name} executes a program", "is somebody else using it?") from None
    except CannotDo as error:
        raise DriverFault(error.refusal.code, error.refusal.text, error.refusal.remedy) from None
    return fresh


def _currents(options: Options) -> list[str]:
    given = {"CR": options.ramp_ma, "CT": options.top_ma}
    return [f"{command}{milliamps}" for command, milliamps in given.items() if milliamps is not None]
