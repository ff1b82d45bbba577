"""Positions that are registered in the unit, 20 of each kind (L7725, L7850): read here, made and gone to by `raw`.

`PIT:SET,n` keeps the place of the stage until power-off, and reads in coordinates of now (L7712, L7731); `PAV:SET,n`
keeps coordinate values in the main memory (L7831).
"""

from typing import Literal

from adapters.contract import CannotDo
from adapters.shrc203.replies import amounts
from adapters.shrc203.session import Session

NUMBERS = range(1, 21)

Kind = Literal["place", "coordinates"]
_COMMANDS: dict[Kind, str] = {"place": "PIT", "coordinates": "PAV"}
_AXES = 3  # of all axes, also of those that can not be controlled


async def registered(session: Session, kind: Kind) -> dict[int, tuple[int, int, int]]:
    """The records of a kind by number, in pulses of motors 1 to 3; numbers without one are left out.

    Raises `CannotDo` while a completion line is owed, `DriverFault`.
    """
    if session.owed:
        raise CannotDo("moving", "registered positions are read at rest only", "wait for the end of the move")
    found: dict[int, tuple[int, int, int]] = {}
    for number in NUMBERS:
        answer = await session.ask_if_any(f"{_COMMANDS[kind]}:GET,{number}", amounts(_AXES))
        if answer is not None:
            first, second, third = (int(each) for each in answer.split(","))
            found[number] = first, second, third
    return found
