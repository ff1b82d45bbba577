"""External modules on the RS485 interface, as far as the unit sees them (L1094-L1180, L3116-L3370)."""

from sim.smc30.options import UnitOptions
from sim.smc30.refusal import Refused
from sim.smc30.statements import Flag, Input, Print


class Modules:
    """Registers, flags and shown texts of the modules that exist. What goes to an absent one is lost."""

    def __init__(self, options: UnitOptions) -> None:
        self._registers = {address: dict(content) for address, content in options.modules.items()}
        self.flags: set[tuple[int, int]] = set()
        """Flags set, as module address and flag number."""
        self.shown: dict[tuple[int, int], str] = {}
        """What was printed last, by module address and register or cursor position."""

    def flag(self, statement: Flag) -> None:
        """AO, CO."""
        if statement.module in self._registers:
            key = (statement.module, statement.flag)
            if statement.on:
                self.flags.add(key)
            else:
                self.flags.discard(key)

    def show(self, statement: Print, text: str) -> None:
        """PRINT to a module; a number goes into the register too, if the module has it."""
        registers = self._registers.get(statement.module)
        if registers is None:
            return
        self.shown[statement.module, statement.place] = text
        if statement.place in registers and not isinstance(statement.what, str):
            registers[statement.place] = int(text)

    def read(self, statement: Input) -> int:
        """INPUT; an absent module or a failed range check ends the program (L3284-L3286)."""
        value = self._registers.get(statement.module, {}).get(statement.register)
        if value is None:
            raise Refused("E4")
        if statement.allowed is not None and not statement.allowed[0] <= value <= statement.allowed[1]:
            raise Refused("E4")
        return value
