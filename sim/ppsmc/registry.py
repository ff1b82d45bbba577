"""Definition of a command: its handler, when it is allowed, and the hardware that it needs."""

from dataclasses import dataclass
from enum import Enum, auto

from sim.ppsmc.unit import Handler


class CommandUsage(Enum):
    """State in which a command is allowed (its "usage" in the manual)."""

    ALWAYS = auto()
    NOT_PROGRAM = auto()
    """During positioning, but not during program execution."""
    IDLE = auto()


@dataclass(frozen=True, slots=True)
class CommandEntry:
    """One command.

    needs: hardware without which it is ignored (L215)."""

    run: Handler
    when: CommandUsage
    help: str
    needs: str | None = None
    names: tuple[str, ...] = ()
    """Its other names."""
    blocked: bool = False
    """Executed by a blocked controller too (L1404)."""
    later: bool = False
    """Supported by later firmware only (decision 0)."""


Commands = dict[str, CommandEntry]


def by_all_names(*tables: Commands) -> Commands:
    """Merge several tables of commands, including their aliases."""
    commands: Commands = {}
    for table in tables:
        for name, command in table.items():
            for alias in (name, *command.names):
                commands[alias] = command
    return commands
