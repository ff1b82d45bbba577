"""Mechanical origin return with completion lines (L2739-L2800)."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.shrc203 import fleetaxes
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import STATUS, STOPS, parse_limit_stops, parse_status
from adapters.shrc203.wire.status import ERRORS, MECHANICAL_RETURN, stop_reason
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
    pending_searches = [_make_search(config, unit, name) for name in axes]
    failures: dict[str, Refusal] = {}
    has_begun = False
    begun_searches: list[_OriginSearch] = []
    session.completions.expect(set())
    try:
        while pending_searches:
            refused_searches: list[_OriginSearch] = []
            for search in pending_searches:
                try:
                    await _begin_search(unit, search)
                except Refusal as error:
                    failures[search.axis] = error
                    refused_searches.append(search)
                else:
                    failures.pop(search.axis, None)
                    begun_searches.append(search)
            if not begun_searches:
                break
            has_begun = True
            while begun_searches:
                await session.wait_changed(clock.now_ns() + _POLL_NS)
                for search, error in await _finished_searches(unit, begun_searches):
                    begun_searches.remove(search)
                    if error is None:
                        found(search.axis)
                    else:
                        failures[search.axis] = error
            # A controller may refuse a second axis while one moves (the manual does not state whose busy state counts).
            pending_searches = [search for search in refused_searches if failures[search.axis].code == "refused"]
    except BaseException:
        # After a cancellation nothing waits for the searching axes or their completion lines.
        with suppress(LinkClosed):
            unit.brake_motors(search.motor for search in begun_searches)
        session.completions.abandon()
        raise
    session.completions.expect_none()
    if failures and not has_begun:
        first = next(iter(failures.values()))
        raise Refusal(first.code, "; ".join(str(error) for error in failures.values()), first.remedy)
    return failures


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
    session.completions.expect(session.completions.expected | {motor})
    try:
        await unit.start_motion(search.command, search.axis, motor, search.stops)
    except Refusal:
        session.completions.expect(session.completions.expected - {motor})
        raise


async def _finished_searches(
    unit: ShrcState, running: Sequence[_OriginSearch]
) -> list[tuple[_OriginSearch, Refusal | None]]:
    """Return those of `running` that have come to rest, each with its failure, or None, from everything that the
    controller reports."""
    session = unit.session
    states = parse_status(await session.send_query("Q:SPC", STATUS), unit.controllable)
    ended_searches = [
        search
        for search in running
        if not (states[search.motor].is_busy or states[search.motor].word & MECHANICAL_RETURN)
    ]
    if not ended_searches:
        return []
    limit_motors = parse_limit_stops(await session.send_query("SRQ:", STOPS))
    is_restarted = await unit.is_restarted()
    results: list[tuple[_OriginSearch, Refusal | None]] = []
    for search in ended_searches:
        axis, reason = states[search.motor], ""
        if is_restarted:
            reason = "the controller was restarted"
        elif unit.stops.stop_count(search.motor) != search.stops:
            reason = "it was stopped"
        elif axis.word & ERRORS or search.motor in limit_motors:
            # A limit sensor may be at a position whose coordinate was 0 before.
            reason = stop_reason(search.axis, axis) or "it was stopped by a limit sensor"
        elif axis.counts != 0:
            reason = f"it is at {axis.counts}, not at the origin"
        text = f"axis {search.axis} has not found its origin: {reason}"
        results.append((search, Refusal("homing-failed", text, "check its sensors") if reason else None))
    return results
