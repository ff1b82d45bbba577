"""Wired lines of a step in the unit's own terms: the input that starts it, the output that it drives."""

from dataclasses import dataclass
from math import ceil

from adapters.shrc203.options import Options
from adapters.toolkit import wired_points as points
from orchestrator.clock.base import NS_PER_US
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import LineDrive, LineWait, Term


@dataclass(frozen=True, slots=True)
class Wait:
    """The input that starts a move. active: whether it is ON then. The edge is there in the window about T0, in ns."""

    name: str
    number: int
    active: bool
    earliest_ns: int
    latest_ns: int

    @property
    def bit(self) -> int:
        """Its place in the value of all six (L5274-L5304)."""
        return 1 << (self.number - 1)


@dataclass(frozen=True, slots=True)
class Drive:
    """The output that is switched at T0. active: whether it is ON then; for `hold_ns` at least."""

    name: str
    number: int
    active: bool
    hold_ns: int

    @property
    def bit(self) -> int:
        """Its place in the value of all six (L5327-L5357)."""
        return 1 << (self.number - 1)

    def value(self, outputs: int, active: bool) -> int:
        """What to send for all six when the others stay as in `outputs`."""
        return outputs | self.bit if active == self.active else outputs & ~self.bit

    def is_active(self, outputs: int) -> bool:
        return bool(outputs & self.bit) == self.active


def waited_for(config: Controller, wait: LineWait) -> Wait:
    """Raises `CannotDo` for an input that the fleet file does not name."""
    point = points.waited_for(config, wait)
    return Wait(wait.input, point.number, point.active == "high", wait.earliest_ns, wait.latest_ns)


def driven(config: Controller, drive: LineDrive) -> Drive:
    """Raises `CannotDo` for an output that the fleet file does not name."""
    point = points.driven(config, drive)
    return Drive(drive.output, point.number, point.active == "high", drive.hold_ns)


def waiting_terms(options: Options, wait: Wait) -> tuple[Term, ...]:
    """Where the start lies about T0: the line's window, the unit's next look at its inputs, and what it does then."""
    scan_ns = ceil(options.input_scan_us * NS_PER_US * (1 + options.clock_ppm * 1e-6))
    return (
        Term(name="line", earliest_ns=wait.earliest_ns, latest_ns=wait.latest_ns),
        Term(name="input", earliest_ns=0, latest_ns=scan_ns),
        Term(name="firmware", earliest_ns=0, latest_ns=options.line_start_us * NS_PER_US),
    )


def edge_terms(options: Options, lead_ns: int, behind_ns: int) -> tuple[Term, ...]:
    """Where the edge of a driven line lies about T0.

    lead_ns: how long before it the line that is written first is at the unit. behind_ns: how long the line that
    switches it takes on the wire behind the starting line, 0 when it is fired alone. Behind another one it is decoded
    when it has come, and when that one is done.
    """
    slow_ns = (options.decode_us + options.decode_spread_us) * NS_PER_US
    quick_ns = max(0, options.decode_us - options.decode_spread_us) * NS_PER_US
    if behind_ns:
        slow_ns += max(behind_ns, slow_ns)
        quick_ns += max(behind_ns, quick_ns)
    return (
        options.host_term(),
        Term(name="wire", earliest_ns=0, latest_ns=options.wire_jitter_us * NS_PER_US),
        Term(name="firmware", earliest_ns=quick_ns - lead_ns, latest_ns=slow_ns - lead_ns),
    )
