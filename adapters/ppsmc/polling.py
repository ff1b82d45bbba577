"""One poll: status, positions, errors, and what else the fleet file names, in one batch."""

from collections.abc import Mapping
from fractions import Fraction

from adapters.contract import AxisReading, DriverFault, Reading, Restarted
from adapters.ppsmc import fleetaxes
from adapters.ppsmc.options import Options
from adapters.ppsmc.replies import (
    ASK_ENCODERS,
    ASK_ERRORS,
    ASK_INPUTS,
    ASK_OUTPUTS,
    ASK_POSITIONS,
    ASK_STATUS,
    Bits,
    Query,
    entries,
    errors,
    number_in,
)
from adapters.ppsmc.unitstate import Look, UnitState
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.fleet import Controller
from orchestrator.model.state import Fault

LIMIT_ERROR = 1500


class Poller:
    """Reads the unit's state."""

    def __init__(self, config: Controller, options: Options, unit: UnitState) -> None:
        self._config = config
        self._unit = unit
        self._motors = fleetaxes.motors(config)
        self._encoders = {self._motors[name] for name in options.encoders}
        self._last: Look | None = None
        self._inputs: dict[int, bool] = {}
        self._outputs: dict[int, bool] = {}

    async def poll(self) -> Reading:
        unit, session = self._unit, self._unit.session
        queries: list[Query] = [ASK_STATUS, ASK_POSITIONS, ASK_ERRORS]
        measured = self._encoders | unit.closed
        if measured:
            queries.append(ASK_ENCODERS)
        if self._config.inputs:
            queries.append(ASK_INPUTS)
        if self._config.outputs:
            queries.append(ASK_OUTPUTS)
        said: dict[int, tuple[int, str]] = {}
        actual: dict[int, float] = {}
        try:
            if session.blocked:
                raise DriverFault("blocked", "", "")
            heard = await session.ask(*queries)
        except DriverFault as error:
            if error.fault.code != "blocked":
                raise
            look = await unit.look()
        else:
            look = unit.looked(heard.one(ASK_STATUS), heard.one(ASK_POSITIONS), heard.written_ns)
            said = errors(heard.lines(ASK_ERRORS))
            if ASK_ENCODERS in heard:
                actual = _scaled(heard.text(ASK_ENCODERS), unit.gears)
            if ASK_INPUTS in heard:
                self._inputs = port_bits(int(heard.text(ASK_INPUTS)))
            if ASK_OUTPUTS in heard:
                self._outputs = port_bits(int(heard.text(ASK_OUTPUTS)))
        if session.restarted:
            raise Restarted()
        faults = _faults(look)
        axes = {name: self._axis(name, look, said, actual, measured) for name in self._motors}
        for name, motor in self._motors.items():
            if motor in said and said[motor][0]:
                faults.append(_error_fault(name, said[motor]))
        self._last = look
        return Reading(
            at_ns=(look.begun_ns + look.at_ns) // 2,
            axes=axes,
            inputs=dict(self._inputs),
            outputs=dict(self._outputs),
            faults=faults,
        )

    def _axis(
        self,
        name: str,
        look: Look,
        said: Mapping[int, tuple[int, str]],
        actual: Mapping[int, float],
        measured: set[int],
    ) -> AxisReading:
        unit, motor = self._unit, self._motors[name]
        last, bits = self._last, look.bits[motor]
        counts = look.counts[motor]
        if counts is None:  # it oscillates: only its being somewhere is known
            counts = (last.counts[motor] if last is not None else None) or 0
        moving = not bits & Bits.READY
        velocity = 0.0
        if moving and last is not None and (before := last.counts[motor]) is not None and look.at_ns > last.at_ns:
            velocity = (counts - before) * NS_PER_S / (look.at_ns - last.at_ns)
        if said.get(motor, (0, ""))[0] == LIMIT_ERROR and motor in unit.referenced:
            unit.spoiled.add(motor)
        lost = motor in unit.spoiled or (motor in unit.referenced and not bits & Bits.REFERENCED)
        if bits & Bits.REFERENCED:
            unit.referenced.add(motor)
        return AxisReading(
            commanded_counts=counts,
            actual_counts=actual.get(motor, float(counts)) if motor in measured else float(counts),
            velocity_counts_s=velocity,
            moving=moving,
            enabled=name in unit.enabled,
            limit=fleetaxes.limit_of(bits),
            lost=lost,
        )


def _scaled(text: str, gears: Mapping[int, Fraction]) -> dict[int, float]:
    found: dict[int, float] = {}
    for motor, value in entries(text).items():
        distance = number_in(value)
        if distance is not None and motor in gears:
            found[motor] = float(Fraction(distance) * gears[motor])
    return found


def port_bits(value: int) -> dict[int, bool]:
    """The i/o port by bit."""
    return {bit: bool(value >> bit & 1) for bit in fleetaxes.PORT_BITS}


def _faults(look: Look) -> list[Fault]:
    if not look.blocked:
        return []
    return [
        Fault(
            code="blocked",
            text="the controller is blocked (`block`): it moves nothing and answers nothing but status and position",
            remedy="make sure that it may move, then release it with `tutti reset` (it sends `unblock`)",
        )
    ]


def _error_fault(name: str, error: tuple[int, str]) -> Fault:
    number, text = error
    if number == LIMIT_ERROR:
        return Fault(
            code="limit-error",
            text=f"axis {name} was stopped by a limit switch (error {number}); its position is not valid",
            remedy="clear it with `tutti reset`, move it off the switch, and home it",
            axis=name,
        )
    return Fault(
        code="unit-error",
        text=f"axis {name}: the unit reports error {number}{f' {text}' if text else ''}",
        remedy="look at the unit; clear it with `tutti reset`",
        axis=name,
    )
