"""A step's part while it is loaded or under way."""

from dataclasses import dataclass

from adapters.contract import FireOrder, Span
from adapters.ppsmc.lowering import SmcLowered
from adapters.ppsmc.output import DrivenOutput
from adapters.ppsmc.session import Pending


@dataclass(slots=True)
class Move:
    """A move that is loaded. output: what it switches. From `go` on it is released: with the order to fire and the
    place of the answers behind what is fired, or with a program that waits. started: span of the start, when known."""

    lowered: SmcLowered
    t0_ns: int
    output: DrivenOutput | None = None
    ignore_limits: bool = False
    released: bool = False
    order: FireOrder | None = None
    pending: Pending | None = None
    started: Span | None = None
    stopped_ns: int | None = None
    taken_back: bool = False

    @property
    def motors(self) -> set[int]:
        return {each.motor for each in self.lowered.moves}

    @property
    def waits(self) -> bool:
        """Whether an input starts it."""
        return self.lowered.wait is not None and bool(self.lowered.moves)

    @property
    def start_line(self) -> str:
        if self.lowered.by_program:
            return "start:"
        return "tbg:iel" if self.ignore_limits else "tbg"
