"""A path in chunks: each is loaded while the controller executes the one before it, and released by all members."""

import asyncio

from adapters.abilities import PathDriver
from adapters.contract import PathChunk
from adapters.controller.slots.fleet_durations import to_host_profiles
from adapters.controller.state.armed_step import ArmedStep, StepPhase
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.fencing import EpochFence
from adapters.controller.state.leases import MotionLeases
from adapters.controller.state.limits import check_path_limits
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.fleet import FleetScale
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import ChunkReply, LoadChunkRequest, ReleaseChunkRequest, Reply
from orchestrator.model.steps.numbers import name_step


class PathChunks:
    """The chunks of the present path of one controller."""

    def __init__(
        self,
        context: ControllerContext,
        steps: LoadedSteps,
        fence: EpochFence,
        leases: MotionLeases,
        status: ControllerStatus,
    ) -> None:
        self._context = context
        self._steps = steps
        self._loader = context.driver if isinstance(context.driver, PathDriver) else None
        self._fence = fence
        self._leases = leases
        self._status = status
        self._lock = asyncio.Lock()
        self._loaded: tuple[PathChunk, float] | None = None

    async def load(self, request: LoadChunkRequest) -> ChunkReply:
        """Load the next chunk, with the present clock mapping; it is not executed yet. One that is still being loaded
        is given up: a hold does not wait. Raises `Refusal`."""
        step = self._require_step(request)
        self._loaded = None
        if set(request.profiles) != set(step.axes):
            raise Refusal("other-axes", "a chunk moves the axes of its path", "")
        self._leases.require_lease(request.job, request.profiles)
        check_path_limits(self._status, request.profiles)
        options, scale = request.chunk, self._context.require_scale()
        chunk = PathChunk(
            request.number,
            _to_host_s(request.begin_s, step, scale),
            _to_host_s(options.end_s, step, scale),
            options.last,
            to_host_profiles(request.profiles, scale),
        )
        if self._loader is None:
            raise Refusal("no-chunks", "the controller cannot load a path while it executes it", "")
        fit = await self._loader.load_chunk(chunk, self._context.driver.clock_mapping())
        self._require_step(request)
        self._loaded = chunk, fit.stop_s
        return ChunkReply(
            stop_s=_to_fleet_s(fit.stop_s, step, scale),
            drift_ns=fit.drift_ns,
            left_ns=fit.left_ns,
            bound_ns=fit.bound_ns + scale.bound_at_ns(step.t0_host_ns + round(fit.stop_s * NS_PER_S)),
            path_error_counts=dict(fit.path_error_counts),
        )

    async def release(self, request: ReleaseChunkRequest) -> Reply:
        """Change over to the loaded chunk. Raises `Refusal` (code `late`): the present one is executed to its end."""
        async with self._lock:
            step, loaded_chunk = self._require_step(request), self._loaded
            if self._loader is None or loaded_chunk is None or loaded_chunk[0].number != request.number:
                raise Refusal("not-loaded", f"chunk {request.number} is not loaded", "load it first")
            self._loaded = None
            await self._loader.release_chunk(request.number)
            self._require_step(request)
            # What the step has promised so far grows with every chunk.
            step.promised_s.update(dict.fromkeys(step.promised_s, loaded_chunk[1]))
            return Reply()

    def _require_step(self, request: LoadChunkRequest | ReleaseChunkRequest) -> ArmedStep:
        self._fence.require_no_estop()
        step = self._steps.present
        if step is None or not step.is_for(request, request.t0_fleet_ns):
            raise Refusal("not-moving", f"job {request.job} {name_step(request.step)} is not being executed", "")
        if step.phase not in (StepPhase.RELEASED, StepPhase.MOVING):
            raise Refusal("wrong-phase", f"the path is {step.phase.value}, not moving", "")
        return step


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
