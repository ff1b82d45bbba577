"""Origin of a command: the machine it acts on, and the thread or the port that sent it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.yaskawa.machine import ControllerCore
    from sim.yaskawa.ports.ports import PortSession
    from sim.yaskawa.program.threads import ProgramThread


@dataclass(slots=True)
class CommandContext:
    """`thread` is None for a command from a port, `port` is None for one of a program."""

    machine: "ControllerCore"
    thread: "ProgramThread | None" = None
    port: "PortSession | None" = None
