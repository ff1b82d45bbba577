"""A make for tests of hosts and guardians: it holds a link, and can only stop."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from adapters.contract import (
    AxisReading,
    ControllerIdentity,
    ControllerReading,
    Driver,
    DriverCapabilities,
    DriverSetup,
    ExamplePlace,
    HostInterval,
    JogMove,
    LoadPlace,
    Lowered,
    Make,
    MoveOutcome,
    MoveSlot,
    MoveSlots,
)
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.state import StepCosts

DRIVER_STOP = b"ST\r"
GUARDIAN_STOP = b"\\ST\r"


class Options(BaseModel):
    pass


class FakeMover:
    """It holds no move."""

    async def load(
        self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None, place: LoadPlace
    ) -> Mapping[str, int]:
        raise NotImplementedError

    async def verify(self) -> None:
        raise NotImplementedError

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        raise NotImplementedError

    async def unload(self) -> None:
        pass

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        raise NotImplementedError

    async def wait_for_end(self) -> MoveOutcome:
        raise NotImplementedError


class FakeDriver(Driver):
    def __init__(self, setup: DriverSetup) -> None:
        self._setup = setup
        self._link: Link | None = None
        self._slots = MoveSlots(MoveSlot(FakeMover()))

    async def connect(self) -> ControllerIdentity:
        self._link = await self._setup.open_link()
        return ControllerIdentity("fake", "1", "1")

    async def configure(self) -> None:
        pass

    @property
    def capabilities(self) -> DriverCapabilities:
        costs = StepCosts(arm_ns=1_000_000, disarm_ns=1_000_000, stop_ns=1_000_000)
        return DriverCapabilities(start_classes=("host",), orders=(2,), independent_axes=False, costs=costs)

    async def poll(self) -> ControllerReading:
        axes = {name: AxisReading(0, 0.0, 0.0, False, True) for name in self._setup.config.axes}
        return ControllerReading(self._setup.clock.now_ns(), axes)

    def lower_profiles(self, profiles: object, start: object, mapping: TickMapping | None) -> Lowered:
        raise NotImplementedError

    @property
    def slots(self) -> MoveSlots:
        return self._slots

    async def stop(self, *, abort: bool) -> None:
        if self._link is None:
            raise LinkClosed("not connected")
        self._link.write(DRIVER_STOP)

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        pass

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        raise NotImplementedError

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        raise NotImplementedError

    async def stop_axes(self, axes: Sequence[str]) -> None:
        raise NotImplementedError

    async def set_output(self, number: int, *, on: bool) -> None:
        pass

    async def clear_faults(self) -> None:
        pass

    async def send_raw(self, command: str) -> str:
        return command

    async def close(self) -> None:
        if self._link is not None:
            await self._link.close()


class FakeMake:
    name = "fake"
    options_model: type[BaseModel] = Options
    serial_defaults: Mapping[str, Any] = {}

    def check_config(self, config: Controller) -> None:
        pass

    def fleet_example(self, place: ExamplePlace) -> str:
        raise NotImplementedError

    def create_driver(self, setup: DriverSetup) -> Driver:
        return FakeDriver(setup)

    def stop_bytes(self, config: Controller) -> bytes:
        return GUARDIAN_STOP


MAKE: Make = FakeMake()
