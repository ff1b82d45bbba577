"""One poll: what the unit does, where it stands, its inputs and outputs, and whether it was switched off meanwhile.

A unit that executes a program answers nothing but that it is busy (L1519-L1522); some may give their position. Else it
is where its profile says.
"""

from adapters.contract import AxisReading, Reading, Restarted
from adapters.smc30.hand import Hand
from adapters.smc30.mover import Move, Mover
from adapters.smc30.ramp import Ramp, Shape
from adapters.smc30.session import Busy
from adapters.smc30.unitstate import Status, UnitState
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.fleet import Controller
from orchestrator.model.state import Fault


class Poller:
    """Reads the unit's state. Costs F, V1 and VR, and V2 where inputs or outputs are named; in motion F alone."""

    def __init__(self, config: Controller, clock: Clock, unit: UnitState, mover: Mover, hand: Hand) -> None:
        self._axis = next(iter(config.axes))
        self._points_named = bool(config.inputs or config.outputs)
        self._clock = clock
        self._unit = unit
        self._mover = mover
        self._hand = hand
        self._inputs: dict[int, bool] = {}
        self._outputs: dict[int, bool] = {}

    async def poll(self) -> Reading:
        """Raises `Restarted`."""
        unit = self._unit
        now = await unit.status()
        # In Programming Mode neither position nor inputs are told; it stands where it stood.
        if not now.busy and not unit.loading.locked():
            try:
                async with unit.loading:
                    await self._at_rest()
            except Busy:
                now = await unit.status()
        if not now.busy:
            self._mover.seen_ready(now.sent_ns)
            self._settled(now)
            counts, velocity, moving = unit.rest_counts, 0.0, False
        else:
            counts, velocity, moving = await self._in_motion(now.at_ns)
        axis = AxisReading(
            commanded_counts=counts,
            actual_counts=float(counts),
            velocity_counts_s=velocity,
            moving=moving,
            enabled=unit.enabled,
            limit=unit.limit,
            lost=unit.lost,
        )
        return Reading(
            at_ns=now.at_ns,
            axes={self._axis: axis},
            inputs=dict(self._inputs),
            outputs=dict(self._outputs),
            faults=self._faults(),
        )

    async def _at_rest(self) -> None:
        """Ask everything. Raises `Busy`."""
        unit = self._unit
        await unit.leave_programming()
        unit.rest_counts = await unit.position()
        if self._points_named:
            self._inputs, self._outputs = await unit.points()
        # Behind it: what it has said is true of an axis that still knows where it is.
        if not await unit.holds_sentinel():
            raise Restarted()

    def _settled(self, now: Status) -> None:
        """At rest: a jog that had been told to begin before that was asked has ended."""
        unit, run, told_ns = self._unit, self._hand.run, self._hand.told_ns
        if unit.doing == "jog" and told_ns is not None and now.sent_ns > told_ns:
            unit.doing = "nothing"
            if run is not None and unit.session.stops == run.stops and unit.rest_counts != run.end:
                unit.limit = "forward" if run.sign > 0 else "reverse"

    async def _in_motion(self, at_ns: int) -> tuple[int, float, bool]:
        unit, move = self._unit, self._mover.move
        counts, velocity, moving = unit.rest_counts, 0.0, True
        if unit.doing == "step" and move is not None:
            counts, velocity, moving = _on_its_way(move, at_ns)
        elif unit.doing == "jog" and self._hand.run is not None:
            run = self._hand.run
            shape = Shape((Ramp(abs(run.end - run.begin), run.s, run.t, run.r),))
            steps, rate = shape.at((at_ns - self._hand.began_ns) / NS_PER_S)
            counts, velocity = run.begin + run.sign * round(steps), run.sign * rate
        if unit.live is not False and moving:
            try:
                place = await unit.place()
                counts, unit.live = place.counts, True
                self._mover.told(place)
            except Busy:
                unit.live = False
        return counts, velocity, moving

    def _faults(self) -> list[Fault]:
        unit = self._unit
        found: list[Fault] = []
        if unit.overflow:
            found.append(
                Fault(
                    code="counter-overflow",
                    text=f"{unit.session.name}: the position counter has run over; the motor was stopped (E5)",
                    remedy="clear it with `tutti reset`, then home",
                )
            )
        if unit.program_error:
            found.append(
                Fault(
                    code="program-error",
                    text=f"{unit.session.name}: its program has ended with an error (E4)",
                    remedy="clear it with `tutti reset`; was another program loaded?",
                )
            )
        return found


def _on_its_way(move: Move, at_ns: int) -> tuple[int, float, bool]:
    """Where a step has got to by its profile, from the middle of what is known of its start."""
    lowered = move.lowered
    if lowered.shape is None or lowered.target is None:
        return lowered.start_counts, 0.0, False
    window = lowered.window_ns
    start_ns = move.t0_ns + sum(window) // 2
    if move.started is not None:
        start_ns = (move.started.earliest_ns + move.started.latest_ns) // 2
    sign = 1 if lowered.target > lowered.start_counts else -1
    steps, rate = lowered.shape.at((at_ns - start_ns) / NS_PER_S)
    return lowered.start_counts + sign * round(steps), sign * rate, at_ns > start_ns
