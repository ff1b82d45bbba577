"""Drivers whose steps are executed by a mover, and drivers that keep one object for everything of their connection."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from adapters.contract import (
    ControllerIdentity,
    Driver,
    DriverLog,
    DriverSetup,
    HostInterval,
    LoadPlace,
    Lowered,
    MoveOutcome,
    MoveSlot,
    MoveSlots,
)
from adapters.toolkit.refusals import log_refusals
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal

_Move = TypeVar("_Move", bound=Lowered)
_Executed = TypeVar("_Executed", bound=Lowered, contravariant=True)


class StepMover(Protocol[_Executed]):
    """Executes the moves of one controller, one at a time, without a readable clock: each method stands for the method
    of `SlotMover` with the same purpose."""

    async def load_move(self, lowered: _Executed, t0_ns: int) -> Mapping[str, int]: ...

    async def verify_move(self) -> None: ...

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None: ...

    async def unload_move(self) -> None: ...

    async def wait_for_start(self) -> Mapping[str, HostInterval]: ...

    async def wait_for_end(self) -> MoveOutcome: ...


@runtime_checkable
class MoverBehind(Protocol):
    """A `StepMover` that loads a move faster right behind one that has just ended."""

    async def load_behind(self, lowered: Any, t0_ns: int, *, at_once: bool) -> Mapping[str, int]:
        """Load a move where the last one has ended as planned a moment ago. at_once: no `verify_move` follows, and what
        that would check is checked here. Raises `Refusal`."""
        ...


class LoggedMover(Generic[_Move]):
    """The `SlotMover` of a driver with a mover: it logs what is refused, and what ends otherwise than planned.

    kind: the class of lowered moves that the mover executes. mover: returns it, and raises `LinkClosed` where it exists
    only while the controller is connected.
    """

    def __init__(self, kind: type[_Move], mover: Callable[[], StepMover[_Move]], log: DriverLog) -> None:
        self._kind = kind
        self._mover = mover
        self._log = log

    async def load(
        self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None, place: LoadPlace
    ) -> Mapping[str, int]:
        """Have the mover load a move of the make. Raises `Refusal` (code `not-lowered`) for one of another make."""
        del mapping
        if not isinstance(lowered, self._kind):
            raise Refusal("not-lowered", "this move was lowered for another make", "lower it again")
        with log_refusals(self._log, "arming"):
            mover = self._mover()
            if place in ("behind", "at once") and isinstance(mover, MoverBehind):
                return await mover.load_behind(lowered, t0_ns, at_once=place == "at once")
            return await mover.load_move(lowered, t0_ns)

    async def verify(self) -> None:
        """Have the mover check its move."""
        with log_refusals(self._log, "the check before the commit"):
            await self._mover().verify_move()

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Have the mover schedule the start."""
        with log_refusals(self._log, "the start"):
            await self._mover().schedule_start(start_tolerance_ns, advance_ns)

    async def unload(self) -> None:
        """Have the mover unload its move."""
        await self._mover().unload_move()

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Have the mover wait for the start."""
        with log_refusals(self._log, "the start"):
            return await self._mover().wait_for_start()

    async def wait_for_end(self) -> MoveOutcome:
        """Have the mover wait for the end."""
        with log_refusals(self._log, "the end of the move"):
            outcome = await self._mover().wait_for_end()
        if outcome.state != "done":
            self._log.info(f"the move ended as {outcome.state}: {outcome.reason}")
        return outcome


class MoverDriver(Driver):
    """A driver with one slot, whose move a mover executes. kind: the class of lowered moves that this takes."""

    def __init__(self, setup: DriverSetup, kind: type[Lowered] = Lowered) -> None:
        self._setup = setup
        self._log = setup.log
        self._slots = MoveSlots(MoveSlot(LoggedMover(kind, lambda: self.mover, setup.log)))

    @property
    def slots(self) -> MoveSlots:
        return self._slots

    @property
    @abstractmethod
    def mover(self) -> StepMover[Any]:
        """The mover. Raises `LinkClosed` where it exists only while the controller is connected."""


class MoverConnection(Protocol):
    """Everything of a make that exists only while its controller is connected."""

    @property
    def mover(self) -> StepMover[Any]: ...


_Connection = TypeVar("_Connection", bound=MoverConnection)


class ConnectedDriver(MoverDriver, Generic[_Connection]):
    """A driver whose `connect` creates a connection, and whose `close` ends it."""

    def __init__(self, setup: DriverSetup, kind: type[Lowered] = Lowered) -> None:
        super().__init__(setup, kind)
        self._connection: _Connection | None = None

    def log_identity(self, place: str, identity: ControllerIdentity) -> None:
        """Log that the controller has identified itself."""
        self._log.info(
            f"connected to {identity.model} {identity.firmware}".rstrip(), place=place, serial=identity.serial
        )

    @property
    def connection(self) -> _Connection:
        """The connection. Raises `LinkClosed` when there is none."""
        if self._connection is None:
            raise LinkClosed(f"{self._setup.controller} is not connected")
        return self._connection

    @property
    def mover(self) -> StepMover[Any]:
        return self.connection.mover
