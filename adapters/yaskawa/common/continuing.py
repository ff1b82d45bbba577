"""What continues the present move on the way: the next chunk of a path, and a farther target.

A move of one axis is sent farther by `IP` (SMC-4000: L6255-6281; SMC-2000: L9465-9517).
"""

import math
from collections.abc import Mapping
from dataclasses import replace

from adapters.contract import ChunkFit, PathChunk
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.gate_start import GateStart
from adapters.yaskawa.common.lines import PartRelease
from adapters.yaskawa.common.loaded import LoadedChunk, LoadedMove
from adapters.yaskawa.common.loads import CourseLoad, RegisterLoad
from adapters.yaskawa.common.lowering import stays_near_plan
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.shapes.course_records import BegunPath, ChunkRecords
from adapters.yaskawa.shapes.trapezoid import braking_sample, extend_shape
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.record import AXIS_LETTERS
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import BudgetTerm
from orchestrator.model.profile import Profile

# Before it brakes: the commands that decide and move farther, each behind one of every other thread.
MARGIN_TICKS = 32
EXTENSION_EXCHANGES = 4


class PathContinuation:
    """The chunks of the present path of one controller."""

    def __init__(self, present: GateStart, device: SmcDevice, clock: Clock, options: YaskawaOptions) -> None:
        self._present = present
        self._device = device
        self._clock = clock
        self._options = options
        self._refill = present.refill
        self._loads = 0

    async def load_chunk(self, chunk: PathChunk, mapping: TickMapping | None) -> ChunkFit:
        """Load the next chunk of the present path, and its triggers. Raises `Refusal`."""
        present = self._present.require_move()
        if mapping is None:
            raise Refusal("no-clock", "the controller's clock is not known", "wait a second")
        self._loads += 1
        load, end_ns, present.loaded = self._loads, round(chunk.end_s * NS_PER_S), None
        records = await self._load_records(chunk, mapping) if chunk.profiles else None
        triggers: dict[str, tuple[BudgetTerm, ...]] = {}
        for output, instants in chunk.triggers.items():
            clock_term = await self._present.player.load_part(instants, end_ns, mapping)
            armed_terms = present.lowered.triggers[output]
            triggers[output] = (clock_term, *(term for term in armed_terms if term.name != clock_term.name))
        if load != self._loads:
            raise Refusal("superseded", "another chunk is loaded in its place", "")
        present.loaded = LoadedChunk(chunk.number, end_ns, records)
        if records is not None:
            return replace(records.fit, triggers=triggers)
        return ChunkFit(chunk.stop_s, 0, 0, mapping.bound_at_ns(present.t0_ns + end_ns), {}, triggers)

    async def _load_records(self, chunk: PathChunk, mapping: TickMapping) -> ChunkRecords:
        present, load = self._require_course()
        first, _ = self._options.begin_ticks(present.mapping.tick_ns, interleaved=True)
        begun_path = BegunPath(present.ticks + first, present.t0_ns)
        records = load.maker.make_next(chunk, load.records, mapping, begun_path)
        played_count = max(0, round(mapping.to_ticks(self._clock.now_ns())) - begun_path.tick) >> load.maker.interval
        await self._refill.load(records, load.maker.room, played_count)
        return records

    async def release_chunk(self, number: int) -> None:
        """Change over to the loaded chunk, its triggers included. Raises `Refusal`."""
        present = self._present.require_move()
        chunk, switches = present.loaded, present.lowered.switches
        if chunk is None or chunk.number != number:
            raise Refusal("not-loaded", f"chunk {number} of the path is not loaded", "load it first")
        present.loaded = None
        release = None if switches is None else self._present.player.plan_release()
        if chunk.records is not None:
            _, load = self._require_course()
            await self._refill.release(chunk.records, load, release)
            present.lowered = load.follow_records(present.lowered, chunk.records)
        elif switches is not None:
            await self._release_triggers(present, min(switches.last_ns, chunk.end_ns), release)
        if switches is not None:
            self._present.player.take_part()
            present.lowered = replace(present.lowered, switches=replace(switches, end_ns=chunk.end_ns))

    async def _release_triggers(self, present: LoadedMove, by_ns: int, release: PartRelease | None) -> None:
        """Release the triggers of a controller that executes no part of the path. by_ns: after T0, where they begin or
        end. Raises `Refusal`."""
        if self._clock.now_ns() >= present.t0_ns + by_ns:
            raise Refusal("late", "the end of the triggers that are released is past", "")
        if release is not None:
            mapping = self._device.samples.current_mapping() or present.mapping
            by_ticks = round(mapping.to_ticks(present.t0_ns + by_ns)) - release.ahead_ticks
            await self._refill.release_triggers(release.place, by_ticks)

    def _require_course(self) -> tuple[LoadedMove, CourseLoad]:
        present = self._present.require_move()
        load = present.lowered.load.course
        if load is None:
            raise Refusal("not-a-path", "the controller executes no path that can be continued", "")
        return present, load


