"""Queries: V1, V2, VS, VT, VR, VA and TP."""

from typing import Literal

from sim.smc30.expressions import OperandValues
from sim.smc30.inputs import ANALOGUE_INPUTS
from sim.smc30.operands import LAST_REGISTER, parse_bounded
from sim.smc30.options import IndexerOptions
from sim.smc30.outputs import UserOutputs
from sim.smc30.refusal import StatementRefused
from sim.smc30.statements import InputContact


class QueryAnswers:
    """Answers of one device."""

    def __init__(self, options: IndexerOptions, values: OperandValues, outputs: UserOutputs) -> None:
        self._options = options
        self._values = values
        self._outputs = outputs

    def answer_query(self, name: str, argument: str) -> str:
        """Return the answer to a query (L1914-L1931, L2349-L2487, L3006-L3015; decisions 7-10)."""
        parameters = self._values.parameters
        match name:
            case "V1":
                return f"V{self._values.drive.position_counter:+d}"
            case "V2":
                return f"V{self._values.inputs.user_pattern()}{self._outputs.output_pattern()}"
            case "VS":
                return f"S{parameters.start}"
            case "VT":
                return f"T{parameters.top}"
            case "VR" if not argument:
                return f"R{parameters.ramp_steps}"
            case "VR":
                number = parse_bounded(argument, 0, LAST_REGISTER) if argument.isdigit() else _raise_refused("E4")
                return f"R{number}={self._values.registers.read_register(number)}"
            case "VA" if not argument:
                contacts = (InputContact(number, analogue=True) for number in range(1, ANALOGUE_INPUTS + 1))
                return "VA" + "".join("1" if self._values.inputs.is_closed(contact) else "0" for contact in contacts)
            case "VA":
                number = parse_bounded(argument, 1, ANALOGUE_INPUTS) if argument.isdigit() else _raise_refused("E4")
                return f"VA{number}={self._values.inputs.analogue_level(number) * 2 / 100:.2f}"
            case _:
                return f"TP{self._options.temperature_c}"


def _raise_refused(code: Literal["E4"]) -> int:
    raise StatementRefused(code)
