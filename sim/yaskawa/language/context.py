"""Who runs a command: the machine it acts on, and the thread or the port it came from."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.yaskawa.machine import Machine
    from sim.yaskawa.ports.ports import Port
    from sim.yaskawa.program.threads import Thread


@dataclass(slots=True)
class Context:
    """`thread` is None for a command from a port, `port` is None for one of a program."""

    machine: "Machine"
    thread: "Thread | None" = None
    port: "Port | None" = None
