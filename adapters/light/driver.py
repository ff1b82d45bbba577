"""The driver of a light controller."""

from collections.abc import Callable, Mapping, Sequence

from adapters.contract import (
    AxisReading,
    ControllerIdentity,
    ControllerReading,
    Driver,
    DriverCapabilities,
    DriverSetup,
    HostInterval,
    MoveSlot,
    MoveSlots,
)
from adapters.light.clock import LightClock
from adapters.light.lowering import LightLowered, axis_index, full_ramp, homing_speed, lower_profiles, make_costs
from adapters.light.mover import LightMover
from adapters.light.wire import (
    IDENTITY,
    LightState,
    enable_request,
    exchange,
    home_request,
    read_state,
    stop_request,
)
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile

HOMING_POLL_NS = 20 * NS_PER_MS


class LightDriver(Driver):
    """Drive one light controller."""

    def __init__(self, setup: DriverSetup) -> None:
        self._setup = setup
        self._config = setup.config
        self._indices = {name: axis_index(setup.config, name) for name in setup.config.axes}
        self._link: Link | None = None
        self._estimate = LightClock()
        self._mover = LightMover(self, setup.clock)
        self._slots = MoveSlots(MoveSlot(self._mover))
        self._power_ups = 0
        self._restarted = False
        self._stops = 0
        self._rest = b""
        self._axes: Mapping[str, AxisReading] = {}

    @property
    def link(self) -> Link:
        """The link. Raises `LinkClosed`."""
        if self._link is None:
            raise LinkClosed(f"{self._setup.controller} is not connected")
        return self._link

    def clock_mapping(self) -> TickMapping | None:
        return self._estimate.find_mapping()

    async def connect(self) -> ControllerIdentity:
        await self.close()
        self._link = await self._setup.open_link()
        self._estimate = LightClock()
        _, _, reply = await exchange(self._link, IDENTITY)
        if not reply[2:].startswith(b"tutti light "):
            raise ControllerFault("other-model", f"it calls itself {reply[2:60]!r}", "correct `adapter`")
        state = await self.read_state()
        if state.is_moving:
            raise ControllerFault("moving", "the controller moves", "wait for its end, or stop it: `tutti stop`")
        return ControllerIdentity("light", reply[2:].decode("ascii", "replace"), self._setup.controller)

    async def configure(self) -> None:
        """Read its state: there is nothing to configure."""
        await self.read_state()

    @property
    def capabilities(self) -> DriverCapabilities:
        ramp_s = max(axis.limits.velocity / axis.limits.acceleration for axis in self._config.axes.values())
        return DriverCapabilities(
            start_classes=("clock",),
            orders=(2,),
            independent_axes=False,
            costs=make_costs(ramp_s),
            compares_when_loading=True,
        )

    async def read_state(self) -> LightState:
        """Read the state, and the clock."""
        state = await read_state(self.link)
        self._estimate.add_sample(state.sent_ns, state.received_ns, state.ticks)
        if self._power_ups and state.power_ups != self._power_ups:
            self._restarted, self._estimate = True, LightClock()
            self._estimate.add_sample(state.sent_ns, state.received_ns, state.ticks)
        self._power_ups = state.power_ups
        return state

    async def poll(self) -> ControllerReading:
        state = await self.read_state()
        if state.rest != self._rest:  # at rest the readings stay what they are
            self._rest, axes = state.rest, state.axes
            self._axes = {name: _make_reading(*axes[index]) for name, index in self._indices.items()}
        is_restarted, self._restarted = self._restarted, False
        return ControllerReading(
            at_ns=(state.sent_ns + state.received_ns) // 2,
            axes=self._axes,
            restarted=is_restarted,
            sampled=HostInterval(state.sent_ns, state.received_ns),
        )

    # Steps

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> LightLowered:
        return lower_profiles(self._config, profiles, start, mapping)

    @property
    def slots(self) -> MoveSlots:
        return self._slots

    async def stop(self, *, abort: bool) -> None:
        """Stop by the ramps; an abort stops dead."""
        self._stops += 1
        await exchange(self.link, stop_request(abort=abort))
        self._mover.wake()

    # Manual operation

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        await exchange(self.link, enable_request(self._mask_of(axes), on=on))

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        """Find the reference of the axes, where they were built, at the slowest of their speeds."""
        if not axes:
            return {}
        stop_count = self._stops
        speed = min(homing_speed(self._config, name) for name in axes)
        ramp = min(full_ramp(self._config, name) for name in axes)
        await exchange(self.link, home_request(self._mask_of(axes), speed, ramp))
        state = await self.read_state()
        while state.is_moving:
            await sleep_ns(self._setup.clock, HOMING_POLL_NS)
            state = await self.read_state()
        failures: dict[str, Refusal] = {}
        for name in axes:
            if stop_count != self._stops or state.axes[self._indices[name]][0]:
                failures[name] = Refusal("homing-failed", f"axis {name} was stopped", "home it again")
            else:
                found(name)
        return failures

    async def clear_faults(self) -> None:
        """It latches nothing."""

    async def close(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            await link.close()

    def _mask_of(self, axes: Sequence[str]) -> int:
        return sum(1 << self._indices[name] for name in axes)


def _make_reading(position: int, velocity: float, bits: int) -> AxisReading:
    return AxisReading(
        commanded_counts=position,
        actual_counts=float(position),
        velocity_counts_s=velocity,
        moving=bool(bits & 1),
        enabled=bool(bits & 2),
    )
