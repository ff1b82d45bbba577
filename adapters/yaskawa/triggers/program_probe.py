"""A probe by the resident program: any input of an SMC-4000 stops an axis, at either level.

The program begins the axis itself, waits for the level of the input (AI, which tests it at samples), and stops the axis
(`#PROBE1`). From the edge to the stop these pass: the optocoupler, a sample, the time of a command, and that of a
command of the host that comes in between. It needs nothing of the host from its begin on.
"""

from collections.abc import Iterable, Mapping, Sequence

from adapters.contract import HostInterval, LimitMove, ProbedContact, ProbeMove
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.lines import LOCAL_POINTS
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import (
    PROBE_INPUT,
    PROBE_TIME,
    STEP_THREAD,
    WATCHDOG_THREAD,
    probe_label,
    probe_position,
)
from adapters.yaskawa.language.words import stop_code_meaning
from adapters.yaskawa.shapes.model import ModelTraits
from adapters.yaskawa.triggers.probe import (
    AT_END,
    LOOK_NS,
    MARGIN_COUNTS,
    RAMP_SHARE,
    REACTION_S,
    ProbeRegisters,
    brake_probe,
    make_stopped,
)
from adapters.yaskawa.wire.record import AXIS_LETTERS, DataRecord
from orchestrator.clock.base import NS_PER_S, NS_PER_US, Clock
from orchestrator.model.errors import Refusal
from orchestrator.model.state import ProbeAbility

POSITION_COUNTS = 1.0  # by which a position is rounded
BEGIN_COMMANDS = 8  # in which the program has begun the axis, and reads its first input
STOPPED = 4  # stop code (L9858-9899)


def find_program_ability(axes: list[str], options: YaskawaOptions) -> ProbeAbility:
    """Any of the local inputs stops an axis (L2491)."""
    return ProbeAbility(
        inputs={axis: list(range(1, LOCAL_POINTS + 1)) for axis in axes},
        levels=["active", "passive"],
        reaction_s=REACTION_S + options.tick_ns / NS_PER_S,
        ramp_share=RAMP_SHARE,
        margin_counts=MARGIN_COUNTS,
        contact_s=find_read_us(options) / 1e6,
        contact_counts=POSITION_COUNTS,
    )


def _find_stop_us(options: YaskawaOptions) -> float:
    """From the edge to the stop at most, µs."""
    opto_us, tick_us = max(options.input_rise_us, options.input_fall_us), options.tick_ns / NS_PER_US
    return opto_us + tick_us + options.begin_max_us + options.interleaved_us


def find_read_us(options: YaskawaOptions, reads: int = 1) -> float:
    """From the edge to the position that is read as number `reads` at most, µs: an expression may take twice as long as
    a command (L1626)."""
    return _find_stop_us(options) + 2 * reads * options.interleaved_us


