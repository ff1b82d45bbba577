"""Connection to a controller: its identity, its settings against the fleet file, and the absence of other clients."""

import re

from adapters.smc30.frames import ReceivedReply, frame_line
from adapters.smc30.line import ExchangeDisturbed
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.session import ControllerBusy, Smc30Session
from adapters.smc30.unitstate import EITHER, NO_CONVERSION, SENTINEL, SENTINEL_REGISTER, STATUS, Smc30State
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.errors import ControllerFault, Refusal

TOP_RATE = re.compile(r"T\d{2,5}|B")


async def verify_identity(unit: Smc30State) -> None:
    """Verify that an SMC30 answers with the required switch settings; leave Programming Mode. Nothing is stopped."""
    session = unit.session
    try:
        answer = await session.send_query("F", STATUS)
    except (ControllerFault, Refusal) as error:
        if isinstance(error, ControllerFault) and await _answers_otherwise(session):
            raise _other_checksum(session) from None
        if isinstance(error, ControllerFault):
            raise
        raise ControllerFault(error.code, error.text, "is it an SMC30?") from None
    if answer.text == "B":
        return
    await _leave_programming(session)
    try:
        await session.send_query("VT", TOP_RATE)
    except ControllerBusy:
        return
    except Refusal as error:
        text = f"{error.text}; an SMC30 reports its top rate"
        raise ControllerFault("wrong-make", text, "check adapter and link") from None


async def _leave_programming(session: Smc30Session) -> None:
    """Send PX; in Standby it is refused or has no effect (L1893-L1899)."""
    try:
        await session.send_query("PX", EITHER)
    except ControllerBusy:
        return
    except Refusal as error:
        raise ControllerFault(error.code, error.text, error.remedy) from None


async def _answers_otherwise(session: Smc30Session) -> bool:
    """Return whether the controller answers F in the other format, with or without a checksum."""
    query = frame_line("F", session.unit, with_checksum=not session.with_checksum)

    def any_reply(replies: list[ReceivedReply]) -> bool:
        return bool(replies)

    try:
        _, replies = await session.line.run_exchange(session.unit, query, any_reply)
    except (ControllerFault, ExchangeDisturbed):
        return False
    # With its checksum a reply looks like a longer one, and without one like a garbled one.
    if session.with_checksum:
        return bool(replies) and replies[0].text is None and replies[0].characters == len("R\r")
    return bool(replies) and replies[0].text in ("RR", "BB")


def _other_checksum(session: Smc30Session) -> ControllerFault:
    option_state, checksum_state = ("on", "off") if session.with_checksum else ("off", "on")
    return ControllerFault(
        "config-mismatch",
        f"{session.name}: the switch CHS is {checksum_state}; option `checksum` requires {option_state}",
        "set the switch, and switch the controller off and on, or set `checksum: "
        f"{str(not session.with_checksum).lower()}`",
    )


async def configure_controller(unit: Smc30State, options: Smc30DriverOptions, clock: Clock) -> bool:
    """Wait for the end of the controller's activity, and load the required settings; return whether its volatile memory
    had been lost."""
    session = unit.session
    if await unit.wait_until_ready(clock.now_ns() + round(options.busy_wait_s * NS_PER_S)) is None:
        raise ControllerFault(
            "busy",
            f"{session.name} executes a program, and has not ended it within {options.busy_wait_s:g} s",
            "wait for its end, or stop it: `tutti stop`, its Stop input, or switch it off and on",
        )
    await _leave_programming(session)
    try:
        fresh = not await unit.holds_sentinel()
        # A factor left by another client would change every length (L3048-L3064).
        for command in (NO_CONVERSION, *current_commands(options, enabled=unit.enabled)):
            await session.send_setting(command)
        if fresh:
            unit.program = None
            await session.send_setting(f"R{SENTINEL_REGISTER}={SENTINEL}")
            if not await unit.holds_sentinel():
                raise ControllerFault(
                    "config-mismatch",
                    f"{session.name}: register R{SENTINEL_REGISTER} does not contain {SENTINEL} after it was written",
                    "is it an SMC30?",
                )
        unit.rest_counts = await unit.read_position()
    except ControllerBusy:
        raise ControllerFault("busy", f"{session.name} executes a program", "does another client use it?") from None
    except Refusal as error:
        raise ControllerFault(error.code, error.text, error.remedy) from None
    return fresh


def current_commands(options: Smc30DriverOptions, *, enabled: bool) -> list[str]:
    """Return the commands that set the motor's currents (L1996-L2008)."""
    currents_ma = {"CS": options.standby_ma if enabled else 0, "CR": options.ramp_ma, "CT": options.top_ma}
    return [f"{command}{milliamps}" for command, milliamps in currents_ma.items() if milliamps is not None]
