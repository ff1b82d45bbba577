"""A probe by the resident program: any input of an SMC-4000 stops an axis, at either level.

The program begins the axis itself, waits for the level of the input (AI, which tests it at samples), and stops the axis
(`#PROBE1`). From the edge to the stop these pass: the optocoupler, a sample, the time of a command, and that of a
command of the host that comes in between. It needs nothing of the host from its begin on.
"""

from adapters.contract import HostInterval, ProbedContact, ProbeMove
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
        contact_s=_find_read_us(options) / 1e6,
        contact_counts=POSITION_COUNTS,
    )


def _find_stop_us(options: YaskawaOptions) -> float:
    """From the edge to the stop at most, µs."""
    opto_us, tick_us = max(options.input_rise_us, options.input_fall_us), options.tick_ns / NS_PER_US
    return opto_us + tick_us + options.begin_max_us + options.interleaved_us


def _find_read_us(options: YaskawaOptions) -> float:
    """From the edge to the position at most, µs: an expression may take twice as long as a command (L1626)."""
    return _find_stop_us(options) + 2 * options.interleaved_us


class ProgramProbe:
    """A probe of one axis. index: of its motor."""

    def __init__(
        self, device: SmcDevice, clock: Clock, options: YaskawaOptions, model: ModelTraits, index: int
    ) -> None:
        self._device = device
        self._clock = clock
        self._options = options
        self._model = model
        self._index = index
        self._letter = AXIS_LETTERS[index]

    async def run(self, axis: str, move: ProbeMove) -> ProbedContact | None:
        """As `ProbeDriver.probe_axis`. Raises `Refusal`, `ControllerFault`."""
        stops = self._device.stop_counts.stop_count(self._index)
        try:
            checked_ns = await self._begin(axis, move, stops)
            begun_ns = self._clock.now_ns()
            return await self._wait(axis, move, HostInterval(checked_ns, begun_ns))
        except BaseException:
            brake_probe(self._device, self._index, f"HX{STEP_THREAD}")
            raise
        finally:
            # Behind this a new connection finds no probe to stop.
            await self._device.session.send_command(f"{PROBE_INPUT}=0")

    async def _begin(self, axis: str, move: ProbeMove, stops: int) -> int:
        """Begin the program; return when the input still had its other level."""
        device, letter = self._device, self._letter

        def require_no_stop() -> None:
            device.stop_counts.require_no_stop(axis, self._index, stops)

        registers = ProbeRegisters.find(axis, move, device.samples.tick_ns * 1e-9, self._model)
        number = move.point.number if move.level else -move.point.number
        commands = (
            f"HX{WATCHDOG_THREAD}",  # that of the last step would take turns with the program
            f"{PROBE_TIME}=0",
            f"{PROBE_INPUT}={number}",
            *registers.list_commands(letter),
            f"PA{letter}={move.end_counts}",
        )
        async with device.exclusive_turn():
            await device.session.send_settings(commands, require_no_stop)
            record = await device.read_record()
            if self._is_touched(move, record):
                text = f"input {move.point.number} changed before the probe of axis {axis} began"
                raise Refusal("line-level", text, "move the axis away from the contact first")
            await device.wait_for_stops()
            await device.session.send_command(f"XQ {probe_label(self._index)},{STEP_THREAD}", require_no_stop)
        require_no_stop()
        if await device.stop_counts.sleep_to_stop(BEGIN_COMMANDS * self._options.interleaved_us * NS_PER_US):
            raise make_stopped(axis)
        return record.sent_ns

    async def _wait(self, axis: str, move: ProbeMove, begin: HostInterval) -> ProbedContact | None:
        """Wait for rest, and return the contact. begin: from the last look at the input to the motion."""
        was_touched = False
        while True:
            record, (seen_tick, is_running) = await self._device.read_record_with(PROBE_TIME, f"_HX{STEP_THREAD}")
            if not record.axes[self._index].is_moving:
                break
            if not seen_tick:
                await self._require_watched(axis, move, running=bool(is_running), touched=was_touched)
            was_touched = self._is_touched(move, record)
            if await self._device.stop_counts.sleep_to_stop(LOOK_NS):
                raise make_stopped(axis)
        await self._device.session.send_command(f"HX{STEP_THREAD}")
        record, (seen_tick, position, code) = await self._device.read_record_with(
            PROBE_TIME, probe_position(self._index), f"_SC{self._letter}"
        )
        if int(code) not in (AT_END, STOPPED):
            meaning = stop_code_meaning(int(code))
            raise Refusal("probe-broken", f"axis {axis}: the probe {meaning.text}", meaning.remedy)
        if seen_tick:
            return self._make_contact(axis, move, int(seen_tick), position, begin)
        if record.axes[self._index].commanded != move.end_counts or self._is_touched(move, record):
            text = f"axis {axis} came to rest, and the program has seen no contact there"
            raise Refusal("probe-broken", text, "was it stopped by another client? Probe again, a little farther")
        return None

    async def _require_watched(self, axis: str, move: ProbeMove, *, running: bool, touched: bool) -> None:
        """Raise `Refusal` where an axis moves whose input the program does not watch. touched: the look before
        has shown the contact."""
        if not running:
            words = (await self._device.session.query_lines("TC1")).lines[0]
            text = f"the program that watches the input of axis {axis} has ended; the last error: {words}"
            raise Refusal("probe-broken", text, "see what other client halts programs, then probe again")
        if touched:
            text = f"input {move.point.number} has changed, and the program has not stopped axis {axis}"
            raise Refusal("probe-broken", text, "see what delays the controller, then probe again")

    def _make_contact(
        self, axis: str, move: ProbeMove, ticks: int, position: float, begin: HostInterval
    ) -> ProbedContact:
        options = self._options
        read_us = _find_read_us(options)
        mapping = self._device.samples.current_mapping()
        if mapping is None:
            raise Refusal("probe-broken", f"axis {axis}: the controller's clock is not known", "probe again")
        latest_ns = mapping.to_host_ns(ticks + 1)
        bound_ns = mapping.bound_at_ns(latest_ns)
        way_ns = round((read_us + 2 * options.interleaved_us) * NS_PER_US)
        earliest_ns = mapping.to_host_ns(ticks) - way_ns - bound_ns
        if earliest_ns <= begin.latest_ns:
            # It may have been made before the program looked.
            earliest_ns = begin.earliest_ns - way_ns
        sign = 1 if move.end_counts >= position else -1
        early = position - sign * (move.speed_counts_s * read_us * 1e-6 + POSITION_COUNTS / 2)
        late = position + sign * POSITION_COUNTS / 2
        return ProbedContact(min(early, late), max(early, late), HostInterval(earliest_ns, latest_ns + bound_ns))

    def _is_touched(self, move: ProbeMove, record: DataRecord) -> bool:
        return bool(record.inputs >> move.point.number - 1 & 1) == move.level
