"""The follow-up move: loaded while the first move runs; the controller then begins it by itself (L179)."""

from collections.abc import Callable

from adapters.shrc203.lowering import ShrcAxisMove, ShrcLowered
from adapters.shrc203.replies import STATUS, parse_status
from adapters.shrc203.status import stop_reason
from adapters.shrc203.unitstate import ShrcState
from orchestrator.model.errors import ControllerFault, Refusal

_TRIES = 2  # a command that was garbled in transit is overwritten by a repetition


async def load_followup_moves(unit: ShrcState, lowered: ShrcLowered, before_send: Callable[[], None]) -> str:
    """Load the follow-up moves of a step and read them back; return why they will not run as planned, "" if they will.

    before_send: called before anything is sent; raises `Refusal` when the step is stopped.
    """
    wrong = ""
    for _ in range(_TRIES):
        try:
            heard = await unit.session.set_and_echo(lowered.load_followup, before_send)
        except (Refusal, ControllerFault) as error:
            wrong = str(error)
            continue
        if heard == lowered.load_followup:
            break
        wrong = f"sent {lowered.load_followup!r}, the controller has understood {heard!r}"
    else:
        return f"the follow-up move could not be loaded: {wrong}"
    now = parse_status(await unit.session.send_query("Q:SPC", STATUS), unit.controllable)
    for each in lowered.moves:
        if len(each.executed_moves) > 1 and not now[each.motor].is_busy:
            return stop_reason(each.name, now[each.motor]) or stray_text(each, now[each.motor].counts)
    return ""


def stray_text(axis: ShrcAxisMove, counts: int) -> str:
    """Return why an axis is not at its target, judged by its position."""
    _, *more = axis.executed_moves
    if more and counts == more[0].start_counts:
        return f"axis {axis.name} is at {counts}, between its two moves: the follow-up move came too late"
    return f"axis {axis.name} is at {counts}, not at its target"
