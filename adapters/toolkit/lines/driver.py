"""The driver of a controller with text lines."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from adapters.abilities import ManualDriver, OutputDriver
from adapters.contract import (
    AxisReading,
    ControllerIdentity,
    ControllerReading,
    ControllerRestarted,
    DriverCapabilities,
    DriverSetup,
    JogMove,
)
from adapters.toolkit.connection import ConnectedDriver
from adapters.toolkit.lines.dialect import LineDialect, LineStep, LineTarget
from adapters.toolkit.lines.lowering import (
    CountScale,
    LineLowered,
    axis_acceleration,
    lower_step,
    make_lowered,
    step_costs,
)
from adapters.toolkit.lines.mover import LineMover
from adapters.toolkit.lines.options import LineOptions
from adapters.toolkit.lines.session import LineSession
from adapters.toolkit.lines.unit import LineTools, LineUnit, LineUnitState
from adapters.toolkit.stop_counter import send_or_brake
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import FaultReport, StepCosts

_MOST_NUMBERS = 99
_JOG_AHEAD_S = 600.0  # a jog without an end goes this far; it is stopped long before
_POLL_NS = 20 * NS_PER_MS
_REST_NS = 2 * NS_PER_S


@dataclass(frozen=True, slots=True)
class LineConnection:
    """Everything that exists only while the controller is connected."""

    unit: LineUnit
    mover: LineMover


class LineDriver(ConnectedDriver[LineConnection], ManualDriver, OutputDriver):
    """Drive one controller in the language of `dialect`. scales: by axis."""

    def __init__(
        self, setup: DriverSetup, options: LineOptions, dialect: LineDialect, scales: Mapping[str, CountScale]
    ) -> None:
        super().__init__(setup, LineLowered)
        self._config = setup.config
        self._options = options
        self._dialect = dialect
        self._scales = scales
        self._clock = setup.clock
        axes = setup.config.axes.values()
        self._ramp_s = max(axis.limits.velocity / axis.limits.acceleration for axis in axes)
        link = setup.config.link
        self._char_ns = 10 * NS_PER_S // link.baud if link.kind == "serial" else 0
        # These outlive a connection.
        self._enabled = set(setup.config.axes)
        self._number = 0
        self._restarted = False
        self._jogs: dict[str, JogMove] = {}
        self._was_sound = False
        self._has_alarm = False
        """An alarm came while it was connected; one that it has from the beginning is its lock after power-up, where
        enabling its axes unlocks it."""
        self._position_lost = False
        self._last: ControllerReading | None = None

    # Connection

    async def connect(self) -> ControllerIdentity:
        await self.close()
        self._was_sound = False
        session = LineSession(
            await self._setup.open_link(), self._dialect, self._clock, self._options.answer_ms * NS_PER_MS, self._log
        )
        tools = LineTools(
            config=self._config,
            dialect=self._dialect,
            scales=self._scales,
            clock=self._clock,
            timed_writer=self._setup.timed_writer,
            log=self._log,
        )
        unit = LineUnit(tools, session, self._enabled, self._number)
        mover = LineMover(unit, self._options)
        session.on_restart = mover.handle_restart
        self._connection = LineConnection(unit, mover)
        self._log.info("link opened", place=session.link.endpoint)
        session.write_at_once(self._dialect.spoiler)
        await session.drain()
        session.restarted = False  # what was said before is compared by the session number
        state = await unit.read_state()
        if state.status.state == "moving":
            raise ControllerFault(
                "moving",
                "the controller moves, commanded by another client",
                "wait for its end, or stop it: `tutti stop`",
            )
        if state.status.state == "held":
            unit.begin_tidying()
            await unit.wait_until_tidy()
        identity, _ = await session.ask(self._dialect.ask_identity(), self._dialect.read_identity)
        await self._compare_session(unit)
        self.log_identity(session.link.endpoint, identity)
        return identity

    async def _compare_session(self, unit: LineUnit) -> None:
        """Find out whether the controller was off since the last connection, and number this session."""
        number = await unit.read_number()
        if self._number and number == self._number:
            return
        self._restarted = self._restarted or self._number != 0
        unit.number = number % _MOST_NUMBERS + 1
        try:
            await unit.session.run_procedure(self._dialect.write_session(unit.number))
        except Refusal:  # in an alarm: it is numbered when that is cleared
            unit.must_number = True
        unit.has_lost_session = False
        self._note_number(unit)

    def _note_number(self, unit: LineUnit) -> None:
        """Note the number that the controller holds now; 0 if it holds none."""
        self._number = 0 if unit.must_number else unit.number

    async def configure(self) -> None:
        """Compare the stored settings."""
        unit = self.connection.unit
        session = unit.session
        await unit.read_state()
        settings = self._dialect.settings()
        # Often one query shows all of them.
        queries = {_query_key(setting.step): setting.step for setting in settings}
        replies = {key: (await session.run_step(step)).lines for key, step in queries.items()}
        for setting in settings:
            values = [value for line in replies[_query_key(setting.step)] if (value := setting.read(line)) is not None]
            if not values:
                raise ControllerFault("garbage", f"{setting.item} cannot be read", "is it the right make?")
            tolerance = 1e-6 * max(1.0, abs(setting.expected))
            short = setting.expected - values[0]
            if (short if setting.is_minimum else abs(short)) > tolerance:
                least = "at least " * setting.is_minimum
                text = f"{setting.item} is {values[0]:g}, required is {least}{setting.expected:g}"
                raise ControllerFault("config-mismatch", text, setting.remedy)

    @property
    def capabilities(self) -> DriverCapabilities:
        return DriverCapabilities(
            start_classes=("host",), orders=(2,), independent_axes=False, costs=self._step_costs(self._ramp_s)
        )

    def _step_costs(self, ramp_s: float) -> StepCosts:
        return step_costs(self._options, self._char_ns, len(self._config.axes), ramp_s)

    async def poll(self) -> ControllerReading:
        unit = self.connection.unit
        if unit.is_searching and not self._dialect.traits.answers_while_homing and self._last is not None:
            axes = {name: replace(axis, moving=True) for name, axis in self._last.axes.items()}
            return replace(self._last, at_ns=self._clock.now_ns(), axes=axes, restarted=False)
        state = await unit.read_state()
        if await unit.is_restarted(state):
            raise ControllerRestarted
        is_restarted, self._restarted = self._restarted, False
        self._note_alarm(state)
        self._last = self._make_reading(state, restarted=is_restarted)
        return self._last

    def _note_alarm(self, state: LineUnitState) -> None:
        """Note an alarm: it may have stopped the motors dead."""
        is_alarm = state.status.state == "alarm"
        if is_alarm and (self._was_sound or not self._dialect.traits.switches_motors):
            self._has_alarm = self._position_lost = True
        self._was_sound = not is_alarm
        self._has_alarm = self._has_alarm and is_alarm

    def _make_reading(self, state: LineUnitState, *, restarted: bool) -> ControllerReading:
        at_ns = (state.reply.sent_ns + state.reply.at_ns) // 2
        is_locked = state.status.state == "alarm" and self._dialect.traits.switches_motors
        axes: dict[str, AxisReading] = {}
        for name, axis in self._config.axes.items():
            status, counts = state.status.axes[axis.motors[0]], state.counts[name]
            is_moving = status.moving and state.status.state == "moving"
            axes[name] = AxisReading(
                commanded_counts=counts,
                actual_counts=float(counts),
                velocity_counts_s=self._estimate_velocity(name, counts, at_ns) if is_moving else 0.0,
                moving=is_moving,
                enabled=name in self._enabled and not is_locked,
                position_lost=self._position_lost,
                limit=status.limit,
            )
        faults: list[FaultReport] = []
        if self._has_alarm:
            faults.append(FaultReport(code="alarm", text=state.status.alarm, remedy="clear it with `tutti reset`"))
        return ControllerReading(at_ns, axes, faults=faults, restarted=restarted)

    def _estimate_velocity(self, axis: str, counts: int, at_ns: int) -> float:
        """Return the mean velocity since the last poll: the controller reports none."""
        if self._last is None or at_ns <= self._last.at_ns:
            return 0.0
        return (counts - self._last.axes[axis].commanded_counts) * NS_PER_S / (at_ns - self._last.at_ns)

    # Steps

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> LineLowered:
        moves, targets = lower_step(self._config, self._dialect, self._scales, profiles, start)
        ramps_s = [move.velocity / move.acceleration for move in moves if move.distance]
        costs = self._step_costs(max([self._ramp_s, *ramps_s]))
        return make_lowered(moves, targets, profiles, self._options, costs)

    async def stop(self, *, abort: bool) -> None:
        """Stop by the ramp; an abort as well: nothing faster keeps the position."""
        connection = self.connection
        connection.unit.write_stop()
        connection.mover.record_stop()
        self._log.info("stop written", abort=abort)

    # Manual operation

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        """Switch motors; where the controller cannot, the adapter does not move a disabled axis."""
        unit = self.connection.unit
        async with unit.commanding:
            await unit.wait_until_tidy()
            await unit.read_state()
            if self._dialect.traits.switches_motors:
                motors = [self._config.axes[name].motors[0] for name in axes]
                await unit.session.run_procedure(self._dialect.switch_motors(motors, on=on))
                await unit.number_again()
                self._note_number(unit)
        self._enabled.update(axes) if on else self._enabled.difference_update(axes)

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        if not axes:
            return {}
        unit = self.connection.unit
        stop_count = unit.stops
        self._require_free()
        if self._dialect.traits.joint and set(axes) != set(self._config.axes):
            remedy = f"home the whole controller: `tutti axis home {self._setup.controller}`"
            raise Refusal("homes-together", "this controller homes all its axes together", remedy)
        async with unit.commanding:
            await unit.wait_until_tidy()
            await unit.require_ready(axes)
            motors = [self._config.axes[name].motors[0] for name in axes]
            timeout_s = max(self._config.axes[name].homing.timeout_s for name in axes)
            failure = await self._search(self._dialect.search_reference(motors, timeout_s), stop_count)
            await unit.wait_until_tidy()
        counts = (await unit.read_state()).counts
        failures: dict[str, Refusal] = {}
        for name in axes:
            if failure or counts[name] != 0:
                reason = failure or f"it is at {counts[name]} counts; see `reference` in the options"
                text = f"axis {name} has not found its reference: {reason}"
                failures[name] = Refusal("homing-failed", text, "check its switch")
            else:
                found(name)
        if not failures and set(axes) == set(self._config.axes):
            self._position_lost = False
        return failures

    async def _search(self, steps: Sequence[LineStep], since: int) -> str:
        """Run a search; return why it failed, or "". A search that is not waited for any more is stopped."""
        unit = self.connection.unit

        def check() -> None:
            unit.require_no_stop(since)
            unit.is_searching = True

        asking: asyncio.Task[None] | None = None
        if not self._dialect.traits.answers_while_homing:
            asking = asyncio.get_running_loop().create_task(self._ask_during_search())
            steps = [self._accept_status(step) for step in steps]
        try:
            for number, step in enumerate(steps):
                if number == 0:
                    await unit.session.run_once(step, check)
                elif step.data:
                    await unit.session.run_step(step)
                if step.until:
                    await unit.session.wait_for_state(step)
        except (Refusal, ControllerFault) as error:
            if not unit.is_searching or (isinstance(error, ControllerFault) and unit.stops == since):
                raise
            return error.text
        except BaseException:
            if unit.is_searching:
                with suppress(LinkClosed):
                    unit.write_stop()
            raise
        finally:
            unit.is_searching = False
            if asking is not None:
                asking.cancel()
                unit.session.disturb()
        return "it was stopped" if unit.stops != since else ""

    def _accept_status(self, step: LineStep) -> LineStep:
        """Return a step of a search that also ends with a status at rest: the reply of its end may be lost."""
        is_done = step.is_done
        if is_done is None:
            return step

        def is_over(line: str) -> bool:
            status = self._dialect.read_status([line])
            return is_done(line) or (status is not None and status.state != "moving")

        return replace(step, is_done=is_over)

    async def _ask_during_search(self) -> None:
        """Ask for the status now and then. A controller that searches does not answer; one that has ended does."""
        session, question = self.connection.unit.session, self._dialect.ask_status().data
        with suppress(LinkClosed):
            while True:
                await sleep_ns(self._clock, NS_PER_S)
                session.write_at_once(question)

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        unit = self.connection.unit
        stop_count = unit.stops
        self._require_free()
        async with unit.commanding:
            await unit.wait_until_tidy()
            state = await unit.read_state()
            motor = self._config.axes[axis].motors[0]
            if state.status.state != "moving":
                self._jogs.clear()
            joint = self._dialect.traits.joint
            if state.status.state == "moving" and joint and axis not in self._jogs:
                raise Refusal("busy", "another axis moves; this controller jogs one at a time", "stop it first")
            if state.status.state == "moving" and state.status.axes[motor].moving:
                if self._jogs.get(axis) == move:
                    return
                self.connection.unit.session.write_at_once(self._dialect.stop_jog(motor))
                state = await self._wait_for_rest(motor)
            if axis not in self._enabled:
                raise Refusal("not-enabled", f"axis {axis} is not enabled", f"enable {axis} first")
            if state.status.state in ("held", "alarm") or await unit.is_restarted(state):
                raise Refusal("not-ready", f"the controller is {state.status.state}", "see `tutti status`")
            target = self._make_jog_target(axis, move, state.counts[axis])
            (first, *later_steps) = self._dialect.begin_jog(target)

            async def send(check: Callable[[], None]) -> None:
                await unit.session.run_once(first, check)
                await unit.session.run_procedure(later_steps)

            await send_or_brake(
                send,
                lambda: unit.require_no_stop(stop_count),
                lambda: unit.session.write_at_once(self._dialect.stop_jog(motor)),
            )
            self._jogs[axis] = move

    def _make_jog_target(self, axis: str, move: JogMove, here: int) -> LineTarget:
        """Return the target of a jog. Raises `Refusal`."""
        scale, config = self._scales[axis], self._config.axes[axis]
        end = move.end_counts
        if end is None:
            end = here + round(move.velocity_counts_s * _JOG_AHEAD_S)
        if (end - here) * move.velocity_counts_s <= 0:
            raise Refusal("at-end", f"axis {axis} is at {here}; its range in this direction ends at {end}", "jog back")
        ramp = axis_acceleration(config) if self._dialect.traits.fixed_acceleration else move.ramp_counts_s2
        return LineTarget(
            config.motors[0],
            scale.to_position(end),
            (end - here) / scale.counts_per_unit,
            abs(move.velocity_counts_s) / scale.counts_per_unit,
            ramp / scale.counts_per_unit,
        )

    async def _wait_for_rest(self, motor: str) -> LineUnitState:
        """Wait until a jog that was stopped has come to rest. Raises `ControllerFault`."""
        unit = self.connection.unit
        limit_ns = self._clock.now_ns() + round(self._ramp_s * NS_PER_S) + _REST_NS
        while True:
            state = await unit.read_state()
            if state.status.state != "moving" or not state.status.axes[motor].moving:
                return state
            if self._clock.now_ns() > limit_ns:
                raise ControllerFault("not-stopping", f"{motor} does not stop", "stop it at the controller")
            await sleep_ns(self._clock, _POLL_NS)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        unit = self.connection.unit
        for name in axes:
            self._jogs.pop(name, None)
            unit.session.write_at_once(self._dialect.stop_jog(self._config.axes[name].motors[0]))
        unit.stops += bool(axes)

    async def set_output(self, number: int, *, on: bool) -> None:
        await self.connection.unit.read_state()
        raise Refusal("no-output", f"there is no output {number}: this adapter drives none", "")

    async def clear_faults(self) -> None:
        unit = self.connection.unit
        async with unit.commanding:
            await unit.wait_until_tidy()
            state = await unit.read_state()
            if state.status.state == "moving":
                raise Refusal("moving", "faults cannot be cleared while an axis moves", "wait for its end, or stop it")
            if state.status.state == "alarm":
                await unit.clear_alarm()
                self._note_number(unit)

    async def send_raw(self, command: str) -> str:
        if not command.isascii() or not command.isprintable():
            raise Refusal("raw-line", "a raw command is one line of printable ASCII", "send one line")
        session = self.connection.unit.session
        step = LineStep(command.encode() + self._dialect.traits.terminators[0].encode(), lambda _: True)
        return "\n".join((await session.run_step(step)).lines)

    async def close(self) -> None:
        old_connection, self._connection = self._connection, None
        if old_connection is None:
            return
        self._log.info("link closed")
        move = old_connection.mover.move
        if move is not None and move.running is not None:
            move.running.cancel()
            if move.order is not None:
                move.order.cancel_write()
        old_connection.unit.cancel()
        if old_connection.unit.session.restarted or old_connection.unit.has_lost_session:
            self._restarted = self._restarted or self._number != 0
        await old_connection.unit.session.close()

    def _require_free(self) -> None:
        if self.connection.mover.move is not None:
            raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")


def _query_key(step: LineStep) -> tuple[bytes, str]:
    """What makes two queries the same one: the bytes, and the reply that is expected."""
    return step.data, step.expected
