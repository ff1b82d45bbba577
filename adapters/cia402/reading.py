"""What a drive reports of itself: its axis, its inputs and outputs, its faults, and that it is alive."""

from typing import Literal

from adapters.cia402.canopen import states
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import INPUTS, VELOCITY, point_bit
from adapters.cia402.canopen.states import DriveState
from adapters.cia402.fleetaxes import POINTS
from adapters.cia402.moves import Cia402Mover
from adapters.cia402.options import Cia402Options
from adapters.cia402.power import PowerStage
from adapters.cia402.sampling import find_arrival_delay_ns
from adapters.contract import AxisReading, ControllerReading, HostInterval
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import ControllerFault
from orchestrator.model.state import FaultReport

_NEGATIVE_LIMIT, _POSITIVE_LIMIT = 1, 2  # bits of 60FDh


class DriveReader:
    """The state of one drive, from the messages that it sends unsolicited. axis: its name in the fleet file."""

    def __init__(
        self, options: Cia402Options, node: BusDrive, power: PowerStage, mover: Cia402Mover, axis: str
    ) -> None:
        self._options = options
        self._node = node
        self._power = power
        self._mover = mover
        self._axis = axis

    async def require_sign_of_life(self, boots: int, patience_ns: int) -> None:
        """Wait for a message of the drive; it need not come if the drive was restarted, or this computer has left the
        bus. boots: how often the drive had started. Raises `ControllerFault`."""
        node = self._node
        began_ns = node.clock.now_ns()

        # The last message is valid as long as the drive is alive: it sends changes at once.
        def is_alive() -> bool:
            return node.heard_ns > began_ns or node.boots != boots or node.bus.is_off

        if not await node.wait_until(is_alive, began_ns + patience_ns):
            raise ControllerFault(
                "no-answer",
                f"{node.name} has been silent for {(node.clock.now_ns() - node.heard_ns) // NS_PER_MS} "
                f"ms, its heartbeat period is {self._options.heartbeat_ms} ms",
                "check its power, the cable and both terminations",
            )

    def make_reading(self, *, restarted: bool) -> ControllerReading:
        """Return the present state of the drive."""
        node, is_moving = self._node, self._is_moving()
        has_inputs = INPUTS in node.layout.reported
        axis = AxisReading(
            commanded_counts=node.demand,
            actual_counts=float(node.actual),
            velocity_counts_s=self._velocity() if is_moving else 0.0,
            moving=is_moving,
            enabled=self._is_powered,
            limit=_limit_switches(node.inputs),
        )
        return ControllerReading(
            at_ns=node.state_ns if is_moving and node.state_ns else node.heard_ns,
            axes={self._axis: axis},
            inputs={number: bool(node.inputs & point_bit(number)) for number in POINTS} if has_inputs else {},
            outputs={number: bool(node.outputs & point_bit(number)) for number in POINTS} if node.has_outputs else {},
            faults=self._drive_faults(),
            restarted=restarted,
            sampled=self._find_interval(is_moving=is_moving),
        )

    def _find_interval(self, *, is_moving: bool) -> HostInterval:
        """Return an interval in which the drive was where its last message shows it. At rest any message shows that: it
        would have sent another position within its inhibit time."""
        node = self._node
        before_ns = find_arrival_delay_ns(self._options, len(node.bus.units), node.bus.bitrate)
        if is_moving and node.state_ns:
            return HostInterval(node.state_ns - before_ns, node.state_ns)
        return HostInterval(node.heard_ns - node.inhibit_ns - before_ns, node.heard_ns)

    def _velocity(self) -> float:
        """Return its velocity, counts/s; without 606Ch it is that of its positions."""
        node = self._node
        units = float(self._options.velocity_units) if VELOCITY in node.layout.reported else 1.0
        return node.velocity / units

    @property
    def _is_powered(self) -> bool:
        """Whether its power stage is on: also in the quick stop that completes a stop, which it leaves enabled."""
        node = self._node
        return node.is_enabled or (node.state is DriveState.QUICK_STOP and self._power.is_stopping)

    def _is_moving(self) -> bool:
        """Return whether the drive moves: by its statusword during an operation; otherwise by its position, which shows
        it a little later."""
        node = self._node
        if self._power.is_stopping:
            return True
        operating = self._mover.is_operating
        if operating and node.is_enabled and not node.status & states.TARGET_REACHED:
            return True
        # Outside an operation a single change is a new coordinate, set by another master.
        changed_ns = node.moved_ns if operating else node.running_ns
        return bool(changed_ns) and node.clock.now_ns() - changed_ns < 2 * node.inhibit_ns

    def _drive_faults(self) -> list[FaultReport]:
        node = self._node
        codes = dict(node.emergencies)
        if not codes and node.state in (DriveState.FAULT, DriveState.REACTION):
            codes = {0: node.fault_text()}
        return [
            FaultReport(
                code="emergency" if code else "fault",
                text=f"{node.name}: {text}",
                remedy="remove its cause, then clear it with `tutti reset`",
                axis=self._axis,
            )
            for code, text in codes.items()
        ]


def _limit_switches(inputs: int) -> Literal["none", "forward", "reverse", "both"]:
    """Return the active limit switches in 60FDh."""
    negative, positive = inputs & _NEGATIVE_LIMIT, inputs & _POSITIVE_LIMIT
    if negative and positive:
        return "both"
    return "reverse" if negative else "forward" if positive else "none"
