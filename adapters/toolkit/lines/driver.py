"""The driver of a controller with text lines."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.abilities import ManualDriver, OutputDriver
from adapters.contract import (
    ControllerIdentity,
    ControllerReading,
    ControllerRestarted,
    DriverCapabilities,
    DriverSetup,
    JogMove,
)
from adapters.toolkit.connection import ConnectedDriver
from adapters.toolkit.lines.dialect import LineDialect, LineStep
from adapters.toolkit.lines.homing import ReferenceSearch
from adapters.toolkit.lines.jogging import LineJogging
from adapters.toolkit.lines.lowering import (
    CountScale,
    LineLowered,
    lower_step,
    make_lowered,
    step_costs,
)
from adapters.toolkit.lines.mover import LineMover
from adapters.toolkit.lines.options import LineOptions
from adapters.toolkit.lines.reading import LineReader
from adapters.toolkit.lines.session import LineSession
from adapters.toolkit.lines.unit import LineTools, LineUnit
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import StepCosts

_MOST_NUMBERS = 99


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
        self._number = 0  # that the controller held when its connection was closed; 0: none
        self._restarted = False
        self._jogging = LineJogging(setup.config, dialect, scales)
        self._reader = LineReader(setup.config, dialect)

    # Connection

    async def connect(self) -> ControllerIdentity:
        await self.close()
        self._reader.was_sound = False
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
        await self._require_no_doubt(unit)
        await self._compare_session(unit)
        self.log_identity(session.link.endpoint, identity)
        return identity

    async def _require_no_doubt(self, unit: LineUnit) -> None:
        """Raise `ControllerFault` for a controller that shows at rest what the make does not expect of it."""
        doubt = (await unit.read_state()).status.doubt
        if doubt:
            raise ControllerFault("config-mismatch", doubt, "is it the right make? if so, correct that line")

    async def _compare_session(self, unit: LineUnit) -> None:
        """Find out whether the controller was off since the last connection, and number this session."""
        number = await unit.read_number()
        if self._number and number == self._number:
            return
        self._restarted = self._restarted or self._number != 0
        unit.number = number % _MOST_NUMBERS + 1
        unit.must_number = True
        with suppress(Refusal):  # in an alarm: it is numbered when that is cleared
            await unit.write_number()
        unit.has_lost_session = False

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
        if unit.is_searching and not self._dialect.traits.answers_while_homing:
            reading = self._reader.repeat_moving(self._clock.now_ns())
            if reading is not None:
                return reading
        state = await unit.read_state()
        if await unit.is_restarted(state):
            raise ControllerRestarted
        is_restarted, self._restarted = self._restarted, False
        return self._reader.make_reading(state, self._enabled, restarted=is_restarted)

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
            failure = await ReferenceSearch(unit).search(self._dialect.search_reference(motors, timeout_s), stop_count)
            await unit.wait_until_tidy()
        state = await unit.read_state()
        if state.status.state == "alarm":  # a search in vain may be answered like any other
            failure = failure or f"the controller reports {state.status.alarm}"
        failures: dict[str, Refusal] = {}
        for name in axes:
            position = state.status.axes[self._config.axes[name].motors[0]].position
            if failure or state.counts[name] != 0:
                reference = self._scales[name].to_position(0)
                reason = failure or f"it is at {position:g}, not at {reference:g}; see `reference` in the options"
                text = f"axis {name} has not found its reference: {reason}"
                failures[name] = Refusal("homing-failed", text, "check its switch")
            else:
                found(name)
                self._reader.lost_axes.discard(name)
        return failures

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        unit = self.connection.unit
        stop_count = unit.stops
        self._require_free()
        async with unit.commanding:
            await self._jogging.jog_axis(unit, axis, move, stop_count)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        self._jogging.stop_axes(self.connection.unit, axes)

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
        unit = old_connection.unit
        unit.cancel()
        self._number = 0 if unit.must_number else unit.number
        if unit.session.restarted or unit.has_lost_session:
            # Also where a stop after the restart has found the lock, in which the controller takes no number.
            self._restarted = self._restarted or unit.number != 0
        await unit.session.close()

    def _require_free(self) -> None:
        if self.connection.mover.move is not None:
            raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")


def _query_key(step: LineStep) -> tuple[bytes, str]:
    """What makes two queries the same one: the bytes, and the reply that is expected."""
    return step.data, step.expected
