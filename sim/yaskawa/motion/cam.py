"""Electronic cam: slaves follow a table over the master's cycle (L4378-L5111, L13640-L13826)."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(slots=True)
class ElectronicCam:
    """Master, table and cycles. Positions in counts.

    points: number of entries of the table."""

    points: int
    master_cycle: int | None = None
    """Of MM; None where EM sets the master's cycle too."""
    master: str | None = None
    """An axis, or D and an axis for its auxiliary encoder."""
    enabled: bool = False
    index: int = 0
    interval: int = 256
    start: int = 0
    cycles: dict[str, int] = field(default_factory=dict[str, int])
    table: dict[str, list[int]] = field(default_factory=dict[str, list[int]])
    waiting: dict[tuple[str, str], int] = field(default_factory=dict[tuple[str, str], int])
    """For each waiting slave and its order (`EG`, `EQ`): the master position."""
    followers: set[str] = field(default_factory=set[str])

    @property
    def effective_cycle(self) -> int:
        """The master's cycle; 0 when none is defined."""
        return self.cycles.get((self.master or "")[-1:], 0) if self.master_cycle is None else self.master_cycle

    def disengage_all(self) -> None:
        """Disengage all slaves and cancel their orders, as after a reset."""
        self.enabled = False
        self.followers.clear()
        self.waiting.clear()

    def store_point(self, slave: str, index: int, value: int) -> None:
        self.table.setdefault(slave, [0] * self.points)[index] = value

    def count_turns(self, master: float) -> int:
        """Return the whole cycles up to an unmodularised master position."""
        return int((master - self.start) // self.effective_cycle) if self.effective_cycle else 0

    def slave_position(self, slave: str, master: float) -> float:
        """Return the slave's position for an unmodularised master position, cycles added up (D58: linear between
        points)."""
        table = self.table.get(slave) or [0] * self.points
        turns = self.count_turns(master)
        position = (
            master - self.start - turns * self.effective_cycle
            if self.effective_cycle
            else max(master - self.start, 0.0)
        )
        index = min(int(position // self.interval), self.points - 2)
        share = (position - index * self.interval) / self.interval
        low, high = table[index], table[index + 1]
        return turns * self.cycles.get(slave, 0) + low + (high - low) * share


@dataclass(frozen=True, slots=True)
class CamPath:
    """An engaged slave."""

    cam: ElectronicCam
    slave: str
    master: Callable[[float], float]

    def position(self, at: float) -> float:
        return self.cam.slave_position(self.slave, self.master(at))

    def velocity(self, at: float) -> float:
        return self.position(at) - self.position(at - 1)
