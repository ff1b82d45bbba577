"""Contour mode: records of position increments, interpolated linearly (L3439-L3489, L13907-L13970)."""

from bisect import bisect_right
from dataclasses import dataclass
from math import inf


@dataclass(frozen=True, slots=True)
class ContourRecord:
    """`increments` in counts for each contouring axis over `samples`; 0 samples ends contouring (L4274)."""

    increments: tuple[int, ...]
    samples: int


_KEPT = 1024


class ContourMotion:
    """The records of one contour: one executing, one waiting for it (D12). Time in samples."""

    def __init__(self, axes: tuple[str, ...], at: int, positions: tuple[float, ...]) -> None:
        self.axes = axes
        self.waiting: ContourRecord | None = None
        self.started: int | None = None
        """Sample at which the first record began."""
        self.count = 0
        self.end: float = inf
        """Sample at which the executing record ends; infinite when none executes."""
        self.changed: list[int | None] = [None] * len(axes)
        """For each axis the sample of its last commanded change."""
        self._starts = [at]
        self._bases = [positions]
        self._records = [ContourRecord((0,) * len(axes), 1)]

    def begin_from(self, positions: tuple[float, ...]) -> None:
        """Records are increments: the first one counts from where its axes stand then, which `DP` may have redefined
        since `CM` (D110)."""
        self._bases = [positions]

    @property
    def is_executing(self) -> bool:
        return self.end != inf

    def execute_record(self, record: ContourRecord, at: int) -> None:
        """Run `record` from `at` on."""
        base = tuple(self.position(index, at) for index in range(len(self.axes)))
        if self.started is None:
            self.started = at
        else:
            self.count += 1
        if len(self._starts) > _KEPT:
            for history in (self._starts, self._bases, self._records):
                del history[: _KEPT // 2]
        self._starts.append(at)
        self._bases.append(base)
        self._records.append(record)
        self.end = at + record.samples
        for index, increment in enumerate(record.increments):
            if increment:
                self.changed[index] = at + record.samples

    def position(self, index: int, at: float) -> float:
        slot = max(bisect_right(self._starts, at) - 1, 0)
        record = self._records[slot]
        share = min(max((at - self._starts[slot]) / record.samples, 0.0), 1.0)
        return self._bases[slot][index] + record.increments[index] * share

    def velocity(self, index: int, at: float) -> float:
        """Return the velocity of the running record; at the instant when one ends, its own: the next one may follow."""
        slot = bisect_right(self._starts, at) - 1
        if slot < 0 or at > self._starts[slot] + self._records[slot].samples:
            return 0.0
        return self._records[slot].increments[index] / self._records[slot].samples


@dataclass(frozen=True, slots=True)
class ContourPath:
    """One axis of a contour."""

    contour: ContourMotion
    index: int

    def position(self, at: float) -> float:
        return self.contour.position(self.index, at)

    def velocity(self, at: float) -> float:
        return self.contour.velocity(self.index, at)
