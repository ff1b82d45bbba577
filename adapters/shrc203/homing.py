"""Mechanical origin return with completion lines (L2739-L2800)."""

from collections.abc import Mapping, Sequence

from adapters.contract import CannotDo
from adapters.shrc203 import fleetaxes
from adapters.shrc203.axes import letter
from adapters.shrc203.replies import STATUS, status
from adapters.shrc203.status import ERRORS, MECHANICAL_RETURN, why_stopped
from adapters.shrc203.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.model.fleet import Controller

_LOOK_NS = 500 * NS_PER_MS


async def home(config: Controller, clock: Clock, unit: UnitState, axes: Sequence[str]) -> Mapping[str, CannotDo]:
    """Return `axes` to their origins, those of one method together; the coordinate is 0 there. Gives the failed."""
    groups: dict[str, dict[int, str]] = {}
    for name in axes:
        axis = config.axes[name]
        groups.setdefault(fleetaxes.METHODS[axis.homing.method], {})[fleetaxes.motor(axis)] = name
    failed: dict[str, CannotDo] = {}
    for method, members in groups.items():
        failed |= await _return(clock, unit, method, members)
    return failed


async def _return(clock: Clock, unit: UnitState, method: str, members: dict[int, str]) -> dict[str, CannotDo]:
    session = unit.session
    await session.tell(f"GC:{letter(members)}")
    session.owe(set(members))
    try:
        await session.tell(f"HRT{method}:{letter(members)}")
        while session.owed:
            await session.wait_changed(clock.now_ns() + _LOOK_NS)
            now = status(await session.ask("Q:SPC", STATUS), unit.controllable)
            if not any(now[motor].busy or now[motor].word & MECHANICAL_RETURN for motor in members):
                break
    finally:
        session.owe_nothing()
    now = status(await session.ask("Q:SPC", STATUS), unit.controllable)
    failed: dict[str, CannotDo] = {}
    for motor, name in members.items():
        axis = now[motor]
        if axis.word & ERRORS or axis.counts != 0:
            why = why_stopped(name, axis) or f"it stands at {axis.counts}, not at the origin"
            failed[name] = CannotDo(
                "homing-failed", f"axis {name} has not found its origin: {why}", "look at its sensors"
            )
    return failed
