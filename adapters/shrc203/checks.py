"""Checks before a move is armed and before it is started: the axes, and what the controller has loaded."""

from collections.abc import Mapping

from adapters.shrc203.lowering import ShrcAxisMove, ShrcLowered
from adapters.shrc203.status import ERRORS, stop_reason
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import STATUS, axis_argument, parse_status
from orchestrator.model.errors import Refusal


async def check_rest(unit: ShrcState, moves: tuple[ShrcAxisMove, ...]) -> None:
    """Raise `Refusal` unless all axes are at rest, without errors, where the plan starts."""
    now = parse_status(await unit.session.send_query("Q:SPC", STATUS), unit.controllable)
    for each in moves:
        axis = now[each.motor]
        if axis.is_busy:
            raise Refusal("moving", f"axis {each.name} is moving", "wait for its end, or stop it")
        if axis.word & ERRORS:
            raise Refusal("fault", stop_reason(each.name, axis), "clear it with `tutti reset`")
        if axis.counts != each.start_counts:
            raise Refusal(
                "other-start",
                f"axis {each.name} is at {axis.counts} counts; the plan starts at {each.start_counts}",
                "plan again from the present position",
            )


async def check_loaded(unit: ShrcState, lowered: ShrcLowered) -> None:
    """Raise `Refusal` unless the prebuffers contain exactly the loaded move."""
    straight = lowered.straight
    if straight is not None:
        others = await unit.prebuffers.find_dangerous(interpolation=straight.loaded_reply)
    else:
        others = await unit.prebuffers.find_dangerous({each.motor: each.distance for each in lowered.first_moves})
    if others:
        raise Refusal(
            "not-loaded",
            f"the prebuffer of axis {axis_argument(others)} does not contain the loaded move",
            "arm it again",
        )


def compare_path(meant: str, found: str) -> None:
    """Raise `Refusal` when another path is loaded."""
    if found != meant:
        raise Refusal(
            "not-loaded",
            f"the path {found} is loaded instead of {meant}",
            "arm it again; was the controller switched off?",
        )


def compare_moves(lowered: ShrcLowered, found: Mapping[int, int | None]) -> None:
    """Raise `Refusal` when another distance is loaded for an axis."""
    for each in lowered.first_moves:
        if found[each.motor] != each.distance:
            raise Refusal(
                "not-loaded",
                f"axis {each.name}: {found[each.motor]} pulses are loaded instead of {each.distance}",
                "arm it again; was the controller switched off?",
            )
