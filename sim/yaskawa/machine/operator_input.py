"""Serial input of programs: the keywords of operator data entry, and answers to IN."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.context import CommandContext, CommandMachine
from sim.yaskawa.language.expressions import compile_expression
from sim.yaskawa.language.machine import CommandOrigin
from sim.yaskawa.program.entry import OperatorEntry


class OperatorInput:
    """Input of the two serial ports that programs read."""

    def __init__(self, machine: CommandMachine) -> None:
        self._machine = machine
        self.entries = {name: OperatorEntry() for name in ("S", "2")}

    def store_serial_input(self, text: str) -> None:
        """Store the last character for `P1CH` (SMC-4000: L12105)."""
        self.entries["S"].note_characters(text)

    def read_keyword(self, name: str) -> int:
        """`P1CH`, `P2NM`, …: return the value received on a serial port."""
        return self.entries["S" if name[1] == "1" else "2"].read_item(name[2:])

    def accept_input(self, port: CommandOrigin, line: str) -> bool:
        """Return whether `line` answers an IN (SMC-4000: L6101, SMC-2000: L9352)."""
        main = self._machine.programs.threads[0]
        if port.kind != "serial" or not main.input_for or main.input_port != port.name:
            return False
        name, main.input_for = main.input_for, ""
        text = line.split(";")[0]
        if text:
            try:
                self._assign_input(name, self._input_value(text, main.input_length))
            except (ValueError, CommandError):
                self._machine.refuse_command(83)
        return True

    def _assign_input(self, name: str, raw: int) -> None:
        array, bracket, index = name.partition("[")
        if bracket:
            element = compile_expression(index.removesuffix("]"))(
                CommandContext(self._machine, self._machine.programs.threads[0])
            )
            self._machine.data.store_element(array, fixed.to_integer(element), raw)
        else:
            self._machine.data.assign_variable(name, raw)

    def _input_value(self, text: str, length: int) -> int:
        """Parse a number, or with `length` (of `{Sn}`), or when it is not a number, a string."""
        try:
            if not length:
                return fixed.parse_literal(text.removeprefix("-")) * (-1 if text.startswith("-") else 1)
        except ValueError:
            pass
        return fixed.from_string(text[: length or fixed.STRING_LENGTH])
