"""The two slots of a controller: what each does with its move, by the resident program that executes both."""

from collections.abc import Callable, Mapping

from adapters.contract import DriverLog, HostInterval, LoadPlace, Lowered, MoveOutcome, MoveSlot, MoveSlots
from adapters.toolkit.refusals import log_refusals
from adapters.yaskawa.common.jogging import YaskawaJogging
from adapters.yaskawa.common.loads import YaskawaLowered
from adapters.yaskawa.common.start import SampleStart
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal


class SampleMover:
    """The mover of one slot. jogging: what moves by hand, which a move ends. is_following: its role, which changes with
    that of its slot."""

    def __init__(self, start: SampleStart, jogging: YaskawaJogging, log: DriverLog) -> None:
        self._start = start
        self._jogging = jogging
        self._log = log
        self.is_following = False

    async def load(
        self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None, place: LoadPlace
    ) -> Mapping[str, int]:
        """Load a move of this make. Raises `Refusal` (code `not-lowered`) for one of another make."""
        if not isinstance(lowered, YaskawaLowered):
            raise Refusal("not-lowered", "this move was lowered for another make", "lower it again")
        if place == "beside":
            return await self._load_beside(lowered, t0_ns, mapping)
        self._jogging.drop_jogs(move.axis for move in lowered.moves)
        return await self._load_at_rest(lowered, t0_ns, mapping)

    async def _load_at_rest(
        self, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping | None
    ) -> Mapping[str, int]:
        with log_refusals(self._log, "arming"):
            return await self._start.load_at_rest(lowered, t0_ns, mapping)

    async def _load_beside(self, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        # In no turn of its own: the controllers on its line move, and their watchdogs must be extended meanwhile.
        with log_refusals(self._log, "arming"):
            return await self._start.load_beside(lowered, t0_ns, mapping)

    async def verify(self) -> None:
        """Verify that its program waits."""
        with log_refusals(self._log, "the check before the commit"):
            await self._start.verify_move(self._start.require_move(following=self.is_following))

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Release its move. start_tolerance_ns: ignored, because the controller starts by its own clock."""
        del start_tolerance_ns
        with log_refusals(self._log, "the start"):
            await self._start.release_move(self._start.require_move(following=self.is_following), advance_ns)

    async def unload(self) -> None:
        """Unload its move, and with the present one the following one."""
        await (self._start.unload_beside() if self.is_following else self._start.unload_moves())

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Wait for the start of the present move."""
        with log_refusals(self._log, "the start"):
            return await self._start.wait_for_start()

    async def wait_for_end(self) -> MoveOutcome:
        """Wait for the end of the present move."""
        with log_refusals(self._log, "the end of the move"):
            outcome = await self._start.wait_for_end()
        if outcome.state != "done":
            self._log.info(f"the move ended as {outcome.state}: {outcome.reason}")
        return outcome


def make_slots(start: SampleStart, make_mover: Callable[[], SampleMover]) -> MoveSlots:
    """Return the slots of the moves of `start`."""
    movers = make_mover(), make_mover()
    movers[1].is_following = True

    def take_over() -> None:
        start.take_over()
        for mover in movers:
            mover.is_following = not mover.is_following

    return MoveSlots(MoveSlot(movers[0]), MoveSlot(movers[1]), take_over)
