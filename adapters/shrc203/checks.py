"""Checks before a move is armed and before it is started: the axes, and what the controller has loaded."""

from collections.abc import Mapping

from adapters.shrc203.lowering import ShrcAxisMove, ShrcLowered
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import STATUS, axis_argument, parse_status
from adapters.shrc203.wire.status import ERRORS, stop_reason
from orchestrator.model.errors import Refusal


async def check_rest(unit: ShrcState, moves: tuple[ShrcAxisMove, ...]) -> None:
    """Raise `Refusal` unless all axes are at rest, without errors, where the plan starts."""
    states = parse_status(await unit.session.send_query("Q:SPC", STATUS), unit.controllable)
    for move in moves:
        axis = states[move.motor]
        if axis.is_busy:
            raise Refusal("moving", f"axis {move.name} is moving", "wait for its end, or stop it")
        if axis.word & ERRORS:
            raise Refusal("fault", stop_reason(move.name, axis), "clear it with `tutti reset`")
        if axis.counts != move.start_counts:
            raise Refusal(
                "other-start",
                f"axis {move.name} is at {axis.counts} counts; the plan starts at {move.start_counts}",
                "plan again from the present position",
            )


async def check_loaded(unit: ShrcState, lowered: ShrcLowered) -> None:
    """Raise `Refusal` unless the prebuffers contain exactly the loaded move."""
    straight = lowered.straight
    if straight is not None:
        dangerous_motors = await unit.prebuffers.find_dangerous(interpolation=straight.loaded_reply)
    else:
        dangerous_motors = await unit.prebuffers.find_dangerous(
            {first_move.motor: first_move.distance for first_move in lowered.first_moves}
        )
    if dangerous_motors:
        raise Refusal(
            "not-loaded",
            f"the prebuffer of axis {axis_argument(dangerous_motors)} does not contain the loaded move",
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
    for first_move in lowered.first_moves:
        if found[first_move.motor] != first_move.distance:
            raise Refusal(
                "not-loaded",
                f"axis {first_move.name}: {found[first_move.motor]} pulses are loaded instead of {first_move.distance}",
                "arm it again; was the controller switched off?",
            )


async def check_prebuffers(unit: ShrcState, lowered: ShrcLowered) -> None:
    """Check that the prebuffers still hold the move. Raises `Refusal`."""
    if lowered.straight is not None:
        compare_path(lowered.straight.loaded_reply, await unit.prebuffers.read_interpolation())
    else:
        compare_moves(lowered, await unit.prebuffers.read_moves())
