"""A move that the resident program executes, or that waits behind it."""

from dataclasses import dataclass
from typing import NamedTuple

from adapters.contract import HostInterval
from adapters.yaskawa.common.loads import YaskawaLowered
from adapters.yaskawa.common.program import STEP_THREAD
from adapters.yaskawa.shapes.course_records import ChunkRecords
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.estimator import TickMapping

TICKS_MAX = 2_147_483_647  # L10613
EVIDENCE_WAIT_NS = 200 * NS_PER_MS  # time after its instant within which a start is proven or disproven
SETTLE_NS = 5 * NS_PER_MS


class LoadedChunk(NamedTuple):
    """A chunk of a path that is loaded behind the released one. end_ns: after T0, where it leaves the path. records:
    None for a controller that only switches outputs."""

    number: int
    end_ns: int
    records: ChunkRecords | None


@dataclass(slots=True)
class LoadedMove:
    """The loaded move. ticks: XT0. started: by axis, once known. thread: of its program. follows: it was loaded behind
    another one. released: its release was sent, so it may start by itself. taken: its variables are those of the
    present step. begun_ticks: the sample before its begin, once its start is known: of a step at once it is none that
    was chosen. loaded: of a path, the chunk behind the released one."""

    lowered: YaskawaLowered
    ticks: int
    t0_ns: int
    mapping: TickMapping
    started: dict[str, HostInterval]
    thread: int = STEP_THREAD
    follows: bool = False
    released: bool = False
    taken: bool = True
    begun_ticks: int | None = None
    loaded: LoadedChunk | None = None

    @property
    def switched_ns(self) -> int:
        """When its last trigger is due; T0 without any."""
        switches = self.lowered.switches
        return self.t0_ns + (0 if switches is None else switches.last_ns)

    @property
    def end_ticks(self) -> int:
        """The sample in which its last axis ends."""
        begin_ticks = self.ticks if self.begun_ticks is None else self.begun_ticks
        return begin_ticks + max((move.samples for move in self.lowered.moves), default=0)
