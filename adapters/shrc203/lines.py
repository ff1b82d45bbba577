"""Trigger lines of a step in the controller's own terms: the input that starts it, the output that it drives."""

from dataclasses import dataclass
from math import ceil

from adapters.shrc203.options import ShrcOptions
from adapters.toolkit import wired_points as points
from orchestrator.clock.base import NS_PER_US
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import BudgetTerm, TriggerDrive, TriggerWait


@dataclass(frozen=True, slots=True)
class InputTrigger:
    """The input that starts a move.

    active: the level that starts it (True = ON).
    earliest_ns, latest_ns: window of the edge relative to T0."""

    name: str
    number: int
    active: bool
    earliest_ns: int
    latest_ns: int

    @property
    def input_bit(self) -> int:
        """The bit of this input in the value of all six (L5274-L5304)."""
        return 1 << (self.number - 1)


@dataclass(frozen=True, slots=True)
class OutputTrigger:
    """The output that is switched at T0.

    active: its level from T0 on (True = ON).
    active_ns: shortest duration of that level."""

    name: str
    number: int
    active: bool
    active_ns: int

    @property
    def output_bit(self) -> int:
        """The bit of this output in the value of all six (L5327-L5357)."""
        return 1 << (self.number - 1)

    def outputs_with(self, outputs: int, active: bool) -> int:
        """Return the value for all six outputs that leaves the others as in `outputs`."""
        return outputs | self.output_bit if active == self.active else outputs & ~self.output_bit

    def is_active(self, outputs: int) -> bool:
        return bool(outputs & self.output_bit) == self.active


def resolve_wait_input(config: Controller, wait: TriggerWait) -> InputTrigger:
    """Return the input to wait for. Raises `Refusal` for an input that the fleet file does not name."""
    point = points.find_wait_input(config, wait)
    return InputTrigger(wait.input, point.number, point.active == "high", wait.earliest_ns, wait.latest_ns)


def resolve_driven_output(config: Controller, drive: TriggerDrive) -> OutputTrigger:
    """Return the output to drive. Raises `Refusal` for an output that the fleet file does not name."""
    point = points.find_driven_output(config, drive)
    return OutputTrigger(drive.output, point.number, point.active == "high", drive.active_ns)


def waiting_terms(options: ShrcOptions, wait: InputTrigger) -> tuple[BudgetTerm, ...]:
    """Return the terms of the start relative to T0: the trigger line's window, the controller's next scan of its
    inputs, and its reaction."""
    scan_ns = ceil(options.input_scan_us * NS_PER_US * (1 + options.clock_ppm * 1e-6))
    return (
        BudgetTerm(name="line", earliest_ns=wait.earliest_ns, latest_ns=wait.latest_ns),
        BudgetTerm(name="input", earliest_ns=0, latest_ns=scan_ns),
        BudgetTerm(name="firmware", earliest_ns=0, latest_ns=options.line_start_us * NS_PER_US),
    )


def edge_terms(options: ShrcOptions, lead_ns: int, behind_ns: int) -> tuple[BudgetTerm, ...]:
    """Return the terms of the edge of a driven trigger line relative to T0.

    lead_ns: how long before T0 the first command reaches the controller. behind_ns: transmission time of the switching
    command after the starting command, 0 when it is sent alone. After another command it is decoded once it has arrived
    and that command is done.
    """
    slow_ns = (options.decode_us + options.decode_spread_us) * NS_PER_US
    quick_ns = max(0, options.decode_us - options.decode_spread_us) * NS_PER_US
    if behind_ns:
        slow_ns += max(behind_ns, slow_ns)
        quick_ns += max(behind_ns, quick_ns)
    return (
        options.host_term(),
        BudgetTerm(name="wire", earliest_ns=0, latest_ns=options.wire_jitter_us * NS_PER_US),
        BudgetTerm(name="firmware", earliest_ns=quick_ns - lead_ns, latest_ns=slow_ns - lead_ns),
    )
