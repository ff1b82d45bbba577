"""The loading of a step: its set-point, or its mode for a stream, written and read back."""

from collections.abc import Callable, Mapping

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen import states
from adapters.cia402.canopen.handshake import settle_handshake, standing_refusal
from adapters.cia402.canopen.modes import refresh_mode, wait_for_mode
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.canopen.setpoint import load_set_point, make_set_point
from adapters.cia402.lowering import Cia402Lowered
from adapters.cia402.power import PowerStage
from adapters.cia402.step import DriveStep
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal

VERIFIED_NS = 2 * NS_PER_S  # for which a read-back counts between steps
_MODES = {
    o.PROFILE_POSITION_MODE: "profile position",
    o.INTERPOLATED_MODE: "interpolated position",
    o.CYCLIC_MODE: "cyclic synchronous position",
}


class StepLoader:
    """Load the steps of one drive and check that they stay loaded. ramp: the deceleration of a drive that follows a
    stream (6084h, or 6083h without it)."""

    def __init__(self, node: BusDrive, power: PowerStage, ramp: int) -> None:
        self._node = node
        self._power = power
        self._ramp = ramp
        self._verified: dict[DictionaryObject, tuple[int, int, int]] = {}
        """By object: its value when it was read back last, after which number of boots, and when."""

    async def load_step(self, lowered: Cia402Lowered, *, behind: bool = False) -> Mapping[str, int]:
        """Load the step and read it back; return what took how long, ns. Raises `Refusal`.

        behind: right behind another step. What was read back with the same value a moment ago is not read again."""
        node = self._node
        await self._power.wait_for_stops()
        began_ns, stops = node.clock.now_ns(), node.stops
        if lowered.drive is not None and node.outputs != lowered.drive.outputs_with(node.outputs, active=False):
            raise Refusal(
                "line-level",
                f"output {lowered.drive.name} is already active",
                "make the trigger line passive; see `active` in the fleet file",
            )
        self._require_outputs(lowered)
        node.require_operational()
        if lowered.target is None:
            return {"wire": 0}
        require_start(node, lowered)
        loaded_values = await (
            self._load_set_point(lowered) if lowered.trajectory is None else self._load_stream(lowered)
        )
        loaded_ns = node.clock.now_ns()
        for obj, value in loaded_values.items():
            if behind and obj is not o.TARGET and self._is_verified(obj, value):
                continue
            held_value = await node.sdo.read_value(obj)
            if held_value != value:
                raise Refusal(
                    "load-garbled",
                    f"{node.name} contains {held_value} in {obj}, and was given {value}",
                    "arm it again; is another master on the bus?",
                )
            self._verified[obj] = (value, node.boots, node.clock.now_ns())
        if node.stops != stops:
            raise Refusal("stopped", "a stop came while arming", "")
        require_start(node, lowered)
        return {"wire": loaded_ns - began_ns, "verify": node.clock.now_ns() - loaded_ns}

    def _is_verified(self, obj: DictionaryObject, value: int) -> bool:
        held_value, boots, at_ns = self._verified.get(obj, (None, 0, 0))
        return (held_value, boots) == (value, self._node.boots) and self._node.clock.now_ns() - at_ns < VERIFIED_NS

    async def verify_step(self, move: DriveStep) -> None:
        """Check that the step is still loaded and the axis is where the plan starts. Raises `Refusal`."""
        node = self._node
        await node.query_status()
        await refresh_mode(node)
        node.require_operational()
        if node.boots != move.boots:
            raise Refusal("not-loaded", f"{node.name} was switched off and on", "arm it again")
        if move.left != node.left_bus:
            raise Refusal("bus-off", f"{node.name} was unreachable meanwhile", "arm it again")
        if move.lowered.target is not None:
            require_start(node, move.lowered)
            if node.mode != move.lowered.mode:
                raise Refusal("not-loaded", f"{node.name} shows mode {node.mode} of operation", "arm it again")
            if move.lowered.trajectory is None and node.status & states.ACKNOWLEDGED:
                raise standing_refusal(node)

    def _require_outputs(self, lowered: Cia402Lowered) -> None:
        """Raise `Refusal` for an output that is active already, or that the drive does not switch."""
        node = self._node
        active = lowered.switched.find_active(node.outputs)
        if active is not None:
            text = f"output {active.name} is already active"
            raise Refusal("line-level", text, "make it passive before the step; see `active` in the fleet file")
        mask = node.held.get(o.OUTPUT_MASK)
        for point in lowered.switched.points:
            if mask is not None and not mask & point.bit:
                raise Refusal(
                    "trigger-output",
                    f"output {point.name}: {o.OUTPUT_MASK} is {mask:#010x}, so that {node.name} does not switch it",
                    f"set bit {point.bit.bit_length() - 1} of it with the drive's own tool, and store it",
                )

    async def _load_set_point(self, lowered: Cia402Lowered) -> Mapping[DictionaryObject, int]:
        """Load the set-point; return the expected object values."""
        node, shape, target = self._node, lowered.shape, lowered.target
        assert shape is not None and target is not None
        stops = node.stops
        node.send_control(states.ENABLE, o.PROFILE_POSITION_MODE)
        await self._require_mode(o.PROFILE_POSITION_MODE, lambda: True)
        await settle_handshake(node, stops)
        values = make_set_point(node, target, shape.velocity, shape.acceleration, shape.deceleration)
        await load_set_point(node, values)
        return values

    async def _load_stream(self, lowered: Cia402Lowered) -> Mapping[DictionaryObject, int]:
        """Prepare the stream: the drive follows its present position until the first SYNC."""
        node, start_counts = self._node, lowered.start_counts
        assert node.followed is not None
        node.give_position(start_counts)
        await node.sdo.write_value(node.braking_ramp, self._ramp)
        await node.sdo.write_value(node.followed, start_counts)
        node.send_control(states.ENABLE, lowered.mode)
        # Bit 12 that stands from another mode would be taken for the answer to bit 4.
        await self._require_mode(
            lowered.mode, lambda: lowered.mode != o.INTERPOLATED_MODE or not node.status & states.FOLLOWS
        )
        if lowered.mode == o.INTERPOLATED_MODE:
            node.send_control(states.ENABLE | states.FOLLOW)
            if not await node.wait_briefly(lambda: bool(node.status & states.FOLLOWS)):
                await node.query_status()
                raise Refusal("wrong-mode", f"{node.name} does not begin to interpolate", "see its manual")
        return {node.followed: start_counts, node.braking_ramp: self._ramp}

    async def _require_mode(self, mode: int, ready: Callable[[], bool]) -> None:
        """Raise `Refusal` (wrong-mode) unless the drive enters `mode`."""
        node = self._node
        if not await wait_for_mode(node, mode, ready):
            await node.query_status()
            raise Refusal(
                "wrong-mode",
                f"{node.name} does not enter {_MODES[mode]} mode; it shows mode {node.mode} and is {node.state.value}",
                "does it support this mode (6502h)? Is another master on the bus?",
            )


def require_start(node: BusDrive, lowered: Cia402Lowered) -> None:
    """Raise `Refusal` unless the drive is enabled and at the start of the plan."""
    if not node.is_enabled:
        raise Refusal("not-enabled", f"axis {lowered.axis} is not enabled", f"enable {lowered.axis} first")
    if node.demand != lowered.start_counts:
        raise Refusal(
            "other-start",
            f"axis {lowered.axis} is at {node.demand} counts; the plan starts at {lowered.start_counts}",
            "plan again from the present position",
        )
