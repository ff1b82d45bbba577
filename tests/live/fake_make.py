"""A make for tests of hosts and guardians: it holds a link, and knows nothing but how to stop."""

from collections.abc import Callable, Mapping, Sequence

from pydantic import BaseModel

from adapters.contract import (
    AxisReading,
    CannotDo,
    Capabilities,
    Driver,
    Identity,
    JogMove,
    Lowered,
    Outcome,
    Reading,
    Setup,
    Span,
)
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.fleet import Controller
from orchestrator.model.state import Costs

DRIVER_STOP = b"ST\r"
GUARDIAN_STOP = b"\\ST\r"


class Options(BaseModel):
    pass


class FakeDriver(Driver):
    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._link: Link | None = None

    async def connect(self) -> Identity:
        self._link = await self._setup.open_link()
        return Identity("fake", "1", "1")

    async def configure(self) -> None:
        pass

    @property
    def capabilities(self) -> Capabilities:
        costs = Costs(arm_ns=1_000_000, disarm_ns=1_000_000, stop_ns=1_000_000)
        return Capabilities(start_classes=("host",), orders=(2,), independent_axes=False, costs=costs)

    async def poll(self) -> Reading:
        axes = {name: AxisReading(0, 0.0, 0.0, False, True) for name in self._setup.config.axes}
        return Reading(self._setup.clock.now_ns(), axes)

    def lower(self, profiles: object, start: object, mapping: TickMapping | None) -> Lowered:
        raise NotImplementedError

    async def arm(self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        raise NotImplementedError

    async def verify(self) -> None:
        raise NotImplementedError

    async def go(self, slack_ns: int = 0) -> None:
        raise NotImplementedError

    async def disarm(self) -> None:
        pass

    async def started(self) -> Mapping[str, Span]:
        raise NotImplementedError

    async def outcome(self) -> Outcome:
        raise NotImplementedError

    async def stop(self, abort: bool) -> None:
        if self._link is None:
            raise LinkClosed("not connected")
        self._link.write(DRIVER_STOP)

    async def enable(self, axes: Sequence[str], on: bool) -> None:
        pass

    async def home(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        raise NotImplementedError

    async def jog(self, axis: str, move: JogMove) -> None:
        raise NotImplementedError

    async def stop_axes(self, axes: Sequence[str]) -> None:
        raise NotImplementedError

    async def set_output(self, number: int, on: bool) -> None:
        pass

    async def clear_faults(self) -> None:
        pass

    async def raw(self, command: str) -> str:
        return command

    async def close(self) -> None:
        if self._link is not None:
            await self._link.close()


class FakeMake:
    name = "fake"
    options = Options

    def check(self, config: Controller) -> None:
        pass

    def driver(self, setup: Setup) -> Driver:
        return FakeDriver(setup)

    def stop_bytes(self, config: Controller) -> bytes:
        return GUARDIAN_STOP


MAKE = FakeMake()
