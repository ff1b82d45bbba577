"""A start at a sample: loaded, released at the gate, watched, and reported by the program's own evidence."""

from collections.abc import Mapping

from adapters.contract import ChunkFit, HostInterval, MoveOutcome, PathChunk
from adapters.yaskawa.common.continuing import MoveExtension, PathContinuation
from adapters.yaskawa.common.course_refill import ContourRefill
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.ending import SampleEnd
from adapters.yaskawa.common.following import FollowingStart
from adapters.yaskawa.common.gate_start import GateStart
from adapters.yaskawa.common.lines import OutputPlayer
from adapters.yaskawa.common.loaded import LoadedMove
from adapters.yaskawa.common.loads import YaskawaLowered
from adapters.yaskawa.common.options import YaskawaOptions
from orchestrator.clock.base import Clock
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.profile import Profile


class SampleStart:
    """The move that the resident program executes, and one that follows it."""

    GATE_START = GateStart
    SAMPLE_END = SampleEnd

    def __init__(self, device: SmcDevice, clock: Clock, options: YaskawaOptions, player: OutputPlayer) -> None:
        refill = ContourRefill(device)
        self._device = device
        self._present = self.GATE_START(device, clock, options, refill, player)
        self._following = FollowingStart(device, clock, options)
        self._path = PathContinuation(self._present, device, clock, options)
        self._end = self.SAMPLE_END(device, clock, options, self._following, player)
        self._extension = MoveExtension(device, clock)
        self.player = player

    # Before T0

    async def load_at_rest(self, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        """Load the present move, whose program runs to its gate. Raises `Refusal`."""
        return await self._present.load_move(lowered, t0_ns, mapping)

    async def load_beside(self, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        """Load the following move, whose program waits for the end of the present one. Raises `Refusal`."""
        if mapping is None:
            raise Refusal("no-clock", "the controller's clock is not known yet", "wait a second")
        return await self._following.load_move(self._present.require_move(), lowered, t0_ns, mapping)

    async def verify_move(self, loaded: LoadedMove) -> None:
        """Verify, before the commit, that the program of the move waits. Raises `Refusal`."""
        # One that was loaded behind another move is loaded in its own way, also when that has ended.
        await (self._following if loaded.follows else self._present).verify_move(loaded)

    async def release_move(self, loaded: LoadedMove, advance_ns: int) -> None:
        """Let the program of the move start it at its sample. Raises `Refusal`."""
        await (self._following if loaded.follows else self._present).release_move(loaded, advance_ns)

    async def unload_moves(self) -> None:
        """Ensure that the program starts nothing, now or later."""
        self.drop_move()
        session = self._device.session
        await self._device.unload_program()
        await session.send_settings(("XGO=0", "XFGO=0"))
        thread_states, _ = await session.read_numbers(*(f"_HX{thread}" for thread in self._device.STEP_THREADS))
        if any(thread_states):
            raise ControllerFault("not-halted", "the waiting program does not halt", "reset the controller")

    def drop_move(self) -> None:
        """Drop the loaded moves: the controller no longer has them."""
        self._present.move = self._following.move = None

    def require_move(self, *, following: bool) -> LoadedMove:
        """Return the present move, or the following one. Raises `Refusal` (code `not-armed`)."""
        return self._following.require_move() if following else self._present.require_move()

    async def unload_beside(self) -> None:
        """Unload the following move; the present one continues."""
        await self._following.unload_move()

    def take_over(self) -> None:
        """The present move has ended: the following one is the present one."""
        self._present.move, self._following.move = self._following.require_move(), None

    # A path in chunks

    async def load_chunk(self, chunk: PathChunk, mapping: TickMapping | None) -> ChunkFit:
        """Load the next chunk of the present path. Raises `Refusal`."""
        return await self._path.load_chunk(chunk, mapping)

    async def release_chunk(self, number: int) -> None:
        """Change over to the loaded chunk. Raises `Refusal`."""
        await self._path.release_chunk(number)

    # Another target

    async def extend_move(self, profiles: Mapping[str, Profile], from_s: float) -> Mapping[str, float]:
        """Send the present move farther, and return how long it takes, by axis, s. from_s: by when after T0 the
        controller has been asked. Raises `Refusal`."""
        if self._following.move is not None:
            raise Refusal("no-retarget", "another move is loaded behind the present one", "unload it first")
        return await self._extension.extend(self._present.require_move(), profiles, from_s)

    # After T0

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axes began. Raises `ControllerFault`."""
        return await self._present.wait_for_start()

    async def wait_for_end(self) -> MoveOutcome:
        """Watch until no axis of the step moves, then return how it ended."""
        return await self._end.wait_for_end(self._present.require_move())