class ProgramProbe:
    """A probe of one axis; on a line of several see `LineProbe`. motors: by axis, its index."""

    END_CODE = AT_END
    """The stop code of an axis that has come to its end."""

    def __init__(
        self,
        device: SmcDevice,
        clock: Clock,
        options: YaskawaOptions,
        model: ModelTraits,
        motors: Mapping[str, int],
    ) -> None:
        self._device = device
        self._clock = clock
        self._options = options
        self._model = model
        self._motors = motors
        self._names = " and ".join(motors)

    async def run(self, moves: Mapping[str, ProbeMove]) -> Mapping[str, ProbedContact] | None:
        """As `ProbeDriver.probe_axis`, of each axis. Raises `Refusal`, `ControllerFault`."""
        counts = self._device.stop_counts
        stops = {axis: counts.stop_count(index) for axis, index in self._motors.items()}
        try:
            checked_ns = await self._begin(moves, stops)
            begun_ns = self._clock.now_ns()
            return await self._wait(moves, HostInterval(checked_ns, begun_ns))
        except BaseException:
            self._brake()
            raise
        finally:
            # Behind this a new connection finds no probe to stop.
            await self._device.session.send_command(f"{PROBE_INPUT}=0")

    @property
    def _label(self) -> str:
        """Where the program begins."""
        (index,) = self._motors.values()
        return probe_label(index)

    def _list_commands(self, moves: Mapping[str, ProbeMove], record: DataRecord) -> Iterable[str]:
        """The commands that load the move. record: where the axes stand."""
        del record
        ((axis, move),) = moves.items()
        letter, registers = AXIS_LETTERS[self._motors[axis]], self._find_registers(move)
        return (*registers.list_commands(letter), f"PA{letter}={move.end_counts}")

    def _brake(self) -> None:
        (index,) = self._motors.values()
        brake_probe(self._device, index, f"HX{STEP_THREAD}")

    def _find_registers(self, move: LimitMove) -> ProbeRegisters:
        return ProbeRegisters.find(self._names, move, self._device.samples.tick_ns * 1e-9, self._model)

    async def _begin(self, moves: Mapping[str, ProbeMove], stops: Mapping[str, int]) -> int:
        """Begin the program; return when the input still had its other level."""
        device, move = self._device, next(iter(moves.values()))

        def require_no_stop() -> None:
            for axis, index in self._motors.items():
                device.stop_counts.require_no_stop(axis, index, stops[axis])

        number = move.point.number if move.level else -move.point.number
        async with device.exclusive_turn():
            commands = (
                f"HX{WATCHDOG_THREAD}",  # that of the last step would take turns with the program
                f"{PROBE_TIME}=0",
                f"{PROBE_INPUT}={number}",
                *self._list_commands(moves, await device.read_record()),
            )
            await device.session.send_settings(commands, require_no_stop)
            record = await device.read_record()
            if _is_touched(move, record):
                text = f"input {move.point.number} changed before the probe of axis {self._names} began"
                raise Refusal("line-level", text, "move the axis away from the contact first")
            await device.wait_for_stops()
            await device.session.send_command(f"XQ {self._label},{STEP_THREAD}", require_no_stop)
        require_no_stop()
        if await device.stop_counts.sleep_to_stop(BEGIN_COMMANDS * self._options.interleaved_us * NS_PER_US):
            raise make_stopped(self._names)
        return record.sent_ns

    async def _wait(self, moves: Mapping[str, ProbeMove], begin: HostInterval) -> Mapping[str, ProbedContact] | None:
        """Wait for rest, and return the contacts. begin: from the last look at the input to the motion."""
        device, move, was_touched = self._device, next(iter(moves.values())), False
        while True:
            record, (seen_tick, is_running) = await device.read_record_with(PROBE_TIME, f"_HX{STEP_THREAD}")
            if not any(record.axes[index].is_moving for index in self._motors.values()):
                break
            if not seen_tick:
                await self._require_watched(move, running=bool(is_running), touched=was_touched)
            was_touched = _is_touched(move, record)
            if await device.stop_counts.sleep_to_stop(LOOK_NS):
                raise make_stopped(self._names)
        await device.session.send_command(f"HX{STEP_THREAD}")
        indices = list(self._motors.values())
        operands = [
            *(probe_position(index) for index in indices),
            *(f"_SC{AXIS_LETTERS[index]}" for index in indices),
        ]
        record, (seen_tick, *values) = await device.read_record_with(PROBE_TIME, *operands)
        positions, codes = values[: len(indices)], values[len(indices) :]
        self._require_codes(codes)
        if seen_tick:
            return self._make_contacts(moves, int(seen_tick), positions, begin)
        is_at_end = all(record.axes[self._motors[axis]].commanded == move.end_counts for axis, move in moves.items())
        if not is_at_end or _is_touched(move, record):
            text = f"axis {self._names} came to rest, and the program has seen no contact there"
            raise Refusal("probe-broken", text, "was it stopped by another client? Probe again, a little farther")
        return None

    def _require_codes(self, codes: Sequence[float]) -> None:
        """Raise `Refusal` where an axis was stopped by something else than its program and its end."""
        for code in codes:
            if int(code) not in (self.END_CODE, STOPPED):
                meaning = stop_code_meaning(int(code))
                raise Refusal("probe-broken", f"axis {self._names}: the probe {meaning.text}", meaning.remedy)

    async def _require_watched(self, move: ProbeMove, *, running: bool, touched: bool) -> None:
        """Raise `Refusal` where an axis moves whose input the program does not watch. touched: the look before
        has shown the contact."""
        if not running:
            words = (await self._device.session.query_lines("TC1")).lines[0]
            text = f"the program that watches the input of axis {self._names} has ended; the last error: {words}"
            raise Refusal("probe-broken", text, "see what other client halts programs, then probe again")
        if touched:
            text = f"input {move.point.number} has changed, and the program has not stopped axis {self._names}"
            raise Refusal("probe-broken", text, "see what delays the controller, then probe again")

    def _make_contacts(
        self, moves: Mapping[str, ProbeMove], ticks: int, positions: Sequence[float], begin: HostInterval
    ) -> dict[str, ProbedContact]:
        options = self._options
        reads_us = {axis: self._find_read_us(index) for axis, index in self._motors.items()}
        mapping = self._device.samples.current_mapping()
        if mapping is None:
            raise Refusal("probe-broken", f"axis {self._names}: the controller's clock is not known", "probe again")
        latest_ns = mapping.to_host_ns(ticks + 1)
        bound_ns = mapping.bound_at_ns(latest_ns)
        way_ns = round((max(reads_us.values()) + 2 * options.interleaved_us) * NS_PER_US)
        earliest_ns = mapping.to_host_ns(ticks) - way_ns - bound_ns
        if earliest_ns <= begin.latest_ns:
            # It may have been made before the program looked.
            earliest_ns = begin.earliest_ns - way_ns
        span = HostInterval(earliest_ns, latest_ns + bound_ns)
        return {
            axis: _make_contact(moves[axis], position, reads_us[axis], span)
            for axis, position in zip(self._motors, positions, strict=True)
        }

    def _find_read_us(self, index: int) -> float:
        """From the edge to the position of an axis at most, µs."""
        del index
        return find_read_us(self._options)


def _make_contact(move: ProbeMove, position: float, read_us: float, span: HostInterval) -> ProbedContact:
    """The contact before a position that was read. read_us: from the edge to that at most."""
    sign = 1 if move.end_counts >= position else -1
    early = position - sign * (move.speed_counts_s * read_us * 1e-6 + POSITION_COUNTS / 2)
    late = position + sign * POSITION_COUNTS / 2
    return ProbedContact(min(early, late), max(early, late), span)


def _is_touched(move: ProbeMove, record: DataRecord) -> bool:
    return bool(record.inputs >> move.point.number - 1 & 1) == move.level