class MoveExtension:
    """Moves of one axis, by registers, that are sent farther."""

    def __init__(self, device: SmcDevice, clock: Clock) -> None:
        self._device = device
        self._clock = clock

    async def extend(self, loaded: LoadedMove, profiles: Mapping[str, Profile], from_s: float) -> Mapping[str, float]:
        """Send the present move farther, and return how long it takes, by axis, s. from_s: by when after T0 the
        controller has certainly been asked. Raises `Refusal`.

        IP on an axis at rest would begin a move, and on one that brakes it is refused (code 16): the controller itself
        multiplies it by whether the same move still goes on, and does not brake. What it is to load is read back
        before, because on a serial line nothing else detects a garbled digit. Its variables are set only here.
        """
        load, moves = loaded.lowered.load, loaded.lowered.moves
        if not isinstance(load, RegisterLoad) or len(moves) != 1 or not moves[0].samples or loaded.begun_ticks is None:
            raise Refusal("no-retarget", "the controller executes no move of one axis by its registers")
        (move,), (profile,) = moves, profiles.values()
        shape, extra_counts = load.shapes[move.index], profile.end_counts - move.end
        if extra_counts * shape.distance <= 0 or abs(shape.distance + extra_counts) >= 2**31:
            raise Refusal("no-retarget", f"axis {move.axis} cannot be sent farther by {extra_counts} counts")
        tick_ns = loaded.mapping.tick_ns
        farther_shape = extend_shape(shape, extra_counts)
        farther_shape = replace(farther_shape, off=farther_shape.length - profile.duration_s * 1e9 / tick_ns)
        error_counts = shape.path_error_counts + abs(farther_shape.off) * profile.peak_velocity * tick_ns * 1e-9
        farther_shape = replace(farther_shape, path_error_counts=error_counts)
        if not stays_near_plan(farther_shape, profile, tick_ns):
            raise Refusal("no-retarget", f"axis {move.axis} would be {error_counts:.0f} counts from its plan")
        by_ticks = loaded.begun_ticks + math.floor(braking_sample(shape)) - MARGIN_TICKS
        if from_s * 1e9 >= (by_ticks - loaded.begun_ticks) * tick_ns:
            raise _make_late_refusal(move.axis)
        await self._send(loaded, move.index, extra_counts, by_ticks)
        durations_s = {move.axis: farther_shape.length * tick_ns * 1e-9}
        loaded.lowered = replace(
            loaded.lowered,
            durations_s=durations_s,
            path_error_counts={move.axis: error_counts},
            moves=(replace(move, end=profile.end_counts, samples=farther_shape.whole_samples),),
            load=RegisterLoad({move.index: profile.end_counts}, {move.index: farther_shape}),
        )
        return durations_s

    async def _send(self, loaded: LoadedMove, index: int, extra_counts: int, by_ticks: int) -> None:
        """Send IP before a sample. Raises `Refusal`."""
        session, letter = self._device.session, AXIS_LETTERS[index]
        mapping = self._device.samples.current_mapping() or loaded.mapping
        if mapping.to_ticks(self._clock.now_ns()) >= by_ticks:
            raise _make_late_refusal(letter)
        try:
            await session.send_settings((f"XIN={extra_counts}", f"XIT={by_ticks}"))
            held_values, _ = await session.read_numbers("XIN", "XIT")
            if [int(value) for value in held_values] != [extra_counts, by_ticks]:
                raise Refusal("read-back", "the distance to move farther reads back as another one", "try again")
            guard = f"(TIME<XIT)*(XT0={loaded.ticks})*_BG{letter}"
            await session.send_command(f"IP {',' * index}XIN*{guard}")
        except SmcCommandRefused as refusal:
            raise Refusal("late", f"axis {letter} is not sent farther: {refusal}", "wait for its end") from None
        # What holds after it held when the command was executed.
        (is_taken,), _ = await session.read_numbers(guard)
        if not is_taken:
            raise _make_late_refusal(letter)


def _make_late_refusal(axis: str) -> Refusal:
    return Refusal("late", f"axis {axis} brakes already, or is about to", "wait for its end")
