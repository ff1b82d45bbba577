"""Mechanical origin return with completion lines (L2739-L2800)."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.contract import CannotDo
from adapters.shrc203 import fleetaxes
from adapters.shrc203.replies import STATUS, STOPS, AxisStatus, limit_stopped, status, triples
from adapters.shrc203.status import ERRORS, MECHANICAL_RETURN, why_stopped
from adapters.shrc203.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Controller

_LOOK_NS = 500 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class _Search:
    """One axis that looks for its origin. stops: how many it had been given before."""

    axis: str
    motor: int
    command: str
    stops: int


async def home(config: Controller, clock: Clock, unit: UnitState, axes: Sequence[str]) -> Mapping[str, CannotDo]:
    """Return `axes` to their origins, each for itself; the coordinate is 0 there. Gives those that have not got there.

    Raises `CannotDo` when none was begun.
    """
    session, restarts = unit.session, unit.restarts
    waiting = [_search(config, unit, name) for name in axes]
    failed: dict[str, CannotDo] = {}
    begun: set[int] = set()
    session.owe(set())
    try:
        while waiting:
            refused: list[_Search] = []
            running: list[_Search] = []
            for each in waiting:
                try:
                    await _begin(unit, each)
                except CannotDo as error:
                    failed[each.axis] = error
                    refused.append(each)
                else:
                    failed.pop(each.axis, None)
                    running.append(each)
                    begun.add(each.motor)
            if not running:
                break
            await _come_to_rest(clock, unit, running)
            failed |= await _judged(unit, running, restarts)
            # A unit may take no second axis while one moves (it is not said whose being busy counts).
            waiting = [each for each in refused if failed[each.axis].refusal.code == "refused"]
    except BaseException:
        # Nobody waits any more for those that look for it, nor for their completion lines.
        with suppress(LinkClosed):
            unit.brake(begun)
        session.abandon()
        raise
    session.owe_nothing()
    if failed and not begun:
        first = next(iter(failed.values())).refusal
        raise CannotDo(first.code, "; ".join(str(error) for error in failed.values()), first.remedy)
    return failed


def _search(config: Controller, unit: UnitState, name: str) -> _Search:
    axis = config.axes[name]
    motor = fleetaxes.motor(axis)
    command = f"HRT{fleetaxes.METHODS[axis.homing.method]}:{motor}"
    return _Search(name, motor, command, unit.stops_given(motor))


async def _begin(unit: UnitState, search: _Search) -> None:
    session, motor = unit.session, search.motor
    if not unit.excited.get(motor, True):
        raise CannotDo("not-enabled", f"axis {search.axis} is not enabled", f"enable {search.axis} first")
    await session.tell(f"GC:{motor}")
    unit.by_hand.discard(motor)
    session.owe(session.owed | {motor})
    try:
        await unit.set_going(search.command, search.axis, motor, search.stops)
    except CannotDo:
        session.owe(session.owed - {motor})
        raise


async def _come_to_rest(clock: Clock, unit: UnitState, running: Sequence[_Search]) -> None:
    while True:
        await unit.session.wait_changed(clock.now_ns() + _LOOK_NS)
        now = await _look(unit)
        if not any(now[each.motor].busy or now[each.motor].word & MECHANICAL_RETURN for each in running):
            return


async def _judged(unit: UnitState, running: Sequence[_Search], restarts: int) -> dict[str, CannotDo]:
    """Those of `running`, now at rest, that are not at their origin by all that the unit says."""
    now = await _look(unit)
    limited = limit_stopped(await unit.session.ask("SRQ:", STOPS))
    query, expected = unit.sentinel
    restarted = await unit.session.ask(query, triples(1)) != expected or unit.restarts != restarts
    failed: dict[str, CannotDo] = {}
    for each in running:
        axis, why = now[each.motor], ""
        if restarted:
            why = "the unit was restarted"
        elif unit.stops_given(each.motor) != each.stops:
            why = "it was stopped"
        elif axis.word & ERRORS or each.motor in limited:
            # A limit sensor may be where the coordinate happened to be 0 before.
            why = why_stopped(each.axis, axis) or "it was stopped by a limit sensor"
        elif axis.counts != 0:
            why = f"it stands at {axis.counts}, not at the origin"
        if why:
            failed[each.axis] = CannotDo(
                "homing-failed", f"axis {each.axis} has not found its origin: {why}", "look at its sensors"
            )
    return failed


async def _look(unit: UnitState) -> Mapping[int, AxisStatus]:
    return status(await unit.session.ask("Q:SPC", STATUS), unit.controllable)
