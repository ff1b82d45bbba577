"""One poll: coordinates and status words in one line, and what may be asked beside it.

Queries that may be answered by a bare digit are left out while a completion is owed: their last values are given again.
"""

from adapters.contract import AxisReading, Reading, Restarted
from adapters.shrc203 import fleetaxes
from adapters.shrc203.options import Options
from adapters.shrc203.replies import BITS, STATUS, AxisStatus, flags, status
from adapters.shrc203.status import ERRORS, faults, lost
from adapters.shrc203.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.model.fleet import Controller
from orchestrator.model.state import Fault

_COMPLETION_LATE_NS = 100 * NS_PER_MS  # after the rest of an axis no completion line comes any more


class Poller:
    """Reads the unit's state. Costs `Q:SPC` and the sentinel, `?:CW`, and `I:` and `?:O` where they are named."""

    def __init__(self, config: Controller, options: Options, clock: Clock, unit: UnitState) -> None:
        self._config = config
        self._options = options
        self._clock = clock
        self._unit = unit
        self._motors = fleetaxes.motors(config)
        self._last: dict[int, AxisStatus] = {}
        self._last_ns = 0
        self._rest_ns: int | None = None
        self._inputs: dict[int, bool] = {}
        self._outputs: dict[int, bool] = {}

    async def poll(self) -> Reading:
        unit, session = self._unit, self._unit.session
        line = await session.ask_line("Q:SPC", STATUS)
        # Behind it: what it has said is true of axes that still know where they are.
        if await unit.is_restarted():
            raise Restarted()
        now = status(line.text, unit.controllable)
        if unit.timing is not None:
            unit.timing.looked("Q:SPC", line, now)
        actual = now
        if any(unit.closed_loop.values()):
            scales = status(await session.ask("Q:SPE", STATUS), unit.controllable)
            actual = {m: scales[m] if unit.closed_loop.get(m) else each for m, each in now.items()}
        busy = {motor for motor, each in now.items() if each.busy}
        self._forgive(busy, line.at_ns)
        waiting = {motor for motor, counts in unit.waiting.items() if now[motor].busy and now[motor].counts == counts}
        if busy <= unit.by_hand | waiting:
            await self._ask_digits()
        found: list[Fault] = []
        axes: dict[str, AxisReading] = {}
        elapsed_s = (line.at_ns - self._last_ns) / NS_PER_S
        for name, motor in self._motors.items():
            axis, old = now[motor], self._last.get(motor)
            moved = axis.counts - old.counts if old is not None and axis.busy and elapsed_s > 0 else 0
            excited = unit.excited.get(motor, False)
            axes[name] = AxisReading(
                commanded_counts=axis.counts,
                actual_counts=float(actual[motor].counts),
                velocity_counts_s=moved / elapsed_s if moved else 0.0,
                moving=axis.busy and motor not in waiting,
                enabled=excited,
                limit=fleetaxes.limit_of(axis.word, self._options.cw),
                lost=lost(axis.word, excited, unit.closed_loop.get(motor, False)),
            )
            found += faults(name, axis.word)
        unit.sound = not any(each.word & ERRORS for each in now.values())
        self._last, self._last_ns = now, line.at_ns
        if session.owed - busy:
            session.changed.set()  # at rest without a completion line: whoever waits for it shall look
        return Reading(
            at_ns=line.at_ns,
            axes=axes,
            inputs=dict(self._inputs),
            outputs=dict(self._outputs),
            faults=found,
        )

    def _forgive(self, busy: set[int], at_ns: int) -> None:
        """Completions that nobody waits for are not waited for here either, once their axes have been at rest."""
        session = self._unit.session
        if not session.abandoned or session.owed & busy:
            self._rest_ns = None
        elif self._rest_ns is None:
            self._rest_ns = at_ns
        elif at_ns - self._rest_ns > _COMPLETION_LATE_NS:
            session.owe_nothing()

    async def _ask_digits(self) -> None:
        unit = self._unit
        answer = await unit.session.ask_digits("?:CW", flags(len(unit.controllable)))
        if answer is not None:
            unit.excited = {m: each == "1" for m, each in zip(unit.controllable, answer.split(","), strict=True)}
        if self._config.inputs and (answer := await unit.session.ask_digits("I:", BITS)) is not None:
            self._inputs = bits(int(answer))
        if self._config.outputs and (answer := await unit.session.ask_digits("?:O", BITS)) is not None:
            unit.outputs = int(answer)
            self._outputs = bits(unit.outputs)


def bits(value: int) -> dict[int, bool]:
    """Inputs or outputs by number: the first is 1, the second 2, the third 4 (L5274-L5304)."""
    return {number: bool(value & 1 << (number - 1)) for number in fleetaxes.INPUTS}
