"""One step of a drive, from its loading to its end."""

from dataclasses import dataclass

from adapters.cia402.lowering import Cia402Lowered, SyncOutput
from adapters.cia402.sync.starts import SyncStart
from adapters.cia402.sync.stream import StreamedMove
from adapters.contract import HostInterval, PathChunk
from orchestrator.clock.base import ClockTimer


@dataclass(slots=True, eq=False)
class DriveStep:
    """A loaded step.

    boots, left: how often the drive had started, and this computer had left the bus.
    streamed_move: its part in a stream. end_s: of a path, where the released chunk begins to brake; next_chunk: the one
    that is loaded behind it. dropped: it is not the step of its drive any more."""

    lowered: Cia402Lowered
    t0_ns: int
    sync_start: SyncStart
    boots: int
    left: int
    outputs: int
    streamed_move: StreamedMove | None = None
    released: bool = False
    followed: bool = False
    started: HostInterval | None = None
    stopped_ns: int | None = None
    release: ClockTimer | None = None
    end_s: float = 0.0
    next_chunk: PathChunk | None = None
    dropped: bool = False

    @property
    def driven(self) -> SyncOutput | None:
        """The trigger line that it drives, unless that is switched with the positions of a stream."""
        return None if self.lowered.switched.points else self.lowered.drive

    @property
    def waits_for_sync(self) -> bool:
        """Whether it was released and its SYNC has not come yet."""
        return self.released and not self.sync_start.fired.done()

    @property
    def is_idle(self) -> bool:
        """Whether it starts nothing: no motion, and no trigger line."""
        return self.lowered.target is None and self.lowered.drive is None
