"""A command while it runs: the machine it acts on, the thread or the port that sent it, and its outcome."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from sim.yaskawa.base.data import VariableStore
from sim.yaskawa.base.options import FamilyOptions
from sim.yaskawa.io.network import NetworkHost
from sim.yaskawa.io.points import IoPoints
from sim.yaskawa.language.machine import (
    AnswerFormats,
    AxisNames,
    CommandOrigin,
    MachineSettings,
    NonvolatileMemory,
    OpenPorts,
    OperatorKeywords,
    ProgramControl,
)
from sim.yaskawa.language.properties import ModelProperties
from sim.yaskawa.motion.trippoints import TripMachine, TripPoint
from sim.yaskawa.program.program import StoredProgram
from sim.yaskawa.program.threads import ProgramThread


class RecordingControl(Protocol):
    """The data recorder as `RA`, `RD` and `RC` use it."""

    arrays: list[str]
    sources: "list[Evaluator]"

    @property
    def index(self) -> int: ...

    @property
    def running(self) -> bool: ...

    def start_recording(self, exponent: int, records: int | None, now: int) -> None:
        """`RC n,m`; n 0 stops."""
        ...

    def record_due(self, now: int) -> None:
        """Record the values that are due."""
        ...


class CommandMachine(NetworkHost, TripMachine, MachineSettings, AxisNames, AnswerFormats, Protocol):
    """The machine as commands see it."""

    retry_time: int

    @property
    def model(self) -> ModelProperties: ...

    @property
    def options(self) -> FamilyOptions: ...

    @property
    def io(self) -> IoPoints: ...

    @property
    def data(self) -> VariableStore: ...

    @property
    def program(self) -> StoredProgram: ...

    @property
    def programs(self) -> ProgramControl: ...

    @property
    def ports(self) -> OpenPorts: ...

    @property
    def memory(self) -> NonvolatileMemory: ...

    @property
    def operator_input(self) -> OperatorKeywords: ...

    @property
    def recorder(self) -> RecordingControl: ...

    @property
    def revision_text(self) -> str:
        """The text that ctrl-R ctrl-V reports."""
        ...

    def current_sample(self) -> int:
        """Present sample."""
        ...

    def time_counter(self) -> int:
        """`TIME`."""
        ...

    def compile_operand(self, text: str) -> "Evaluator":
        """Return the function that reads `_XX…`; 58 when there is no such operand."""
        ...

    def is_locked_command(self, op: str, lock: str, text: str) -> bool:
        """Return whether `LC` forbids a command from a port."""
        ...

    def abort_motion(self, code: int, *, halt: bool) -> None:
        """`AB` and the abort input: everything freezes."""
        ...

    def reset_controller(self) -> None:
        """`RS` and power-up: restore the burned state."""
        ...

    def handle_rescheduling(self) -> None:
        """Handle a change of the sample length: the next sample is due at another instant."""
        ...


@dataclass(slots=True)
class CommandContext:
    """`thread` is None for a command from a port, `port` is None for one of a program."""

    machine: CommandMachine
    thread: ProgramThread | None = None
    port: CommandOrigin | None = None


Evaluator = Callable[[CommandContext], int]
"""Reads a value, raw."""
Outcome = str | TripPoint | None
"""Result of a command: text to answer, a condition to wait for, or only the prompt."""
Runner = Callable[[CommandContext], Outcome]


@dataclass(frozen=True, slots=True)
class CommandDefinition:
    """One op-code.

    compile: from its argument text.
    where: `both`, `program` or `line`; lock: see `LC` (L6735)."""

    compile: Callable[[str], Runner]
    where: str = "both"
    lock: str = ""
