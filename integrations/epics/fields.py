"""The fields of a motor record that are served: their types, choices and units, and which of them may be put.

Names, types and choices: motorRecord.dbd of EPICS motor R7-3; alarms: menuAlarmStat and menuAlarmSevr of EPICS base.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

from tutti import Refusal

Value = float | int | str

LARGEST = 1e12
"""No axis of any unit has such a position."""

STOP, PAUSE, MOVE, GO = range(4)
"""Choices of SPMG."""
STATES = (
    *("NO_ALARM", "READ", "WRITE", "HIHI", "HIGH", "LOLO", "LOW", "STATE"),
    *("COS", "COMM", "TIMEOUT", "HWLIMIT", "CALC", "SCAN", "LINK", "SOFT"),
)
"""The first 16, which is as many as a menu of Channel Access has."""
SEVERITIES = ("NO_ALARM", "MINOR", "MAJOR", "INVALID")


@dataclass(frozen=True, slots=True)
class Field:
    """One field. kind: of its value; a menu is the number of one of `choices`. unit: `egu`, `egu/s` or `s`."""

    kind: Literal["float", "int", "text", "menu"] = "float"
    unit: str = ""
    choices: tuple[str, ...] = field(default=())
    can_put: bool = False

    @property
    def zero(self) -> Value:
        """Its value before there is one."""
        return {"float": 0.0, "text": ""}.get(self.kind, 0)

    def convert(self, name: str, raw: object) -> Value:
        """The value of a put. Raises `Refusal`, code `bad-value`."""
        if not self.can_put:
            raise Refusal("read-only", f"{name} is read only", "the fleet file, or the axis itself, decides it")
        if isinstance(raw, str) and raw in self.choices:
            return self.choices.index(raw)
        try:
            number = float(raw)  # pyright: ignore[reportArgumentType] - whatever a client sends
        except (TypeError, ValueError):
            number = math.nan
        if not abs(number) <= LARGEST or (self.kind != "float" and number != int(number)):
            raise Refusal("bad-value", f"{name} cannot be {raw!r:.80}", f"write {self._describe()}")
        if self.choices and not 0 <= number < len(self.choices):
            raise Refusal("bad-value", f"{name} has no choice {raw!r:.80}", f"write {self._describe()}")
        return number if self.kind == "float" else int(number)

    def _describe(self) -> str:
        return " or ".join(self.choices) if self.choices else "a number" if self.kind == "float" else "a whole number"


FIELDS: dict[str, Field] = {
    **dict.fromkeys(("VAL", "DVAL", "TWV", "OFF", "LLM", "HLM", "DLLM", "DHLM"), Field(unit="egu", can_put=True)),
    **dict.fromkeys(("RBV", "DRBV", "MRES", "UREV", "ERES", "RDBD"), Field(unit="egu")),
    "VELO": Field(unit="egu/s", can_put=True),
    "VMAX": Field(unit="egu/s"),
    "ACCL": Field(unit="s"),
    **dict.fromkeys(("RVAL", "TWF", "TWR", "JOGF", "JOGR", "HOMF", "HOMR", "STOP"), Field("int", can_put=True)),
    **dict.fromkeys(("SREV", "PREC", "DMOV", "MOVN", "HLS", "LLS", "LVIO", "MSTA"), Field("int")),
    **dict.fromkeys(("EGU", "OUT", "DESC"), Field("text")),
    "FOFF": Field("menu", choices=("Variable", "Frozen"), can_put=True),
    "SET": Field("menu", choices=("Use", "Set"), can_put=True),
    "SPMG": Field("menu", choices=("Stop", "Pause", "Move", "Go"), can_put=True),
    "CNEN": Field("menu", choices=("Disable", "Enable"), can_put=True),
    "DIR": Field("menu", choices=("Pos", "Neg")),
    "STAT": Field("menu", choices=STATES),
    "SEVR": Field("menu", choices=SEVERITIES),
}
