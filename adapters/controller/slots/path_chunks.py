"""A path in chunks: each is loaded while the controller executes the one before it, and released by all members."""

import asyncio

from adapters.abilities import PathDriver
from adapters.contract import ChunkFit, ChunkInstants, PathChunk
from adapters.controller.slots.fleet_durations import make_fleet_time_term
from adapters.controller.slots.present_motion import PresentMotion
from adapters.controller.state.armed_step import ArmedStep
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.fleet import FleetScale
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import (
    BudgetTerm,
    ChunkReply,
    ChunkTrigger,
    LoadChunkRequest,
    ReleaseChunkRequest,
    Reply,
)


class PathChunks:
    """The chunks of the present path of one controller."""

    def __init__(self, present: PresentMotion) -> None:
        driver = present.context.driver
        self._present = present
        self._loader = driver if isinstance(driver, PathDriver) else None
        self._lock = asyncio.Lock()
        self._loaded: tuple[PathChunk, ChunkFit] | None = None

    async def load(self, request: LoadChunkRequest) -> ChunkReply:
        """Load the next chunk, with the present clock mapping; it is not executed yet. One that is still being loaded
        is given up: a hold does not wait. Raises `Refusal`."""
        step = self._require_step(request)
        self._loaded = None
        profiles = self._present.take_profiles(request, step, "a chunk moves the axes of its path")
        options, context = request.chunk, self._present.context
        scale = context.require_scale()
        chunk = PathChunk(
            request.number,
            _to_host_s(request.begin_s, step, scale),
            _to_host_s(options.end_s, step, scale),
            options.last,
            profiles,
            {trigger.output: _to_host_instants(trigger, step, scale) for trigger in request.triggers},
        )
        if self._loader is None:
            raise Refusal("no-chunks", "the controller cannot load a path while it executes it", "")
        fit = await self._loader.load_chunk(chunk, context.driver.clock_mapping())
        self._require_step(request)
        self._loaded = chunk, fit
        return ChunkReply(
            stop_s=_to_fleet_s(fit.stop_s, step, scale),
            drift_ns=fit.drift_ns,
            left_ns=fit.left_ns,
            bound_ns=fit.bound_ns + scale.bound_at_ns(step.t0_host_ns + round(fit.stop_s * NS_PER_S)),
            path_error_counts=dict(fit.path_error_counts),
            triggers={output: _state_terms(terms, chunk, step, scale) for output, terms in fit.triggers.items()},
        )

    async def release(self, request: ReleaseChunkRequest) -> Reply:
        """Change over to the loaded chunk. Raises `Refusal` (code `late`): the present one is executed to its end."""
        async with self._lock:
            step, loaded_chunk = self._require_step(request), self._loaded
            if self._loader is None or loaded_chunk is None or loaded_chunk[0].number != request.number:
                raise Refusal("not-loaded", f"chunk {request.number} is not loaded", "load it first")
            self._loaded = None
            chunk, fit = loaded_chunk
            step.widen_ways(chunk.profiles, fit.path_error_counts)
            await self._loader.release_chunk(request.number)
            self._require_step(request)
            # What the step has promised so far grows with every chunk.
            step.promised_s.update(dict.fromkeys(step.promised_s, fit.stop_s))
            step.note_ends(chunk.profiles)
            return Reply()

    def _require_step(self, request: LoadChunkRequest | ReleaseChunkRequest) -> ArmedStep:
        self._present.fence.require_no_estop()
        step = self._present.find_step(request)
        if step is None:
            raise self._present.refuse_absent(request)
        if not step.executes:
            raise Refusal("wrong-phase", f"the path is {step.phase.value}, not moving", "")
        return step


def _to_host_instants(trigger: ChunkTrigger, step: ArmedStep, scale: FleetScale) -> ChunkInstants:
    instants_ns = (round(_to_host_s(at_ns / NS_PER_S, step, scale) * NS_PER_S) for at_ns in trigger.instants_ns)
    return ChunkInstants(trigger.first, tuple(instants_ns))


def _state_terms(
    terms: tuple[BudgetTerm, ...], chunk: PathChunk, step: ArmedStep, scale: FleetScale
) -> list[BudgetTerm]:
    if scale.is_exact:
        return list(terms)
    return [*terms, make_fleet_time_term(scale, step.t0_host_ns + round(chunk.end_s * NS_PER_S))]


def _to_host_s(after_s: float, step: ArmedStep, scale: FleetScale) -> float:
    """An instant of a path, s of fleet time after its T0, by the clock of this computer: what that has drifted from
    fleet time since is in it. Nothing changes beside the coordinator."""
    if scale.is_exact:
        return after_s
    return (scale.to_host_ns(step.t0_fleet_ns + round(after_s * NS_PER_S)) - step.t0_host_ns) / NS_PER_S


def _to_fleet_s(after_s: float, step: ArmedStep, scale: FleetScale) -> float:
    """The reverse of `_to_host_s`."""
    if scale.is_exact:
        return after_s
    return (scale.to_fleet_ns(step.t0_host_ns + round(after_s * NS_PER_S)) - step.t0_fleet_ns) / NS_PER_S
