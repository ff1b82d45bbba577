"""Drivers of version 1 of the contract, for one release: such a class gets the slots of version 2.

In version 1 the present and the following move had methods of their own in the driver, and what a make did not offer
had a default there. `tutti.adapter` exports the base classes of this module: a class that derives from one of them and
defines `arm_move`, but no `slots`, is of version 1, whatever its make states.
"""

import warnings
from abc import ABCMeta
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from adapters.contract import Driver, DriverLog, HostInterval, LoadPlace, Lowered, MoveOutcome, MoveSlot, MoveSlots
from adapters.toolkit import connection
from adapters.toolkit.refusals import log_refusals
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal

_Connection = TypeVar("_Connection", bound=connection.MoverConnection)


class Version1Mover:
    """The mover of one slot, by the methods of a driver of version 1. is_following: its role, which changes with that
    of its slot."""

    def __init__(self, driver: Any, *, is_following: bool) -> None:
        self._driver = driver
        self.is_following = is_following

    async def load(
        self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None, place: LoadPlace
    ) -> Mapping[str, int]:
        """Load a move by the method of its place."""
        names = {"at rest": "arm_move", "behind": "arm_behind", "beside": "load_next"}
        return await getattr(self._driver, names[place])(lowered, t0_ns, mapping)

    async def verify(self) -> None:
        """Verify its move."""
        await (self._driver.verify_next() if self.is_following else self._driver.verify_armed())

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Release its move."""
        if self.is_following:
            await self._driver.release_next(advance_ns)
        else:
            await self._driver.go(start_tolerance_ns, advance_ns)

    async def unload(self) -> None:
        """Unload its move."""
        await (self._driver.unload_next() if self.is_following else self._driver.disarm_move())

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Wait for the start of the present move."""
        return await self._driver.wait_for_start()

    async def wait_for_end(self) -> MoveOutcome:
        """Wait for the end of the present move."""
        return await self._driver.wait_for_end()


class Version1Slots:
    """The part of a driver of version 1 that has its slots; before all of its bases."""

    _version1_slots: MoveSlots | None = None

    @property
    def slots(self) -> MoveSlots:
        """One slot, or two of a driver that defines `load_next`."""
        if self._version1_slots is None:
            self._version1_slots = self._make_version1_slots()
        return self._version1_slots

    def _make_version1_slots(self) -> MoveSlots:
        movers = Version1Mover(self, is_following=False), Version1Mover(self, is_following=True)
        if getattr(type(self), "load_next", None) is Version1Defaults.load_next:
            return MoveSlots(MoveSlot(movers[0]))
        driver: Any = self

        def take_over() -> None:
            driver.take_next()
            for mover in movers:
                mover.is_following = not mover.is_following

        return MoveSlots(MoveSlot(movers[0]), MoveSlot(movers[1]), take_over)


class Version1Defaults:
    """The defaults of version 1; behind all bases of a driver."""

    async def arm_behind(self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        """Load a move behind one that has just ended."""
        driver: Any = self
        return await driver.arm_move(lowered, t0_ns, mapping)

    async def load_next(self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        """Refuse a move beside the present one."""
        raise Refusal("no-next", "the controller cannot load a move while one runs", "")

    async def verify_next(self) -> None:
        """Refuse to verify a following move."""
        raise Refusal("not-armed", "no next move is loaded", "arm it first")

    async def release_next(self, advance_ns: int = 0) -> None:
        """Refuse to release a following move."""
        raise Refusal("not-armed", "no next move is loaded", "arm it first")

    async def unload_next(self) -> None:
        """Do nothing: there is no following move."""

    def crystal_rate(self) -> None:
        """Return nothing."""

    def start_latency(self) -> None:
        """Return nothing."""

    def forget_starts(self) -> None:
        """Do nothing."""


def _find_log(driver: object) -> DriverLog:
    log: DriverLog = vars(driver)["_log"]
    return log


class Version1MoverDefaults(Version1Defaults):
    """The same of a driver with a mover, whose methods had other names."""

    async def verify_armed(self) -> None:
        """Have the mover verify its move."""
        driver: Any = self
        with log_refusals(_find_log(self), "the check before the commit"):
            await driver.mover.verify_armed()

    async def go(self, start_tolerance_ns: int = 0, advance_ns: int = 0) -> None:
        """Have the mover schedule the start."""
        driver: Any = self
        with log_refusals(_find_log(self), "the start"):
            await driver.mover.schedule_start(start_tolerance_ns, advance_ns)

    async def disarm_move(self) -> None:
        """Have the mover unload its move."""
        driver: Any = self
        await driver.mover.disarm_move()

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Have the mover wait for the start."""
        driver: Any = self
        with log_refusals(_find_log(self), "the start"):
            return await driver.mover.wait_for_start()

    async def wait_for_end(self) -> MoveOutcome:
        """Have the mover wait for the end."""
        driver: Any = self
        with log_refusals(_find_log(self), "the end of the move"):
            outcome = await driver.mover.wait_for_end()
        if outcome.state != "done":
            _find_log(self).info(f"the move ended as {outcome.state}: {outcome.reason}")
        return outcome


class VersionMeta(ABCMeta):
    """Gives slots to driver classes of version 1."""

    def __new__(mcs, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **options: Any) -> "VersionMeta":
        """Create a driver class, of either version."""
        is_adapted = any(issubclass(base, Version1Slots) for base in bases)
        if "arm_move" in namespace and "slots" not in namespace and not is_adapted:
            has_mover = any(issubclass(base, connection.MoverDriver) for base in bases)
            bases = (Version1Slots, *bases, Version1MoverDefaults if has_mover else Version1Defaults)
            warnings.warn(
                f"the driver {namespace.get('__module__')}.{name} was written for version 1 of the contract; the next "
                "release of Tutti does not load it: give it `slots`, see `tutti.adapter` and the changelog",
                FutureWarning,
                stacklevel=2,
            )
        return super().__new__(mcs, name, bases, namespace, **options)


class PluginDriver(Driver, metaclass=VersionMeta):
    """`Driver` for plug-ins of both versions."""


class PluginMoverDriver(connection.MoverDriver, metaclass=VersionMeta):
    """`MoverDriver` for plug-ins of both versions."""


class PluginConnectedDriver(connection.ConnectedDriver[_Connection], Generic[_Connection], metaclass=VersionMeta):
    """`ConnectedDriver` for plug-ins of both versions."""
