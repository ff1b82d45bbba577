"""One axis of a chain of moves: what is loaded, what has ended, and whether it keeps to its limits."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from adapters.shrc203.fleetaxes import axis_bounds
from adapters.shrc203.shapes.trapezoid import ShrcTrapezoid
from adapters.shrc203.wire.replies import AxisStatus
from adapters.shrc203.wire.reply_queue import ShrcLine
from adapters.shrc203.wire.session import COMPLETION_LATE_NS
from adapters.shrc203.wire.status import stop_reason
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis

_ROOM = 1e-6


@dataclass(frozen=True, slots=True)
class ChainMove:
    """One move of a chain. distance: pulses, signed. shape: the trapezoid that the controller executes."""

    distance: int
    shape: ShrcTrapezoid


@dataclass(slots=True)
class ChainAxis:
    """One axis of a chain.

    loaded, done: number of moves that have been written, and that have ended.
    load: the reply to the last load command, which is `command`.
    speeds: the speeds of that command.
    due_ns: the latest end of the running move.
    free: a completion line has shown that the prebuffer is free."""

    name: str
    motor: int
    start: int
    moves: Sequence[ChainMove]
    loaded: int = 0
    done: int = 0
    speeds: str = ""
    load: "asyncio.Future[ShrcLine] | None" = None
    command: str = ""
    due_ns: int = 0
    free: bool = False

    @property
    def has_ended(self) -> bool:
        return self.done == len(self.moves)

    def next_load_command(self) -> str:
        """Return the command that loads the next move. Speeds are omitted where they equal those of the previous move,
        which runs or has run with them: an omitted triple means the present one (L3098), and every move sets it
        (L3100)."""
        move = self.moves[self.loaded]
        speeds = f"S{move.shape.s}F{move.shape.f}R{move.shape.r}"
        speeds_text = f",{speeds}" if speeds != self.speeds else ""
        self.speeds = speeds
        self.loaded += 1
        return f"MP:{self.motor}{'-' if move.distance < 0 else '+'}P{abs(move.distance)}{speeds_text}"

    def position_after(self, done: int) -> int:
        """Return the position of the axis after `done` moves."""
        return self.start + sum(move.distance for move in self.moves[:done])

    def expect_end(self, begun_ns: int, slowness: float) -> None:
        """Expect the end of the move that has begun at that instant. slowness: the largest ratio of durations by the
        controller's crystal to planned ones."""
        if not self.has_ended:
            duration_s = self.moves[self.done].shape.duration_s
            self.due_ns = begun_ns + ceil(duration_s * NS_PER_S * slowness) + COMPLETION_LATE_NS

    def stray_text(self, now: AxisStatus) -> str:
        """Return why the axis is not where one of its moves ends."""
        return stop_reason(self.name, now) or (
            f"axis {self.name} is at {now.counts}, between the positions of its chain"
        )


def is_answered(load: "asyncio.Future[ShrcLine]") -> bool:
    """Return whether the reply to a load has arrived."""
    return load.done() and load.exception() is None


def check_chain(name: str, axis: Axis, start: int, moves: Sequence[ChainMove]) -> None:
    """Raise `Refusal` for a chain with an empty move or a move that exceeds the axis's limits."""
    limits, soft = axis_bounds(axis), axis.soft_limits_counts
    position = start
    for number, move in enumerate(moves, 1):
        shape = move.shape
        if move.distance == 0 or abs(move.distance) != shape.distance:
            raise Refusal(
                "bad-move", f"axis {name}, move {number}: {move.distance} pulses with a shape of {shape.distance}"
            )
        if shape.peak_speed > limits.speed * (1 + _ROOM) or not limits.start_min <= shape.s <= limits.start_max:
            raise Refusal("velocity-limit", f"axis {name}, move {number}: {shape} exceeds its speed or start rate")
        if shape.acceleration > limits.acceleration * (1 + _ROOM):
            raise Refusal("acceleration-limit", f"axis {name}, move {number}: {shape} exceeds its acceleration")
        position += move.distance
        if soft is not None and not soft[0] <= position <= soft[1]:
            raise Refusal(
                "soft-limit",
                f"axis {name}, move {number} ends at {position} pulses; its soft limits are {soft[0]} to {soft[1]}",
            )
