"""A simulated stage with commands in the manner of SCPI, made up, with the common commands of IEEE 488.2.

Commands of a line are separated by `;`, a leading `:` is ignored; replies of a line are joined by `;`. N is the number
of an axis, positions are in units.

*IDN?  *CLS  *ESE n  *ESE?  common; *ESE is 0 after power-up (*PSC 1)
*TRG   start all armed axes together
ABOR   stop all axes by their ramps and disarm them;  ABORN: one axis
VELN v  ACCN a  TARGN p   speed, acceleration; target, which arms the axis
JOGN p  HOMEN   move one axis at once;  search its reference
POS?   positions, separated by commas
STAT?  for each axis the sum of 1 moving, 2 forward limit, 4 reverse limit, 8 armed
SYST:ERR?  the oldest error, or 0,"No error"
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from orchestrator.model.errors import TuttiError
from sim.core.controller import LimitSwitch
from sim.core.lines import LineController, LineDevice, LineFirmware

MOST_ERRORS = 20
SEARCH_RAMP_S = 0.05
_COMMAND = re.compile(r"([A-Z*]+(?::[A-Z]+)?)(\d?)(\?)?(?: ([-+.\dE]+))?")
_LIMIT_BITS: dict[LimitSwitch, int] = {"none": 0, "forward": 2, "reverse": 4, "both": 6}


class _CommandError(TuttiError):
    """An error for the queue: number and text of the SCPI standard."""


@dataclass(frozen=True, slots=True)
class StageMachine:
    """What surrounds the controller. counts_per_unit, switch_counts: by axis. search_speed: units/s."""

    counts_per_unit: Mapping[str, float]
    switch_counts: Mapping[str, int]
    search_speed: float
    startup_ms: int


@dataclass(slots=True)
class _AxisRegisters:
    """Volatile registers of one axis, in units."""

    velocity: float = 1.0
    acceleration: float = 1.0
    target: float | None = None
    is_searching: bool = False
    pressed: LimitSwitch = field(default="none")


class ScpiStage(LineController):
    """The stage with two axes."""

    def __init__(self, device: LineDevice, machine: StageMachine) -> None:
        super().__init__(("1", "2"), device)
        self.firmware = LineFirmware(startup_ms=machine.startup_ms, longest_line=500)
        self._machine = machine
        self._registers = {name: _AxisRegisters() for name in self.axes}
        self._errors: list[str] = []
        self._mask = 0

    def reset_volatile(self) -> None:
        pressed_registers = {name: register.pressed for name, register in self._registers.items()}
        self._registers = {name: _AxisRegisters(pressed=pressed_registers[name]) for name in self.axes}
        self._errors.clear()
        self._mask = 0

    def _scale(self, axis: str) -> float:
        return self._machine.counts_per_unit.get(axis, 1000.0)

    def handle_line(self, line: str, reply: Callable[[str], None]) -> None:
        """Execute the commands of a line until one fails."""
        answers: list[str] = []
        for text in line.split(";"):
            command = text.strip().removeprefix(":")
            if not command:
                continue
            try:
                answer = self._execute(command.upper())
            except _CommandError as error:
                if len(self._errors) < MOST_ERRORS:
                    self._errors.append(str(error))
                continue
            if answer is not None:
                answers.append(answer)
        if answers:
            reply(";".join(answers) + "\n")

    def _execute(self, command: str) -> str | None:
        parts = _COMMAND.fullmatch(command)
        if parts is None:
            raise _CommandError('-102,"Syntax error"')
        word, axis, query, value = parts[1], parts[2], bool(parts[3]), parts[4]
        if query:
            return self._answer(word)
        if axis:
            if axis not in self.axes:
                raise _CommandError('-114,"Header suffix out of range"')
            self._execute_for_axis(word, axis, value)
            return None
        match word:
            case "*CLS":
                self._errors.clear()
            case "*ESE":
                self._mask = int(self._number(value)) & 255
            case "*TRG":
                self._trigger()
            case "ABOR":
                for name in self.axes:
                    self._abort(name)
            case _:
                raise _CommandError('-113,"Undefined header"')
        return None

    def _answer(self, word: str) -> str:
        match word:
            case "*IDN":
                return "TUTTI,SCPI-STAGE,0001,1.0"
            case "*ESE":
                return str(self._mask)
            case "POS":
                return ",".join(f"{round(axis.position) / self._scale(name):.5f}" for name, axis in self.axes.items())
            case "STAT":
                return ",".join(str(self._status(name)) for name in self.axes)
            case "SYST:ERR":
                return self._errors.pop(0) if self._errors else '0,"No error"'
            case _:
                raise _CommandError('-113,"Undefined header"')

    def _status(self, name: str) -> int:
        registers = self._registers[name]
        return self.axes[name].is_moving + _LIMIT_BITS[registers.pressed] + 8 * (registers.target is not None)

    @staticmethod
    def _number(value: str | None) -> float:
        try:
            return float(value or "")
        except ValueError:
            raise _CommandError('-120,"Numeric data error"') from None

    def _execute_for_axis(self, word: str, name: str, value: str | None) -> None:
        registers = self._registers[name]
        match word:
            case "VEL" | "ACC":
                number = self._number(value)
                if not 0 < number < 1e6:
                    raise _CommandError('-222,"Data out of range"')
                if word == "VEL":
                    registers.velocity = number
                else:
                    registers.acceleration = number
            case "TARG":
                registers.target = self._number(value)
            case "JOG":
                self._start(name, self._number(value))
            case "HOME":
                self._search(name)
            case "ABOR":
                self._abort(name)
            case _:
                raise _CommandError('-113,"Undefined header"')

    def _start(self, name: str, position: float) -> None:
        registers, axis, scale = self._registers[name], self.axes[name], self._scale(name)
        if axis.is_moving:
            raise _CommandError('-213,"Init ignored"')
        if registers.pressed != "none":
            raise _CommandError('-221,"Settings conflict; limit switch"')
        axis.start_move(round(position * scale), registers.velocity * scale, registers.acceleration * scale)

    def _trigger(self) -> None:
        armed_targets = {
            name: register.target for name, register in self._registers.items() if register.target is not None
        }
        if not armed_targets:
            raise _CommandError('-211,"Trigger ignored"')
        for name, target in armed_targets.items():
            self._registers[name].target = None
            self._start(name, target)

    def _abort(self, name: str) -> None:
        self._registers[name].target = None
        self._registers[name].is_searching = False
        self.axes[name].brake()

    def _search(self, name: str) -> None:
        axis, speed = self.axes[name], self._machine.search_speed * self._scale(name)
        if axis.is_moving:
            raise _CommandError('-213,"Init ignored"')
        self._registers[name].is_searching = True
        way = self._machine.switch_counts.get(name, 0) - axis.physical_position
        axis.start_move(axis.position + way, speed, speed / SEARCH_RAMP_S)
        self.handle_rest()

    def handle_rest(self) -> None:
        for name, registers in self._registers.items():
            if registers.is_searching and not self.axes[name].is_moving:
                registers.is_searching = False
                self.axes[name].set_position(0.0)

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        self._registers[axis].pressed = which
        super().set_limit(axis, which)
