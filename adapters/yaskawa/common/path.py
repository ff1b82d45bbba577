"""The continuation of a path: the chunk behind the present one, and the change over to it."""

from adapters.contract import ChunkFit, PathChunk
from adapters.yaskawa.common.course_refill import ContourRefill
from adapters.yaskawa.common.gate_start import GateStart
from adapters.yaskawa.common.loaded import LoadedMove
from adapters.yaskawa.common.loads import CourseLoad
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.shapes.course_records import BegunPath
from orchestrator.clock.base import Clock
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal


class PathContinuation:
    """The chunks of the present path of one controller."""

    def __init__(self, present: GateStart, clock: Clock, options: YaskawaOptions, refill: ContourRefill) -> None:
        self._present = present
        self._clock = clock
        self._options = options
        self._refill = refill

    async def load_chunk(self, chunk: PathChunk, mapping: TickMapping | None) -> ChunkFit:
        """Load the next chunk of the present path. Raises `Refusal`."""
        present, load = self._require_course()
        if mapping is None:
            raise Refusal("no-clock", "the controller's clock is not known", "wait a second")
        first, _ = self._options.begin_ticks(present.mapping.tick_ns, interleaved=True)
        begun_path = BegunPath(present.ticks + first, present.t0_ns)
        records = load.maker.make_next(chunk, load.records, mapping, begun_path)
        played_count = max(0, round(mapping.to_ticks(self._clock.now_ns())) - begun_path.tick) >> load.maker.interval
        present.loaded = None
        await self._refill.load(records, load.maker.room, played_count)
        present.loaded = records
        return records.fit

    async def release_chunk(self, number: int) -> None:
        """Change over to the loaded chunk. Raises `Refusal`."""
        present, load = self._require_course()
        records = present.loaded
        if records is None or records.number != number:
            raise Refusal("not-loaded", f"chunk {number} of the path is not loaded", "load it first")
        present.loaded = None
        await self._refill.release(records, load.records, load.maker.room)
        present.lowered = load.follow_records(present.lowered, records)

    def _require_course(self) -> tuple[LoadedMove, CourseLoad]:
        present = self._present.require_move()
        load = present.lowered.load.course
        if load is None:
            raise Refusal("not-a-path", "the controller executes no path that can be continued", "")
        return present, load
