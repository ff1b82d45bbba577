"""Wired lines of a step in the unit's own terms: the input that starts it, the output that it drives."""

from dataclasses import dataclass
from math import ceil

from adapters.ppsmc.options import Options
from adapters.toolkit import wired_points as points
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.latency import Latency
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import LineDrive, LineWait, Term


@dataclass(frozen=True, slots=True)
class Wait:
    """The input that starts a move. bit: of the port. active: its level then. The edge is there in the window about
    T0, in ns."""

    name: str
    bit: int
    active: bool
    earliest_ns: int
    latest_ns: int

    @property
    def command(self) -> str:
        """The part of a program line that waits for it (L3550)."""
        return f"in{self.bit}.{int(self.active)}"

    def is_active(self, inputs: int) -> bool:
        return bool(inputs >> self.bit & 1) == self.active


@dataclass(frozen=True, slots=True)
class Drive:
    """The output that is switched at T0. bit: of the port. active: its level then; for `hold_ns` at least."""

    name: str
    bit: int
    active: bool
    hold_ns: int

    @property
    def command(self) -> str:
        """The part of a program line that switches it (L3728, L3782)."""
        return f"{'set' if self.active else 'res'}{self.bit}"

    def byte(self, outputs: int, active: bool) -> int:
        """All outputs, the others as in `outputs`."""
        mask = 1 << self.bit
        return outputs | mask if active == self.active else outputs & ~mask

    def is_active(self, outputs: int) -> bool:
        return bool(outputs >> self.bit & 1) == self.active


def waited_for(config: Controller, wait: LineWait) -> Wait:
    """Raises `CannotDo` for an input that the fleet file does not name."""
    point = points.waited_for(config, wait)
    return Wait(wait.input, point.number, point.active == "high", wait.earliest_ns, wait.latest_ns)


def driven(config: Controller, drive: LineDrive) -> Drive:
    """Raises `CannotDo` for an output that the fleet file does not name."""
    point = points.driven(config, drive)
    return Drive(drive.output, point.number, point.active == "high", drive.hold_ns)


def starting_terms(options: Options, start: Latency, program: bool) -> tuple[Term, ...]:
    """Where a start by the host lies about T0: the line is written so that it is usually executed at T0.

    program: it starts a program, whose axes move after its output has been switched.
    """
    last_ns = start.latest_ns - (options.wire_jitter_us - (options.line_start_us if program else 0)) * NS_PER_US
    return (*_sent(options), _firmware(start.earliest_ns - start.usual_ns, last_ns - start.usual_ns))


def waiting_terms(options: Options, wait: Wait) -> tuple[Term, ...]:
    """Where a start by the line lies: its window, the program's next look at its inputs, and what it does then."""
    scan_ns = ceil(options.input_scan_us * NS_PER_US * (1 + options.clock_ppm * 1e-6))
    return (
        Term(name="line", earliest_ns=wait.earliest_ns, latest_ns=wait.latest_ns),
        Term(name="input", earliest_ns=0, latest_ns=scan_ns),
        _firmware(0, (options.line_start_us + options.start_skew_us) * NS_PER_US),
    )


def edge_terms(options: Options, start: Latency) -> tuple[Term, ...]:
    """Where the edge of a driven line lies about T0."""
    quick_ns, slow_ns = options.decode_ns
    last_ns = slow_ns + options.line_start_us * NS_PER_US
    return (*_sent(options), _firmware(quick_ns - start.usual_ns, last_ns - start.usual_ns))


def _sent(options: Options) -> tuple[Term, ...]:
    return (
        options.host_term(),
        Term(name="wire", earliest_ns=0, latest_ns=options.wire_jitter_us * NS_PER_US),
    )


def _firmware(first_ns: int, last_ns: int) -> Term:
    return Term(name="firmware", earliest_ns=first_ns, latest_ns=last_ns)
