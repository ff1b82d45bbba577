"""Registered positions of the controller, 20 of each kind (L7725, L7850): read here; set and approached by `send_raw`.

`PIT:SET,n` stores the stage position until power-off, and reads in present coordinates (L7712, L7731); `PAV:SET,n`
stores coordinate values in the main memory (L7831).
"""

from typing import Literal

from adapters.shrc203.replies import pulse_list
from adapters.shrc203.session import ShrcSession
from orchestrator.model.errors import Refusal

NUMBERS = range(1, 21)

PositionKind = Literal["place", "coordinates"]
_COMMANDS: dict[PositionKind, str] = {"place": "PIT", "coordinates": "PAV"}
_AXES = 3  # of all axes, including those that cannot be controlled


async def read_registered(session: ShrcSession, kind: PositionKind) -> dict[int, tuple[int, int, int]]:
    """Return the records of a kind by number, in pulses of motors 1 to 3; empty numbers are omitted.

    Raises `Refusal` while a completion line is outstanding, `ControllerFault`.
    """
    if session.expected_completions:
        raise Refusal("moving", "registered positions are read at rest only", "wait for the end of the move")
    found: dict[int, tuple[int, int, int]] = {}
    for number in NUMBERS:
        answer = await session.query_optional(f"{_COMMANDS[kind]}:GET,{number}", pulse_list(_AXES))
        if answer is not None:
            first, second, third = (int(each) for each in answer.split(","))
            found[number] = first, second, third
    return found
