"""The axis moved by hand: homing by the drive's own methods, and jogs.

A jog is a set-point at the end of its way, changed at once: so the drive itself ends it there, which profile velocity
mode would not, and a host that dies leaves a motion with an end.
"""

from collections.abc import Callable, Mapping, Sequence

from adapters.cia402 import objects as o
from adapters.cia402 import states
from adapters.cia402.fleetaxes import POSITION_MAX, homing_method, homing_numbers, only_axis, units
from adapters.cia402.node import Node
from adapters.cia402.options import Options
from adapters.cia402.power import Power
from adapters.cia402.sdo import SdoAborted
from adapters.cia402.shape import WORD_MAX
from adapters.cia402.states import State
from adapters.contract import CannotDo, JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Controller

_ROUNDING = 1e-9
_LONGEST_NS = 2**62
_SEEN_NS = 20 * NS_PER_MS
_RETURN_NS = 60 * NS_PER_S  # a caller whose patience ends earlier cancels
_AT_LIMITS = (1, 2, 17, 18)
"""Methods whose reference is at the edge of a limit switch, or near it."""


class Hand:
    """Homing and jogs of one connection. step: whether a step is loaded or under way."""

    def __init__(
        self, config: Controller, options: Options, node: Node, power: Power, step: Callable[[], bool]
    ) -> None:
        self._name, self._axis = only_axis(config)
        self._options = options
        self._node = node
        self._power = power
        self._step = step
        self.homing = False
        self._jog_stops = self._jog_drops = -1
        self._jog_ns = 0

    @property
    def jogging(self) -> bool:
        """A jog is under way: it was not stopped, the drive has been enabled all the while, and is not at its end."""
        node = self._node
        if (self._jog_stops, self._jog_drops) != (node.stops, node.drops) or not node.enabled:
            return False
        late = node.clock.now_ns() > self._jog_ns + _SEEN_NS
        return not (late and bool(node.status & states.TARGET_REACHED))

    # Homing

    async def home(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        """Find the reference; returns when the axis has come to rest. Raises `CannotDo`."""
        del axes
        node = self._node
        stops = node.stops
        await self._power.stopped()
        node.require_well()
        if not node.enabled:
            raise CannotDo("not-enabled", f"axis {self._name} is not enabled", f"enable {self._name} first")
        if self._step() or self.homing or self.jogging:
            raise CannotDo("busy", "a motion is loaded or under way", "disarm or stop it")
        self.homing = True
        try:
            await self._load_homing()
            if node.stops != stops:
                raise CannotDo("stopped", f"axis {self._name} was stopped before it began to look", "")
            return await self._search(found)
        except BaseException:
            try:
                if node.enabled:
                    self._power.stop(False)
            except LinkClosed:
                pass
            raise
        finally:
            self.homing = False

    async def _load_homing(self) -> None:
        node = self._node
        method = homing_method(self._axis)
        switch, zero, ramp = homing_numbers(self._axis, self._options)
        for obj, value in (
            (o.HOMING_METHOD, method),
            (o.HOMING_SWITCH_SPEED, switch),
            (o.HOMING_ZERO_SPEED, zero),
            (o.HOMING_ACCELERATION, ramp),
            (o.HOME_OFFSET, 0),
        ):
            try:
                await node.sdo.write(obj, value)
            except SdoAborted as error:
                raise CannotDo(
                    "homing-method",
                    f"axis {self._name}: {error}",
                    "choose another `homing.method`, or other homing speeds",
                ) from None
        node.order(states.ENABLE, o.HOMING_MODE)
        if not await node.soon(lambda: node.mode == o.HOMING_MODE):
            await node.look()
            raise CannotDo("wrong-mode", f"{node.name} does not go over to homing mode", "does it have it (6502h)?")

    async def _search(self, found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        node = self._node
        stops, boots, left = node.stops, node.boots, node.left_bus
        node.order(states.ENABLE | states.NEW_SET_POINT)
        # Before it has begun it may still show that an earlier one was attained.
        await node.until(
            lambda: not node.status & states.TARGET_REACHED or node.stops != stops, node.clock.now_ns() + _SEEN_NS
        )

        def troubled() -> bool:
            return (
                node.stops != stops or node.boots != boots or node.left_bus != left or node.state is not State.ENABLED
            )

        def attained() -> bool:
            return bool(node.status & states.ACKNOWLEDGED and node.status & states.TARGET_REACHED)

        await node.until(
            lambda: troubled() or attained() or bool(node.status & states.MODE_ERROR), node.clock.now_ns() + _LONGEST_NS
        )
        if not troubled() and attained():
            await self._to_reference(stops)
        if not troubled() and (node.demand == 0 or not self._returns):
            node.moved_ns = 0  # it rests; what its position has done was the new origin
            found(self._name)
            return {}
        if node.stops != stops:
            why = "it was stopped"
        elif node.boots != boots:
            why = "it was switched off and on"
        elif node.left_bus != left:
            why = "this computer has left the bus (bus-off)"
        elif node.state is not State.ENABLED:
            why = f"it is {node.state.value}: {node.why()}"
        else:
            why = "the drive says that its homing has failed, or does not come back to its reference"
            node.order(states.ENABLE)
        text = f"axis {self._name} has not found its reference: {why}"
        return {self._name: CannotDo("homing-failed", text, "look at its switches, and at `homing.method`")}

    @property
    def _returns(self) -> bool:
        """Whether it is brought to its reference at last; one at the edge of a limit switch is left alone."""
        return homing_method(self._axis) not in _AT_LIMITS

    async def _to_reference(self, stops: int) -> None:
        """The drive stops behind the edge that it has found, or the index: go back there."""
        node = self._node
        node.order(states.ENABLE)
        # The demand from the new origin comes with the next TPDO.
        since_ns = node.clock.now_ns()
        await node.soon(lambda: node.state_ns > since_ns)
        if node.demand and self._returns:
            _, zero, ramp = homing_numbers(self._axis, self._options)
            await self._go(0, zero, ramp, stops)
            await node.until(
                lambda: (not self.jogging and node.demand == 0) or node.stops != stops or not node.enabled,
                node.clock.now_ns() + _RETURN_NS,
            )

    # Jogs

    async def jog(self, move: JogMove) -> None:
        """Begin, or change. Raises `CannotDo`."""
        node = self._node
        stops = node.stops
        await self._power.stopped()
        node.require_well()
        if not node.enabled:
            raise CannotDo("not-enabled", f"axis {self._name} is not enabled", f"enable {self._name} first")
        if self._step() or self.homing:
            raise CannotDo("busy", "a motion is loaded or under way", "disarm or stop it")
        own = units(self._options)
        velocity = min(WORD_MAX, int(abs(move.velocity_counts_s) * own.velocity * (1 + _ROUNDING)))
        ramp = min(WORD_MAX, int(move.ramp_counts_s2 * own.acceleration * (1 + _ROUNDING)))
        if min(velocity, ramp) < 1:
            raise CannotDo(
                "too-slow",
                f"axis {self._name}: {abs(move.velocity_counts_s):g} counts/s is slower than it can go",
                f"at least {1 / own.velocity:g} counts/s",
            )
        sign = 1 if move.velocity_counts_s > 0 else -1
        end = sign * POSITION_MAX if move.end_counts is None else move.end_counts
        if sign * (end - node.demand) <= 0:
            raise CannotDo(
                "at-end",
                f"axis {self._name} stands at {node.demand} counts; in this direction its way ends at {end}",
                "jog it the other way",
            )
        await self._go(end, velocity, ramp, stops)

    async def _go(self, target: int, velocity: int, ramp: int, stops: int) -> None:
        """Set a motion going, or change it at once; all in the drive's units. Raises `CannotDo`.

        stops: how many had been given when it was asked for; one more, and it does not begin.
        """
        node = self._node
        if node.mode != o.PROFILE_POSITION_MODE or node.control & states.NEW_SET_POINT:
            node.order(states.ENABLE, o.PROFILE_POSITION_MODE)
            if not await node.soon(lambda: node.mode == o.PROFILE_POSITION_MODE):
                await node.look()
                raise CannotDo("wrong-mode", f"{node.name} does not go over to profile position mode", "see 6502h")
        await node.set_point(target, velocity, ramp, ramp)
        if not await node.soon(lambda: not node.status & states.ACKNOWLEDGED) or node.stops != stops:
            raise CannotDo("stopped", f"a stop came before axis {self._name} was set going", "")
        since_ns = node.clock.now_ns()
        node.order(states.ENABLE | states.NEW_SET_POINT | states.AT_ONCE)
        self._jog_stops, self._jog_drops, self._jog_ns = node.stops, node.drops, since_ns
        taken = await node.soon(lambda: node.acknowledged_ns >= since_ns or node.stops != stops)
        if node.stops != stops:
            raise CannotDo("stopped", f"a stop came while axis {self._name} was being set going", "")
        node.order(states.ENABLE)
        if not taken:
            self._power.stop(False)
            raise CannotDo("not-taken", f"{node.name} has not taken a set-point", "look at its state")
