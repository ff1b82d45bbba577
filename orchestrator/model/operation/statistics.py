"""Statistics of the operation, and the request for them, on `svc/statistics`."""

from pydantic import Field

from orchestrator.model.base import Int53, Model
from orchestrator.model.messages import Reply, Request

MAX_DAYS = 3660
DAY_PATTERN = r"^\d{4}-\d{2}-\d{2}$"


class AxisFigures(Model):
    """What an axis did. moves: motion steps; moving_s: in moves and jogs. distance: in `unit`, of moves by their plan,
    of moves that were stopped by the last reading. reversals: moves in the direction opposite to the move before."""

    axis: str
    unit: str
    moves: Int53 = 0
    reversals: Int53 = 0
    moving_s: float = 0.0
    distance: float = 0.0


class ControllerFigures(Model):
    """How long a controller was online, in fault, and offline, s; and its faults by code."""

    controller: str
    online_s: float = 0.0
    fault_s: float = 0.0
    offline_s: float = 0.0
    faults: dict[str, Int53] = Field(default={})

    @property
    def availability(self) -> float | None:
        """The fraction of the time in which it was online, and not in fault; None without any time."""
        whole_s = self.online_s + self.fault_s + self.offline_s
        return self.online_s / whole_s if whole_s else None


class PairFigures(Model):
    """The start skew of two controllers in common moves: upper bounds by evidence, ns. p50 and p99 are at most 2 % too
    large."""

    pair: tuple[str, str]
    moves: Int53
    mean_ns: Int53
    p50_ns: Int53
    p99_ns: Int53
    worst_ns: Int53


class PeriodFigures(Model):
    """The statistics of one UTC day, or of the whole time (day: None). jobs: by their last state; failures: steps that
    were not done, by cause."""

    day: str | None
    axes: list[AxisFigures] = Field(default=[])
    controllers: list[ControllerFigures] = Field(default=[])
    pairs: list[PairFigures] = Field(default=[])
    jobs: dict[str, Int53] = Field(default={})
    failures: dict[str, Int53] = Field(default={})


class ReadStatistics(Request):
    """Read the statistics from a UTC day on (`2026-01-31`). by_day: also those of each day."""

    since: str = Field(pattern=DAY_PATTERN)
    by_day: bool = False


class StatisticsRead(Reply):
    """days: the oldest first; empty unless they were asked for."""

    since: str = ""
    total: PeriodFigures = PeriodFigures(day=None)
    days: list[PeriodFigures] = Field(default=[])
