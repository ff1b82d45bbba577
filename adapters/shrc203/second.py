"""The second of two moves: loaded behind the first one while that runs, which the unit then begins by itself (L179)."""

from collections.abc import Callable

from adapters.contract import CannotDo, DriverFault
from adapters.shrc203.lowering import ShrcLowered
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
    for each in lowered.seconds:
        if not now[each.motor].busy:
            return why_stopped(each.name, now[each.motor]) or too_late(each.name, now[each.motor].counts)
    return ""


def too_late(axis: str, counts: int) -> str:
    """The first move had ended before the second was there."""
    return f"axis {axis} stands at {counts}, between its two moves: the second one came too late"
