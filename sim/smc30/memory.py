"""Working memory, user registers and the permanent memory (L1217-L1358, L3635-L3641)."""

from dataclasses import dataclass, field

from sim.smc30.operands import LAST_REGISTER
from sim.smc30.refusal import StatementRefused
from sim.smc30.statements import StoredLine

PROGRAM_BYTES = 8186


@dataclass(slots=True)
class UserRegisters:
    """R1-R510, 16 bit unsigned; R0 reads as 0."""

    values: dict[int, int] = field(default_factory=dict[int, int])

    def read_register(self, number: int) -> int:
        return self.values.get(number, 0)

    def write_register(self, number: int, value: int) -> None:
        if not 1 <= number <= LAST_REGISTER:
            raise StatementRefused("E4")
        self.values[number] = value


@dataclass(slots=True)
class WorkingMemory:
    """The program being built or executed; lost with the power (L1261-L1271)."""

    lines: list[StoredLine] = field(default_factory=list[StoredLine])
    used: int = 0

    def clear_program(self) -> None:
        self.lines = []
        self.used = 0

    def append_line(self, line: StoredLine) -> None:
        """Append a line; E3 when the program would exceed 8186 bytes (L3640)."""
        if self.used + line.statement.size > PROGRAM_BYTES:
            raise StatementRefused("E3")
        self.lines.append(line)
        self.used += line.statement.size

    def load_program(self, lines: list[StoredLine]) -> None:
        self.lines = list(lines)
        self.used = sum(line.statement.size for line in lines)


@dataclass(slots=True)
class PermanentMemory:
    """The E2PROM: one program (L1870) and the registers that I6 has stored."""

    program: list[StoredLine] = field(default_factory=list[StoredLine])
    registers: dict[int, int] = field(default_factory=dict[int, int])

    def save_program(self, working: WorkingMemory) -> None:
        """Store the program of the working memory."""
        self.program = list(working.lines)

    def recall_program(self, working: WorkingMemory) -> None:
        """Load the stored program into the working memory."""
        working.load_program(self.program)
