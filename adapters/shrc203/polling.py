"""One poll: coordinates and status words in one exchange, and further queries where possible.

Queries that may be answered by a bare digit are omitted while a completion is outstanding: their last values are
repeated.
"""

from typing import Literal

from adapters.contract import AxisReading, ControllerReading, ControllerRestarted, HostInterval
from adapters.shrc203 import fleetaxes
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.unitstate import CountsReading, ShrcState
from adapters.shrc203.wire.replies import BITS, STATUS, AxisStatus, flag_list, parse_status, pulse_list
from adapters.shrc203.wire.session import ShrcSession
from adapters.shrc203.wire.status import ERRORS, is_position_lost, status_faults
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.state import FaultReport

# this long after an axis has come to rest its completion line can no longer arrive
_COMPLETION_LATE_NS = 100 * NS_PER_MS


class ShrcPoller:
    """Read the controller's state. Costs `Q:SPC` and the sentinel, `?:CW`, and `I:` and `?:O` where points are
    named."""

    def __init__(self, config: Controller, options: ShrcOptions, clock: Clock, unit: ShrcState) -> None:
        self._config = config
        self._options = options
        self._clock = clock
        self._unit = unit
        self._motors = fleetaxes.motor_numbers(config)
        self._last: dict[int, AxisStatus] = {}
        self._last_ns = 0
        self._rest_ns: int | None = None
        self._inputs: dict[int, bool] = {}
        self._outputs: dict[int, bool] = {}

    async def poll_state(self) -> ControllerReading:
        unit, session = self._unit, self._unit.session
        line = await session.query_line("Q:SPC", STATUS)
        # After the poll: a passed restart check makes the poll's values valid.
        if await unit.is_restarted():
            raise ControllerRestarted()
        states = parse_status(line.text, unit.controllable)
        if unit.timing is not None:
            unit.timing.add_reading("Q:SPC", line, states)
        actual, latest_ns = states, line.at_ns
        if any(unit.closed_loop.values()):
            scales = parse_status(await session.send_query("Q:SPE", STATUS), unit.controllable)
            actual = {m: scales[m] if unit.closed_loop.get(m) else state for m, state in states.items()}
            latest_ns = self._clock.now_ns()
        if unit.trigger_set:
            counts = {motor: state.counts for motor, state in states.items()}
            unit.readings.append(CountsReading(line.command_ns, line.at_ns, counts))
        busy = {motor for motor, state in states.items() if state.is_busy}
        self._drop_completions(busy, line.at_ns)
        waiting_motors = {
            motor for motor, counts in unit.waiting.items() if states[motor].is_busy and states[motor].counts == counts
        }
        if busy <= unit.jogging_motors | waiting_motors:
            await self._query_digits()
        faults: list[FaultReport] = []
        axes: dict[str, AxisReading] = {}
        elapsed_s = (line.at_ns - self._last_ns) / NS_PER_S
        for name, motor in self._motors.items():
            axis, old = states[motor], self._last.get(motor)
            moved_counts = axis.counts - old.counts if old is not None and axis.is_busy and elapsed_s > 0 else 0
            is_excited = unit.excited.get(motor, False)
            axes[name] = AxisReading(
                commanded_counts=axis.counts,
                actual_counts=float(actual[motor].counts),
                velocity_counts_s=moved_counts / elapsed_s if moved_counts else 0.0,
                moving=axis.is_busy and motor not in waiting_motors,
                enabled=is_excited,
                limit=fleetaxes.limit_of(axis.word, self._options.cw),
                position_lost=is_position_lost(
                    axis.word, excited=is_excited, closed_loop=unit.closed_loop.get(motor, False)
                ),
            )
            faults += status_faults(name, axis.word)
        unit.sound = not any(state.word & ERRORS for state in states.values())
        self._last, self._last_ns = states, line.at_ns
        if session.completions.expected - busy:
            session.changed.set()  # at rest without a completion line: wake the waiting task, which then queries
        return ControllerReading(
            at_ns=line.at_ns,
            axes=axes,
            inputs=dict(self._inputs),
            outputs=dict(self._outputs),
            faults=faults,
            sampled=HostInterval(line.command_ns, latest_ns),
        )

    def _drop_completions(self, busy: set[int], at_ns: int) -> None:
        """Drop outstanding completions that no task awaits, once their axes have been at rest."""
        session = self._unit.session
        if not session.completions.abandoned or session.completions.expected & busy:
            self._rest_ns = None
        elif self._rest_ns is None:
            self._rest_ns = at_ns
        elif at_ns - self._rest_ns > _COMPLETION_LATE_NS:
            session.completions.expect_none()

    async def _query_digits(self) -> None:
        unit = self._unit
        answer = await unit.session.query_digit("?:CW", flag_list(len(unit.controllable)))
        if answer is not None:
            unit.excited = {m: digit == "1" for m, digit in zip(unit.controllable, answer.split(","), strict=True)}
        if self._config.inputs and (answer := await unit.session.query_digit("I:", BITS)) is not None:
            self._inputs = point_levels(int(answer))
        if self._config.outputs and (answer := await unit.session.query_digit("?:O", BITS)) is not None:
            unit.outputs = int(answer)
            self._outputs = point_levels(unit.outputs)


def point_levels(value: int) -> dict[int, bool]:
    """Return inputs or outputs by number: the first is 1, the second 2, the third 4 (L5274-L5304)."""
    return {number: bool(value & 1 << (number - 1)) for number in fleetaxes.INPUTS}


# Registered positions, 20 of each kind (L7725, L7850): read here; set and approached by `send_raw`. `PIT:SET,n` stores
# the stage position until power-off, and reads in present coordinates (L7712, L7731); `PAV:SET,n` stores coordinate
# values in the main memory (L7831).

NUMBERS = range(1, 21)

PositionKind = Literal["place", "coordinates"]
_COMMANDS: dict[PositionKind, str] = {"place": "PIT", "coordinates": "PAV"}
_AXES = 3  # of all axes, including those that cannot be controlled


async def read_registered(session: ShrcSession, kind: PositionKind) -> dict[int, tuple[int, int, int]]:
    """Return the records of a kind by number, in pulses of motors 1 to 3; empty numbers are omitted.

    Raises `Refusal` while a completion line is outstanding, `ControllerFault`.
    """
    if session.completions.expected:
        raise Refusal("moving", "registered positions are read at rest only", "wait for the end of the move")
    records: dict[int, tuple[int, int, int]] = {}
    for number in NUMBERS:
        answer = await session.query_optional(f"{_COMMANDS[kind]}:GET,{number}", pulse_list(_AXES))
        if answer is not None:
            first, second, third = (int(number_text) for number_text in answer.split(","))
            records[number] = first, second, third
    return records
