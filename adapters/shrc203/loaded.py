"""A move that is loaded, and what becomes of it."""

from dataclasses import dataclass, field

from adapters.contract import FireOrder, Span
from adapters.shrc203.lowering import ShrcLowered
from adapters.shrc203.output import DrivenOutput
from adapters.shrc203.replies import AxisStatus
from adapters.shrc203.session import Pending


@dataclass(slots=True)
class Move:
    """A move that is loaded. output: what it switches. From `go` on it is released, with the order to fire and the
    places of the answers, of the starting line and of the one that switches. started: span of the start, when known;
    answered_ns: its `OK` can have begun to be sent by then."""

    lowered: ShrcLowered
    t0_ns: int
    output: DrivenOutput | None = None
    released: bool = False
    order: FireOrder | None = None
    pending: Pending | None = None
    switching: Pending | None = None
    started: Span | None = None
    stopped_ns: int | None = None
    taken_back: bool = False
    answered_ns: int | None = None
    seen: dict[int, AxisStatus] = field(default_factory=dict[int, AxisStatus])

    @property
    def motors(self) -> set[int]:
        return {each.motor for each in self.lowered.moves}

    @property
    def expected(self) -> list[Pending]:
        """The places of the answers to what is written at its start."""
        return [each for each in (self.pending, self.switching) if each is not None]

    @property
    def waits(self) -> bool:
        """Whether an input starts it."""
        return self.lowered.wait is not None and bool(self.lowered.moves)
