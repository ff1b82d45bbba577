"""Mechanical origin return with completion lines (L2739-L2800)."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.contract import CannotDo
from adapters.shrc203 import fleetaxes
from adapters.shrc203.replies import STATUS, STOPS, limit_stopped, status
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


async def home(
    config: Controller, clock: Clock, unit: UnitState, axes: Sequence[str], found: Callable[[str], None]
) -> Mapping[str, CannotDo]:
    """Return `axes` to their origins, each for itself; the coordinate is 0 there. Says at once which is there.

    Gives those that have not got there. Raises `CannotDo` when none was begun.
    """
    session = unit.session
    waiting = [_search(config, unit, name) for name in axes]
    failed: dict[str, CannotDo] = {}
    begun = False
    running: list[_Search] = []
    session.owe(set())
    try:
        while waiting:
            refused: list[_Search] = []
            for each in waiting:
                try:
                    await _begin(unit, each)
                except CannotDo as error:
                    failed[each.axis] = error
                    refused.append(each)
                else:
                    failed.pop(each.axis, None)
                    running.append(each)
            if not running:
                break
            begun = True
            while running:
                await session.wait_changed(clock.now_ns() + _LOOK_NS)
                for each, error in await _ended(unit, running):
                    running.remove(each)
                    if error is None:
                        found(each.axis)
                    else:
                        failed[each.axis] = error
            # A unit may take no second axis while one moves (it is not said whose being busy counts).
            waiting = [each for each in refused if failed[each.axis].refusal.code == "refused"]
    except BaseException:
        # Nobody waits any more for those that look for it, nor for their completion lines.
        with suppress(LinkClosed):
            unit.brake(each.motor for each in running)
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


async def _ended(unit: UnitState, running: Sequence[_Search]) -> list[tuple[_Search, CannotDo | None]]:
    """Those of `running` that have come to rest, with what has become of them by all that the unit says."""
    session = unit.session
    now = status(await session.ask("Q:SPC", STATUS), unit.controllable)
    ended = [each for each in running if not (now[each.motor].busy or now[each.motor].word & MECHANICAL_RETURN)]
    if not ended:
        return []
    limited = limit_stopped(await session.ask("SRQ:", STOPS))
    restarted = await unit.is_restarted()
    judged: list[tuple[_Search, CannotDo | None]] = []
    for each in ended:
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
        text = f"axis {each.axis} has not found its origin: {why}"
        judged.append((each, CannotDo("homing-failed", text, "look at its sensors") if why else None))
    return judged
