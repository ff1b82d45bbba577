"""Trigger lines of a step in the controller's own terms: the input that starts it, the output that it drives."""

from dataclasses import dataclass
from math import ceil

from adapters.ppsmc.options import PpSmcOptions
from adapters.toolkit import wired_points as points
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.latency import Latency
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import BudgetTerm, TriggerDrive, TriggerWait


@dataclass(frozen=True, slots=True)
class PortTrigger:
    """The input that starts a move.

    bit: of the port.
    active: the level that starts it.
    earliest_ns, latest_ns: window of the edge relative to T0."""

    name: str
    bit: int
    active: bool
    earliest_ns: int
    latest_ns: int

    @property
    def program_text(self) -> str:
        """Return the part of a program line that waits for it (L3550)."""
        return f"in{self.bit}.{int(self.active)}"

    def is_active(self, inputs: int) -> bool:
        return bool(inputs >> self.bit & 1) == self.active


@dataclass(frozen=True, slots=True)
class PortOutput:
    """The output that is switched at T0.

    bit: of the port.
    active: its level from T0 on.
    active_ns: shortest duration of that level."""

    name: str
    bit: int
    active: bool
    active_ns: int

    @property
    def program_text(self) -> str:
        """Return the part of a program line that switches it (L3728, L3782)."""
        return f"{'set' if self.active else 'res'}{self.bit}"

    def outputs_with(self, outputs: int, active: bool) -> int:
        """Return the value of all outputs, the others as in `outputs`."""
        mask = 1 << self.bit
        return outputs | mask if active == self.active else outputs & ~mask

    def is_active(self, outputs: int) -> bool:
        return bool(outputs >> self.bit & 1) == self.active


def resolve_wait_input(config: Controller, wait: TriggerWait) -> PortTrigger:
    """Return the input to wait for. Raises `Refusal` for an input that the fleet file does not name."""
    point = points.find_wait_input(config, wait)
    return PortTrigger(wait.input, point.number, point.active == "high", wait.earliest_ns, wait.latest_ns)


def resolve_driven_output(config: Controller, drive: TriggerDrive) -> PortOutput:
    """Return the output to drive. Raises `Refusal` for an output that the fleet file does not name."""
    point = points.find_driven_output(config, drive)
    return PortOutput(drive.output, point.number, point.active == "high", drive.active_ns)


def starting_terms(options: PpSmcOptions, start: Latency, program: bool) -> tuple[BudgetTerm, ...]:
    """Return the terms of a start by the host relative to T0: the command is written so that it is usually executed at
    T0.

    program: it starts a program, whose axes move after its output has been switched.
    """
    last_ns = start.latest_ns - (options.wire_jitter_us - (options.line_start_us if program else 0)) * NS_PER_US
    return (*_transmission_terms(options), _firmware_term(start.earliest_ns - start.usual_ns, last_ns - start.usual_ns))


def waiting_terms(options: PpSmcOptions, wait: PortTrigger) -> tuple[BudgetTerm, ...]:
    """Return the terms of a start by trigger line: its window, the program's next scan of its inputs, and its
    reaction."""
    scan_ns = ceil(options.input_scan_us * NS_PER_US * (1 + options.clock_ppm * 1e-6))
    return (
        BudgetTerm(name="line", earliest_ns=wait.earliest_ns, latest_ns=wait.latest_ns),
        BudgetTerm(name="input", earliest_ns=0, latest_ns=scan_ns),
        _firmware_term(0, (options.line_start_us + options.start_skew_us) * NS_PER_US),
    )


def edge_terms(options: PpSmcOptions, start: Latency) -> tuple[BudgetTerm, ...]:
    """Return the terms of the edge of a driven trigger line relative to T0."""
    quick_ns, slow_ns = options.decode_ns
    last_ns = slow_ns + options.line_start_us * NS_PER_US
    return (*_transmission_terms(options), _firmware_term(quick_ns - start.usual_ns, last_ns - start.usual_ns))


def _transmission_terms(options: PpSmcOptions) -> tuple[BudgetTerm, ...]:
    return (
        options.host_term(),
        BudgetTerm(name="wire", earliest_ns=0, latest_ns=options.wire_jitter_us * NS_PER_US),
    )


def _firmware_term(first_ns: int, last_ns: int) -> BudgetTerm:
    return BudgetTerm(name="firmware", earliest_ns=first_ns, latest_ns=last_ns)
