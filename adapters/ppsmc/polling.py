"""One poll: status, positions, errors, and the points that the fleet file names, in one batch."""

from collections.abc import Mapping
from fractions import Fraction

from adapters.contract import AxisReading, ControllerReading, ControllerRestarted, HostInterval
from adapters.ppsmc import fleetaxes
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.replies import (
    ASK_ENCODERS,
    ASK_ERRORS,
    ASK_INPUTS,
    ASK_OUTPUTS,
    ASK_POSITIONS,
    ASK_STATUS,
    FormattedQuery,
    StatusBits,
    leading_number,
    parse_entries,
    parse_errors,
)
from adapters.ppsmc.unitstate import PpSmcReading, PpSmcState
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller
from orchestrator.model.state import FaultReport

LIMIT_ERROR = 1500


class PpSmcPoller:
    """Read the controller's state."""

    def __init__(self, config: Controller, options: PpSmcOptions, unit: PpSmcState) -> None:
        self._config = config
        self._unit = unit
        self._motors = fleetaxes.axis_numbers(config)
        self._encoders = {self._motors[name] for name in options.encoders}
        self._last: PpSmcReading | None = None
        self._inputs: dict[int, bool] = {}
        self._outputs: dict[int, bool] = {}

    async def poll_state(self) -> ControllerReading:
        unit, session = self._unit, self._unit.session
        measured_motors = self._encoders | unit.closed
        errors: dict[int, tuple[int, str]] = {}
        actual: dict[int, float] = {}
        interval: HostInterval | None = None
        try:
            if session.blocked:
                raise ControllerFault("blocked", "", "")
            reply = await session.send_queries(*self._poll_queries(measured_motors))
        except ControllerFault as error:
            if error.code != "blocked":
                raise
            look = await unit.read_state()
        else:
            look = unit.parse_state(reply.first_line(ASK_STATUS), reply.first_line(ASK_POSITIONS), reply.written_ns)
            errors = parse_errors(reply.reply_texts(ASK_ERRORS))
            interval = HostInterval(look.begun_ns, look.at_ns)
            if ASK_ENCODERS in reply:
                actual = _parse_distances(reply.first_text(ASK_ENCODERS), unit.gears)
                interval = HostInterval(look.begun_ns, reply.first_line(ASK_ENCODERS).at_ns)
            if ASK_INPUTS in reply:
                self._inputs = port_levels(int(reply.first_text(ASK_INPUTS)))
            if ASK_OUTPUTS in reply:
                self._outputs = port_levels(int(reply.first_text(ASK_OUTPUTS)))
        if session.batches.restarted:
            raise ControllerRestarted()
        faults = _controller_faults(look)
        axes = {name: self._read_axis(name, look, errors, actual, measured_motors) for name in self._motors}
        for name, motor in self._motors.items():
            if motor in errors and errors[motor][0]:
                faults.append(_axis_error_fault(name, errors[motor]))
        self._last = look
        return ControllerReading(
            at_ns=(look.begun_ns + look.at_ns) // 2,
            axes=axes,
            inputs=dict(self._inputs),
            outputs=dict(self._outputs),
            faults=faults,
            sampled=interval,
        )

    def _poll_queries(self, measured: set[int]) -> list[FormattedQuery]:
        queries: list[FormattedQuery] = [ASK_STATUS, ASK_POSITIONS, ASK_ERRORS]
        if measured:
            queries.append(ASK_ENCODERS)
        if self._config.inputs:
            queries.append(ASK_INPUTS)
        if self._config.outputs:
            queries.append(ASK_OUTPUTS)
        return queries

    def _read_axis(
        self,
        name: str,
        look: PpSmcReading,
        said: Mapping[int, tuple[int, str]],
        actual: Mapping[int, float],
        measured: set[int],
    ) -> AxisReading:
        unit, motor = self._unit, self._motors[name]
        last, bits = self._last, look.bits[motor]
        counts = look.counts[motor]
        if counts is None:  # it oscillates: its position is unknown
            counts = (last.counts[motor] if last is not None else None) or 0
        is_moving = not bits & StatusBits.READY
        velocity = 0.0
        if (
            is_moving
            and last is not None
            and (last_counts := last.counts[motor]) is not None
            and look.at_ns > last.at_ns
        ):
            velocity = (counts - last_counts) * NS_PER_S / (look.at_ns - last.at_ns)
        if said.get(motor, (0, ""))[0] == LIMIT_ERROR and motor in unit.referenced:
            unit.spoiled.add(motor)
        is_lost = motor in unit.spoiled or (motor in unit.referenced and not bits & StatusBits.REFERENCED)
        if bits & StatusBits.REFERENCED:
            unit.referenced.add(motor)
        return AxisReading(
            commanded_counts=counts,
            actual_counts=actual.get(motor, float(counts)) if motor in measured else float(counts),
            velocity_counts_s=velocity,
            moving=is_moving,
            enabled=name in unit.enabled,
            limit=fleetaxes.limit_of(bits),
            position_lost=is_lost,
        )


def _parse_distances(text: str, gears: Mapping[int, Fraction]) -> dict[int, float]:
    distances: dict[int, float] = {}
    for motor, value in parse_entries(text).items():
        distance = leading_number(value)
        if distance is not None and motor in gears:
            distances[motor] = float(Fraction(distance) * gears[motor])
    return distances


def port_levels(value: int) -> dict[int, bool]:
    """Return the i/o port by bit."""
    return {bit: bool(value >> bit & 1) for bit in fleetaxes.PORT_BITS}


def _controller_faults(look: PpSmcReading) -> list[FaultReport]:
    if not look.is_blocked:
        return []
    return [
        FaultReport(
            code="blocked",
            text="the controller is blocked (`block`): it moves nothing and answers only queries of status "
            "and position",
            remedy="ensure that it may move, then unblock it with `tutti reset` (it sends `unblock`)",
        )
    ]


def _axis_error_fault(name: str, error: tuple[int, str]) -> FaultReport:
    number, text = error
    if number == LIMIT_ERROR:
        return FaultReport(
            code="limit-error",
            text=f"axis {name} was stopped by a limit switch (error {number}); its position is not valid",
            remedy="clear it with `tutti reset`, move it off the switch, and home it",
            axis=name,
        )
    return FaultReport(
        code="unit-error",
        text=f"axis {name}: the controller reports error {number}{f' {text}' if text else ''}",
        remedy="check the controller; clear it with `tutti reset`",
        axis=name,
    )
