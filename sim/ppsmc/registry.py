"""What a command is: its handler, when it is allowed, and the hardware that it needs."""

from dataclasses import dataclass
from enum import Enum, auto

from sim.ppsmc.unit import Handler


class When(Enum):
    """During what a command is allowed (its "usage" in the manual)."""

    ALWAYS = auto()
    NOT_PROGRAM = auto()
    """During positioning, but not during program execution."""
    IDLE = auto()


@dataclass(frozen=True, slots=True)
class Command:
    """One command. `needs`: hardware without which it is ignored (L215)."""

    run: Handler
    when: When
    help: str
    needs: str | None = None
    names: tuple[str, ...] = ()
    """Its other names."""
    blocked: bool = False
    """Carried out by a blocked unit too (L1404)."""
    later: bool = False
    """Known to later firmware only (decision 0)."""


Commands = dict[str, Command]


def by_all_names(*tables: Commands) -> Commands:
    """The commands of several tables, under their aliases too."""
    found: Commands = {}
    for table in tables:
        for name, command in table.items():
            for one in (name, *command.names):
                found[one] = command
    return found
