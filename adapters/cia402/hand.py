"""Manual motion: homing by the drive's own methods, and jogs.

A jog is a set-point at its end position, changed at once: so the drive itself ends it there, unlike profile velocity
mode, and a crashed host leaves a motion with an end.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen import states
from adapters.cia402.canopen.handshake import settle_handshake, standing_refusal
from adapters.cia402.canopen.modes import wait_for_mode
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.sdo import SdoAborted
from adapters.cia402.canopen.setpoint import begin_motion, load_set_point, make_set_point
from adapters.cia402.canopen.states import DriveState
from adapters.cia402.canopen.words import NOT_THERE, READ_ONLY
from adapters.cia402.fleetaxes import POSITION_MAX, drive_units, homing_method, homing_numbers, only_axis
from adapters.cia402.options import Cia402Options
from adapters.cia402.power import PowerStage
from adapters.cia402.shapes.trapezoid import WORD_MAX
from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller

_ROUNDING = 1e-9
_LONGEST_NS = 2**62
_SEEN_NS = 20 * NS_PER_MS
_BEGIN_NS = NS_PER_S  # within this time a search shows that it has begun
_RESULT = states.ACKNOWLEDGED | states.MODE_ERROR  # homing attained, homing error
_HERE = (35, 37)
"""Methods whose reference is the present position."""
_OPTIONAL = frozenset({o.HOMING_ACCELERATION, o.HOME_OFFSET, o.HOMING_SWITCH_SPEED, o.HOMING_ZERO_SPEED})
"""Objects without which the drive homes by its own values; `needs` refuses speeds that the fleet file states."""
_RETURN_NS = 60 * NS_PER_S  # a caller with a shorter timeout cancels
_AT_LIMITS = (1, 2, 17, 18)
"""Methods whose reference is at the edge of a limit switch, or near it."""


@dataclass(frozen=True, slots=True)
class HomingSearch:
    """One search of a drive.

    stops, boots, left_bus: how often it had been stopped and had started, and this computer had left the bus.
    has_stood: bits of a result were on at its begin; they are from an earlier search, or from another mode.
    is_here: the reference is the present position, and becomes 0: there is no search whose begin could be seen."""

    node: BusDrive
    stops: int
    boots: int
    left_bus: int
    has_stood: bool
    since_ns: int
    is_here: bool

    @property
    def is_fresh(self) -> bool:
        """Whether a result that the drive shows is that of this search."""
        node = self.node
        return not self.has_stood or node.unresolved_ns > self.since_ns or self._is_found_at_once

    @property
    def _is_found_at_once(self) -> bool:
        node = self.node
        return self.is_here and node.demand == 0 and node.status & _RESULT == states.ACKNOWLEDGED

    @property
    def has_failed(self) -> bool:
        return bool(self.interruption_text()) or self.node.state is not DriveState.ENABLED

    @property
    def is_attained(self) -> bool:
        status = self.node.status
        return self.is_fresh and bool(status & states.ACKNOWLEDGED and status & states.TARGET_REACHED)

    def interruption_text(self) -> str:
        """Return what has ended it from outside; empty: nothing."""
        if self.node.stops != self.stops:
            return "it was stopped"
        if self.node.boots != self.boots:
            return "it was switched off and on"
        if self.node.left_bus != self.left_bus:
            return "this computer has left the bus (bus-off)"
        return ""

    async def wait_for_result(self) -> bool:
        """Wait until it has succeeded or failed; return whether it has begun."""
        node = self.node
        await node.wait_until(
            lambda: self.has_failed or not node.status & states.TARGET_REACHED, node.clock.now_ns() + _SEEN_NS
        )
        await node.wait_until(
            lambda: self.has_failed or self.is_fresh or node.moved_ns > self.since_ns, node.clock.now_ns() + _BEGIN_NS
        )
        has_begun = self.is_fresh or node.moved_ns > self.since_ns
        await node.wait_until(
            lambda: self.has_failed or self.is_attained or (self.is_fresh and bool(node.status & states.MODE_ERROR)),
            node.clock.now_ns() + (_LONGEST_NS if has_begun else 0),
        )
        return has_begun


class Cia402ManualMotion:
    """Homing and jogs of one connection. step: returns whether a step is loaded or in progress."""

    def __init__(
        self, config: Controller, options: Cia402Options, node: BusDrive, power: PowerStage, step: Callable[[], bool]
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
    def is_jogging(self) -> bool:
        """Whether a jog is in progress: not stopped, the drive enabled since its begin, and not at its end."""
        node = self._node
        if (self._jog_stops, self._jog_drops) != (node.stops, node.drops) or not node.is_enabled:
            return False
        late = node.clock.now_ns() > self._jog_ns + _SEEN_NS
        return not (late and bool(node.status & states.TARGET_REACHED))

    # Homing

    async def find_reference(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        """Find the reference; return when the axis has come to rest. Raises `Refusal`."""
        del axes
        node = self._node
        stops = node.stops
        await self._power.wait_for_stops()
        node.require_operational()
        if not node.is_enabled:
            raise Refusal("not-enabled", f"axis {self._name} is not enabled", f"enable {self._name} first")
        if self._step() or self.homing or self.is_jogging:
            raise Refusal("busy", "a motion is loaded or in progress", "disarm or stop it")
        self.homing = True
        try:
            await self._load_homing()
            if node.stops != stops:
                raise Refusal("stopped", f"axis {self._name} was stopped before its search began", "")
            return await self._run_search(found)
        except BaseException:
            with suppress(LinkClosed):
                self._power.write_stop(abort=False)
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
            if obj in node.held:
                node.held[obj] = value
            try:
                await node.sdo.write_value(obj, value)
            except SdoAborted as error:
                if obj in _OPTIONAL and error.abort in NOT_THERE:
                    continue
                if error.abort == READ_ONLY and await node.sdo.read_value(obj) == value:
                    continue
                raise Refusal(
                    "homing-method",
                    f"axis {self._name}: {error}",
                    "choose another `homing.method`, or other homing speeds",
                ) from None
        node.send_control(states.ENABLE, o.HOMING_MODE)
        if not await wait_for_mode(node, o.HOMING_MODE):
            await node.query_status()
            raise Refusal("wrong-mode", f"{node.name} does not enter homing mode", "does it support this mode (6502h)?")

    async def _run_search(self, found: Callable[[str], None]) -> Mapping[str, Refusal]:
        node = self._node
        search = HomingSearch(
            node,
            stops=node.stops,
            boots=node.boots,
            left_bus=node.left_bus,
            has_stood=bool(node.status & _RESULT),
            since_ns=node.clock.now_ns(),
            is_here=homing_method(self._axis) in _HERE,
        )
        begin_motion(node, 0)  # where the reference will be
        node.send_control(states.ENABLE | states.NEW_SET_POINT)
        has_begun = await search.wait_for_result()
        is_reference_attained = not search.has_failed and search.is_attained
        if is_reference_attained:
            await self._move_to_reference(search.stops)
        if is_reference_attained and not search.has_failed and (node.demand == 0 or not self._returns_to_reference):
            node.moved_ns = node.running_ns = 0  # it is at rest; the change of its position was the new origin
            found(self._name)
            return {}
        reason = search.interruption_text()
        if not reason and node.state is not DriveState.ENABLED:
            reason = f"it is {node.state.value}: {node.fault_text()}"
            # A status can be wrong.
            self._power.write_stop(abort=False)
        elif not reason:
            reason = (
                "the drive reports that its homing has failed, or does not return to its reference"
                if has_begun
                else "the drive does not begin its search, and still shows the result of an earlier one"
            )
            node.send_control(states.ENABLE)
        text = f"axis {self._name} has not found its reference: {reason}"
        return {self._name: Refusal("homing-failed", text, "check its switches, and `homing.method`")}

    @property
    def _returns_to_reference(self) -> bool:
        """Return whether the axis finally moves to its reference; not from the edge of a limit switch."""
        return homing_method(self._axis) not in _AT_LIMITS

    async def _move_to_reference(self, stops: int) -> None:
        """Return to the reference: the drive stops after the edge or index that it has found."""
        node = self._node
        node.send_control(states.ENABLE)
        # The demand relative to the new origin arrives with the next TPDO.
        since_ns = node.clock.now_ns()
        await node.wait_briefly(lambda: node.state_ns > since_ns)
        if node.demand and self._returns_to_reference:
            _, zero, ramp = homing_numbers(self._axis, self._options)
            await self._begin_motion(0, zero, ramp, stops)
            await node.wait_until(
                lambda: (not self.is_jogging and node.demand == 0) or node.stops != stops or not node.is_enabled,
                node.clock.now_ns() + _RETURN_NS,
            )

    # Jogs

    async def start_jog(self, move: JogMove) -> None:
        """Begin a jog, or change it. Raises `Refusal`."""
        node = self._node
        stops = node.stops
        await self._power.wait_for_stops()
        node.require_operational()
        if not node.is_enabled:
            raise Refusal("not-enabled", f"axis {self._name} is not enabled", f"enable {self._name} first")
        if self._step() or self.homing:
            raise Refusal("busy", "a motion is loaded or in progress", "disarm or stop it")
        own = drive_units(self._options)
        velocity = min(WORD_MAX, int(abs(move.velocity_counts_s) * own.velocity * (1 + _ROUNDING)))
        ramp = min(WORD_MAX, int(move.ramp_counts_s2 * own.acceleration * (1 + _ROUNDING)))
        if min(velocity, ramp) < 1:
            raise Refusal(
                "too-slow",
                f"axis {self._name}: {abs(move.velocity_counts_s):g} counts/s is below its lowest speed",
                f"at least {1 / own.velocity:g} counts/s",
            )
        sign = 1 if move.velocity_counts_s > 0 else -1
        end = sign * POSITION_MAX if move.end_counts is None else move.end_counts
        if sign * (end - node.demand) <= 0:
            raise Refusal(
                "at-end",
                f"axis {self._name} is at {node.demand} counts; its range in this direction ends at {end}",
                "jog in the other direction",
            )
        await self._begin_motion(end, velocity, ramp, stops)

    async def _begin_motion(self, target: int, velocity: int, ramp: int, stops: int) -> None:
        """Begin a motion, or change it at once; all in the drive's units. Raises `Refusal`.

        stops: number of stops at the time of the request; after a further stop it does not begin.
        """
        node = self._node
        if node.mode != o.PROFILE_POSITION_MODE or node.control & states.NEW_SET_POINT:
            node.send_control(states.ENABLE, o.PROFILE_POSITION_MODE)
            if not await wait_for_mode(node, o.PROFILE_POSITION_MODE):
                await node.query_status()
                raise Refusal("wrong-mode", f"{node.name} does not enter profile position mode", "see 6502h")
        if self.is_jogging:
            # A set-point at the present position, which takes a standing acknowledge back, would stop it.
            if not await node.wait_briefly(lambda: not node.status & states.ACKNOWLEDGED or node.stops != stops):
                raise standing_refusal(node)
        else:
            await settle_handshake(node, stops)
        if node.stops != stops:
            raise Refusal("stopped", f"a stop came before axis {self._name} was started", "")
        await load_set_point(node, make_set_point(node, target, velocity, ramp, ramp))
        since_ns = node.clock.now_ns()
        node.send_control(states.ENABLE | states.NEW_SET_POINT | states.AT_ONCE)
        self._jog_stops, self._jog_drops, self._jog_ns = node.stops, node.drops, since_ns
        is_taken = await node.wait_briefly(lambda: node.acknowledged_ns >= since_ns or node.stops != stops)
        if node.stops != stops:
            raise Refusal("stopped", f"a stop came while axis {self._name} was being started", "")
        begin_motion(node, target)
        node.send_control(states.ENABLE)
        if not is_taken:
            self._power.write_stop(abort=False)
            raise Refusal("not-taken", f"{node.name} has not accepted a set-point", "check its state")
