"""The second of two moves: loaded behind the first one while that runs, which the unit then begins by itself (L179)."""

from collections.abc import Callable

from adapters.contract import CannotDo, DriverFault
from adapters.shrc203.lowering import AxisMove, ShrcLowered
from adapters.shrc203.replies import STATUS, status
from adapters.shrc203.status import why_stopped
from adapters.shrc203.unitstate import UnitState

_TRIES = 2  # a line that went wrong on its way is overwritten by the same line


async def load_second(unit: UnitState, lowered: ShrcLowered, still: Callable[[], None]) -> str:
    """Load the second moves of a step and read them back; why they will not run as they should, "" if they will.

    still: called before anything is sent; raises `CannotDo` when the step is stopped.
    """
    wrong = ""
    for _ in range(_TRIES):
        try:
            heard = await unit.session.tell_and_hear(lowered.load_second, still)
        except (CannotDo, DriverFault) as error:
            wrong = str(error)
            continue
        if heard == lowered.load_second:
            break
        wrong = f"sent {lowered.load_second!r}, the unit has understood {heard!r}"
    else:
        return f"the second of two moves could not be loaded: {wrong}"
    now = status(await unit.session.ask("Q:SPC", STATUS), unit.controllable)
    for each in lowered.moves:
        if len(each.pieces) > 1 and not now[each.motor].busy:
            return why_stopped(each.name, now[each.motor]) or astray(each, now[each.motor].counts)
    return ""


def astray(axis: AxisMove, counts: int) -> str:
    """Why an axis is not at its target, by where it stands."""
    _, *more = axis.pieces
    if more and counts == more[0].start_counts:
        return f"axis {axis.name} stands at {counts}, between its two moves: the second one came too late"
    return f"axis {axis.name} stands at {counts}, not at its target"
