"""The substitute for a make whose plug-in cannot be used: its controllers never connect, and show the reason."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

from pydantic import BaseModel, ConfigDict

from adapters.abilities import SharedLineDriver
from adapters.contract import (
    ControllerIdentity,
    ControllerReading,
    Driver,
    DriverCapabilities,
    DriverSetup,
    ExamplePlace,
    Lowered,
)
from adapters.toolkit.connection import MoverDriver, StepMover
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.plugins import PluginError
from orchestrator.model.profile import Profile
from orchestrator.model.state import StepCosts


class _AnyOptions(BaseModel):
    """Options that only the make itself could check."""

    model_config = ConfigDict(extra="allow", frozen=True)


class UnusableMake:
    """A make whose plug-in is installed and cannot be used. error: why."""

    options_model: type[BaseModel] = _AnyOptions
    serial_defaults: Mapping[str, Any] = {}

    def __init__(self, name: str, error: PluginError) -> None:
        self.name = name
        self._error = error

    def check_config(self, config: Controller) -> None:
        """Only the make itself could check it."""
        del config

    def fleet_example(self, place: ExamplePlace) -> NoReturn:
        raise self._error

    def create_driver(self, setup: DriverSetup) -> Driver:
        return _UnusableDriver(setup, self._error)

    def stop_bytes(self, config: Controller) -> bytes:
        """Return nothing: without the make its stop is unknown."""
        del config
        return b""


class _UnusableDriver(MoverDriver, SharedLineDriver):
    """The driver of a controller that cannot be reached: `connect` raises the reason, everything else `LinkClosed`."""

    def __init__(self, setup: DriverSetup, error: PluginError) -> None:
        super().__init__(setup)
        self._controller = setup.controller
        self._error = error

    def _raise_closed(self) -> NoReturn:
        raise LinkClosed(f"{self._controller} is not connected: {self._error.text}")

    async def connect(self) -> ControllerIdentity:
        raise ControllerFault("plug-in", self._error.text, self._error.remedy)

    async def configure(self) -> None:
        self._raise_closed()

    @property
    def capabilities(self) -> DriverCapabilities:
        costs = StepCosts(arm_ns=1, disarm_ns=1, stop_ns=1)
        return DriverCapabilities(start_classes=(), orders=(2,), independent_axes=False, costs=costs)

    async def poll(self) -> ControllerReading:
        self._raise_closed()

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> Lowered:
        raise Refusal("plug-in", self._error.text, self._error.remedy)

    @property
    def mover(self) -> StepMover[Lowered]:
        self._raise_closed()

    async def stop(self, *, abort: bool) -> None:
        self._raise_closed()

    async def stop_before_connect(self) -> bool:
        raise LinkRefused(f"{self._controller} cannot be stopped: {self._error.text}")

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        self._raise_closed()

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        self._raise_closed()

    async def clear_faults(self) -> None:
        self._raise_closed()

    async def send_raw(self, command: str) -> str:
        self._raise_closed()

    async def close(self) -> None:
        """Do nothing: there is no link."""
