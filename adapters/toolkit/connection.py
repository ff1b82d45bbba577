"""Drivers whose steps are executed by a mover, and drivers that keep one object for everything of their connection."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Generic, Protocol, TypeVar

from adapters.contract import ControllerIdentity, Driver, DriverSetup, HostInterval, MoveOutcome
from adapters.toolkit.refusals import log_refusals
from orchestrator.link.base import LinkClosed


class StepMover(Protocol):
    """Executes the steps of one controller: each method stands for the method of `Driver` with the same purpose."""

    async def verify_armed(self) -> None: ...

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None: ...

    async def disarm_move(self) -> None: ...

    async def wait_for_start(self) -> Mapping[str, HostInterval]: ...

    async def wait_for_end(self) -> MoveOutcome: ...


class MoverDriver(Driver):
    """A driver that delegates its steps to a mover, and logs refused ones."""

    def __init__(self, setup: DriverSetup) -> None:
        self._setup = setup
        self._log = setup.log

    @property
    @abstractmethod
    def mover(self) -> StepMover:
        """The mover. Raises `LinkClosed` where it exists only while the controller is connected."""

    async def verify_armed(self) -> None:
        with log_refusals(self._log, "the check before the commit"):
            await self.mover.verify_armed()

    async def go(self, start_tolerance_ns: int = 0, advance_ns: int = 0) -> None:
        with log_refusals(self._log, "the start"):
            await self.mover.schedule_start(start_tolerance_ns, advance_ns)

    async def disarm_move(self) -> None:
        await self.mover.disarm_move()

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        with log_refusals(self._log, "the start"):
            return await self.mover.wait_for_start()

    async def wait_for_end(self) -> MoveOutcome:
        with log_refusals(self._log, "the end of the move"):
            outcome = await self.mover.wait_for_end()
        if outcome.state != "done":
            self._log.info(f"the move ended as {outcome.state}: {outcome.reason}")
        return outcome


class MoverConnection(Protocol):
    """Everything of a make that exists only while its controller is connected."""

    @property
    def mover(self) -> StepMover: ...


_Connection = TypeVar("_Connection", bound=MoverConnection)


class ConnectedDriver(MoverDriver, Generic[_Connection]):
    """A driver whose `connect` creates a connection, and whose `close` ends it."""

    def __init__(self, setup: DriverSetup) -> None:
        super().__init__(setup)
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
    def mover(self) -> StepMover:
        return self.connection.mover
