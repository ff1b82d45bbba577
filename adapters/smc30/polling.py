"""One poll: the controller's activity, its position, its inputs and outputs, and whether it was power-cycled meanwhile.

A controller that executes a program answers only that it is busy (L1519-L1522); some models may report their position.
Otherwise the position is taken from the profile.
"""

from adapters.contract import AxisReading, ControllerReading, ControllerRestarted, HostInterval
from adapters.smc30.hand import Smc30ManualMotion
from adapters.smc30.mover import Smc30Mover
from adapters.smc30.ramp import Smc30Ramp, Smc30Shape
from adapters.smc30.session import ControllerBusy
from adapters.smc30.step import LoadedStep
from adapters.smc30.unitstate import ActivityReading, Smc30State
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.fleet import Controller
from orchestrator.model.state import FaultReport

POLLS_OF_ERRORS = 4


class Smc30Poller:
    """Read the controller's state. Costs V1 and VR, and V2 where inputs or outputs are named; in motion V1 alone. F
    comes before them where motion does not refuse V1, and in one of a few polls."""

    def __init__(
        self, config: Controller, clock: Clock, unit: Smc30State, mover: Smc30Mover, manual_motion: Smc30ManualMotion
    ) -> None:
        self._axis = next(iter(config.axes))
        self._points_named = bool(config.inputs or config.outputs)
        self._polls = 0
        self._clock = clock
        self._unit = unit
        self._mover = mover
        self._manual_motion = manual_motion
        self._inputs: dict[int, bool] = {}
        self._outputs: dict[int, bool] = {}

    async def poll_state(self) -> ControllerReading:
        """Read the state. Raises `ControllerRestarted`."""
        unit = self._unit
        status = await self._query_activity()
        # In Programming Mode neither position nor inputs can be read; the axis has not moved.
        if not status.busy and not unit.loading.locked():
            try:
                async with unit.loading:
                    await self._query_at_rest(status.counts)
            except ControllerBusy:
                status = await unit.read_status()
        if not status.busy:
            self._mover.record_ready(status.sent_ns)
            self._handle_rest(status)
            counts, velocity, is_moving = unit.rest_counts, 0.0, False
        else:
            counts, velocity, is_moving = await self._read_in_motion(status.at_ns)
        axis = AxisReading(
            commanded_counts=counts,
            actual_counts=float(counts),
            velocity_counts_s=velocity,
            moving=is_moving,
            enabled=unit.enabled,
            limit=unit.limit,
            limit_inferred=True,
            position_lost=unit.lost,
        )
        return ControllerReading(
            at_ns=status.at_ns,
            axes={self._axis: axis},
            inputs=dict(self._inputs),
            outputs=dict(self._outputs),
            faults=self._controller_faults(),
            sampled=HostInterval(status.sent_ns, self._clock.now_ns()),
        )

    async def _query_activity(self) -> ActivityReading:
        """Query what it does: by its position where that shows it as well, which saves a query; now and then by F,
        which shows errors (L1818-L1827). In Programming Mode the query would become a part of the program."""
        unit = self._unit
        self._polls += 1
        if self._polls % POLLS_OF_ERRORS == 0 or unit.loading.locked() or unit.programming:
            return await unit.read_status()
        async with unit.loading:
            return await unit.read_end()

    async def _query_at_rest(self, counts: int | None) -> None:
        """Query everything; counts: the position, if it is known already. Raises `ControllerBusy`."""
        unit = self._unit
        await unit.leave_programming()
        unit.rest_counts = await unit.read_position() if counts is None else counts
        if self._points_named:
            self._inputs, self._outputs = await unit.read_points()
        # After the queries: a passed restart check makes their values valid for a referenced axis.
        if not await unit.holds_sentinel():
            raise ControllerRestarted()

    def _handle_rest(self, now: ActivityReading) -> None:
        """Handle a reading at rest: a jog whose command was accepted before it has ended."""
        unit, run, told_ns = self._unit, self._manual_motion.run, self._manual_motion.accepted_ns
        if unit.doing == "jog" and told_ns is not None and now.sent_ns > told_ns:
            unit.doing = "nothing"
            if run is not None and unit.session.stops == run.stops and unit.rest_counts != run.end:
                unit.limit = "forward" if run.direction_sign > 0 else "reverse"

    async def _read_in_motion(self, at_ns: int) -> tuple[int, float, bool]:
        unit, move = self._unit, self._mover.move
        counts, velocity, is_moving = unit.rest_counts, 0.0, True
        if unit.doing == "step" and move is not None:
            counts, velocity, is_moving = _profile_position(move, at_ns)
        elif unit.doing == "jog" and self._manual_motion.run is not None:
            run = self._manual_motion.run
            shape = Smc30Shape((Smc30Ramp(abs(run.end - run.begin), run.s, run.t, run.r),))
            steps, rate = shape.state_at((at_ns - self._manual_motion.began_ns) / NS_PER_S)
            counts, velocity = run.begin + run.direction_sign * round(steps), run.direction_sign * rate
        if unit.live is not False and is_moving:
            try:
                axis_place = await unit.read_place()
                counts, unit.live = axis_place.counts, True
                self._mover.add_position(axis_place)
            except ControllerBusy:
                unit.live = False
        return counts, velocity, is_moving

    def _controller_faults(self) -> list[FaultReport]:
        unit = self._unit
        faults: list[FaultReport] = []
        if unit.overflow:
            faults.append(
                FaultReport(
                    code="counter-overflow",
                    text=f"{unit.session.name}: the position counter has overflowed; the motor was stopped (E5)",
                    remedy="clear it with `tutti reset`, then home",
                )
            )
        if unit.program_error:
            faults.append(
                FaultReport(
                    code="program-error",
                    text=f"{unit.session.name}: its program has ended with an error (E4)",
                    remedy="clear it with `tutti reset`; was another program loaded?",
                )
            )
        return faults


def _profile_position(move: LoadedStep, at_ns: int) -> tuple[int, float, bool]:
    """Return the position of a step by its profile, from the middle of the interval of its start."""
    lowered_step = move.lowered
    if lowered_step.shape is None or lowered_step.target is None:
        return lowered_step.start_counts, 0.0, False
    window = lowered_step.window_ns
    start_ns = move.t0_ns + sum(window) // 2
    if move.started is not None:
        start_ns = (move.started.earliest_ns + move.started.latest_ns) // 2
    sign = 1 if lowered_step.target > lowered_step.start_counts else -1
    steps, rate = lowered_step.shape.state_at((at_ns - start_ns) / NS_PER_S)
    return lowered_step.start_counts + sign * round(steps), sign * rate, at_ns > start_ns
