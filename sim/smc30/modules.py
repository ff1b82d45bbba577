"""External modules on the RS485 interface, as far as the device communicates with them (L1094-L1180, L3116-L3370)."""

from sim.smc30.options import IndexerOptions
from sim.smc30.refusal import StatementRefused
from sim.smc30.statements import PrintText, ReadInput, SetFlag


class ExternalModules:
    """Registers, flags and displayed texts of the modules present. Data for an absent one is lost."""

    def __init__(self, options: IndexerOptions) -> None:
        self._registers = {address: dict(content) for address, content in options.modules.items()}
        self.flags: set[tuple[int, int]] = set()
        """Flags set, as module address and flag number."""
        self.shown: dict[tuple[int, int], str] = {}
        """Last printed text, by module address and register or cursor position."""

    def set_flag(self, statement: SetFlag) -> None:
        """Execute AO and CO."""
        if statement.module in self._registers:
            key = (statement.module, statement.flag)
            if statement.on:
                self.flags.add(key)
            else:
                self.flags.discard(key)

    def show_text(self, statement: PrintText, text: str) -> None:
        """Execute PRINT to a module; a number is also stored in the register, if the module has it."""
        registers = self._registers.get(statement.module)
        if registers is None:
            return
        self.shown[statement.module, statement.place] = text
        if statement.place in registers and not isinstance(statement.what, str):
            registers[statement.place] = int(text)

    def read_input(self, statement: ReadInput) -> int:
        """Execute INPUT; an absent module or a failed range check ends the program (L3284-L3286)."""
        value = self._registers.get(statement.module, {}).get(statement.register)
        if value is None:
            raise StatementRefused("E4")
        if statement.allowed is not None and not statement.allowed[0] <= value <= statement.allowed[1]:
            raise StatementRefused("E4")
        return value
