"""Mechanical origin return with completion lines (L2739-L2800)."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.shrc203 import fleetaxes
from adapters.shrc203.status import ERRORS, MECHANICAL_RETURN, stop_reason
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import STATUS, STOPS, parse_limit_stops, parse_status
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller

_POLL_NS = 500 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class _OriginSearch:
    """One axis that is searching for its origin. stops: its number of stops before the search."""

    axis: str
    motor: int
    command: str
    stops: int


async def home_axes(
    config: Controller, clock: Clock, unit: ShrcState, axes: Sequence[str], found: Callable[[str], None]
) -> Mapping[str, Refusal]:
    """Return `axes` to their origins, independently of each other; the coordinate is 0 there. Report each success at
    once.

    Return the axes that failed, with reasons. Raises `Refusal` when no axis began.
    """
    session = unit.session
    waiting = [_make_search(config, unit, name) for name in axes]
    failed: dict[str, Refusal] = {}
    begun = False
    running: list[_OriginSearch] = []
    session.expect_completions(set())
    try:
        while waiting:
            refused: list[_OriginSearch] = []
            for each in waiting:
                try:
                    await _begin_search(unit, each)
                except Refusal as error:
                    failed[each.axis] = error
                    refused.append(each)
                else:
                    failed.pop(each.axis, None)
                    running.append(each)
            if not running:
                break
            begun = True
            while running:
                await session.wait_changed(clock.now_ns() + _POLL_NS)
                for each, error in await _finished_searches(unit, running):
                    running.remove(each)
                    if error is None:
                        found(each.axis)
                    else:
                        failed[each.axis] = error
            # A controller may refuse a second axis while one moves (the manual does not state whose busy state counts).
            waiting = [each for each in refused if failed[each.axis].code == "refused"]
    except BaseException:
        # After a cancellation nothing waits for the searching axes or their completion lines.
        with suppress(LinkClosed):
            unit.brake_motors(each.motor for each in running)
        session.abandon_completions()
        raise
    session.expect_no_completion()
    if failed and not begun:
        first = next(iter(failed.values()))
        raise Refusal(first.code, "; ".join(str(error) for error in failed.values()), first.remedy)
    return failed


def _make_search(config: Controller, unit: ShrcState, name: str) -> _OriginSearch:
    axis = config.axes[name]
    motor = fleetaxes.motor_number(axis)
    command = f"HRT{fleetaxes.METHODS[axis.homing.method]}:{motor}"
    return _OriginSearch(name, motor, command, unit.stops.stop_count(motor))


async def _begin_search(unit: ShrcState, search: _OriginSearch) -> None:
    session, motor = unit.session, search.motor
    if not unit.excited.get(motor, True):
        raise Refusal("not-enabled", f"axis {search.axis} is not enabled", f"enable {search.axis} first")
    await session.send_setting(f"GC:{motor}")
    unit.jogging_motors.discard(motor)
    session.expect_completions(session.expected_completions | {motor})
    try:
        await unit.start_motion(search.command, search.axis, motor, search.stops)
    except Refusal:
        session.expect_completions(session.expected_completions - {motor})
        raise


async def _finished_searches(
    unit: ShrcState, running: Sequence[_OriginSearch]
) -> list[tuple[_OriginSearch, Refusal | None]]:
    """Return those of `running` that have come to rest, each with its failure, or None, from everything that the
    controller reports."""
    session = unit.session
    now = parse_status(await session.send_query("Q:SPC", STATUS), unit.controllable)
    ended = [each for each in running if not (now[each.motor].is_busy or now[each.motor].word & MECHANICAL_RETURN)]
    if not ended:
        return []
    limited = parse_limit_stops(await session.send_query("SRQ:", STOPS))
    restarted = await unit.is_restarted()
    judged: list[tuple[_OriginSearch, Refusal | None]] = []
    for each in ended:
        axis, why = now[each.motor], ""
        if restarted:
            why = "the controller was restarted"
        elif unit.stops.stop_count(each.motor) != each.stops:
            why = "it was stopped"
        elif axis.word & ERRORS or each.motor in limited:
            # A limit sensor may be at a position whose coordinate was 0 before.
            why = stop_reason(each.axis, axis) or "it was stopped by a limit sensor"
        elif axis.counts != 0:
            why = f"it is at {axis.counts}, not at the origin"
        text = f"axis {each.axis} has not found its origin: {why}"
        judged.append((each, Refusal("homing-failed", text, "check its sensors") if why else None))
    return judged
