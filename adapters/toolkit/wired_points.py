"""The trigger input that a step waits for, and the trigger output that it drives, by their names in the fleet file."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil

from orchestrator.clock.base import NS_PER_US
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller, DigitalInput, DigitalOutput
from orchestrator.model.messages import BudgetTerm, TriggerDrive, TriggerWait


@dataclass(frozen=True, slots=True)
class WiredInput:
    """The input that starts a move.

    number: as the fleet file names it.
    bit: its place in the value of all inputs.
    active: the level that starts the move (True = on).
    earliest_ns, latest_ns: window of the edge relative to T0."""

    name: str
    number: int
    bit: int
    active: bool
    earliest_ns: int
    latest_ns: int

    @property
    def mask(self) -> int:
        return 1 << self.bit

    def is_active(self, inputs: int) -> bool:
        return bool(inputs & self.mask) == self.active


@dataclass(frozen=True, slots=True)
class WiredOutput:
    """The output that is switched at T0.

    number: as the fleet file names it.
    bit: its place in the value of all outputs.
    active: its level from T0 on (True = on).
    active_ns: shortest duration of that level."""

    name: str
    number: int
    bit: int
    active: bool
    active_ns: int

    @property
    def mask(self) -> int:
        return 1 << self.bit

    def active_value(self, outputs: int) -> int:
        """Return the value of all outputs with this one active and the others as in `outputs`."""
        return outputs | self.mask if self.active else outputs & ~self.mask

    def passive_value(self, outputs: int) -> int:
        """Return the value of all outputs with this one passive and the others as in `outputs`."""
        return outputs & ~self.mask if self.active else outputs | self.mask

    def is_active(self, outputs: int) -> bool:
        return bool(outputs & self.mask) == self.active


def resolve_wait_input(config: Controller, wait: TriggerWait, lowest: int) -> WiredInput:
    """Return the input to wait for; `lowest` is the number of the input in bit 0. Raises `Refusal` for an input that
    the fleet file does not name."""
    point = find_wait_input(config, wait)
    active = point.active == "high"
    return WiredInput(
        name=wait.input,
        number=point.number,
        bit=point.number - lowest,
        active=active,
        earliest_ns=wait.earliest_ns,
        latest_ns=wait.latest_ns,
    )


def resolve_driven_output(config: Controller, drive: TriggerDrive, lowest: int) -> WiredOutput:
    """Return the output to drive; `lowest` is the number of the output in bit 0. Raises `Refusal` for an output that
    the fleet file does not name."""
    point = find_driven_output(config, drive)
    return WiredOutput(drive.output, point.number, point.number - lowest, point.active == "high", drive.active_ns)


def waiting_terms(wait: WiredInput, scan_us: int, clock_ppm: float, reaction_us: int) -> tuple[BudgetTerm, ...]:
    """Return the terms of a start by trigger line relative to T0: the window of the line, the controller's next scan of
    its inputs, and its reaction."""
    scan_ns = ceil(scan_us * NS_PER_US * (1 + clock_ppm * 1e-6))
    return (
        BudgetTerm(name="line", earliest_ns=wait.earliest_ns, latest_ns=wait.latest_ns),
        BudgetTerm(name="input", earliest_ns=0, latest_ns=scan_ns),
        BudgetTerm(name="firmware", earliest_ns=0, latest_ns=reaction_us * NS_PER_US),
    )


def find_wait_input(config: Controller, wait: TriggerWait) -> DigitalInput:
    """Return the input to wait for. Raises `Refusal` for an input that the fleet file does not name."""
    point = config.inputs.get(wait.input)
    if point is None:
        raise Refusal(
            "start-class",
            f"no start by trigger line: the controller has no input {wait.input}; inputs: {_list_names(config.inputs)}",
            "name the input in the fleet file",
        )
    return point


def find_driven_output(config: Controller, drive: TriggerDrive) -> DigitalOutput:
    """Return the output to drive. Raises `Refusal` for an output that the fleet file does not name."""
    point = config.outputs.get(drive.output)
    if point is None:
        raise Refusal(
            "start-class",
            f"no trigger line to drive: the controller has no output {drive.output}; "
            f"outputs: {_list_names(config.outputs)}",
            "name the output in the fleet file",
        )
    return point


def _list_names(points: Mapping[str, object]) -> str:
    return ", ".join(points) or "none"
