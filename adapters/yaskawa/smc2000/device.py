"""An SMC-2000 on a serial line: connection, identification, installation of its resident program, and polls of one
printed line."""

from collections.abc import Iterable, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass

from adapters.contract import ControllerIdentity, ControllerRestarted
from adapters.yaskawa.common import arrays
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.gate import SINGLE_CONDITIONS
from adapters.yaskawa.common.program import OUTPUT_PASSIVE, TABLE
from adapters.yaskawa.shapes.model import LEAVE_CONTOUR
from adapters.yaskawa.smc2000 import program as smc2000_program
from adapters.yaskawa.smc2000.exchange import LineTiming
from adapters.yaskawa.smc2000.line import SharedSerialLine
from adapters.yaskawa.smc2000.options import Smc2000DriverOptions
from adapters.yaskawa.smc2000.polls import PolledSession
from adapters.yaskawa.smc2000.program import AXIS_VALUES
from adapters.yaskawa.smc2000.resident import SerialResidentProgram
from adapters.yaskawa.smc2000.selection import ADDRESS
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.record import (
    MOTOR_OFF,
    MOVING,
    OFF_ON_ERROR,
    STOPPING,
    VELOCITY_SCALE,
    AxisRecord,
    DataRecord,
)
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, sleep_ns
from orchestrator.link.base import LinkClosed, OpenLink
from orchestrator.model.errors import ControllerFault

STOP_SEND_NS = 50 * NS_PER_MS  # for a stop's bytes to be sent before the port may be closed
STOPPING_CODES = (2, 3, 4)  # of SC: by a limit or ST, while it still decelerates (L11427-11493)

# Bits of TS (L12128-12165)
TS_MOVING = 1 << 7
TS_MOTOR_OFF = 1 << 5
SWITCHES = 1 << 3 | 1 << 2  # forward, reverse; 1 = inactive, whatever CN is set to


@dataclass(frozen=True, slots=True)
class LineAddress:
    """A controller's line, and its address in a chain; None for a controller alone on its line."""

    line: SharedSerialLine
    unit: int | None


@dataclass(frozen=True, slots=True)
class PolledPoints:
    """What is polled of a controller: its motors by index in ascending order, and the number of words of its inputs and
    outputs."""

    axes: list[int]
    inputs: int
    outputs: int


class SerialDevice(SmcDevice):
    """One controller on a serial line."""

    BESIDE = smc2000_program.INTERLEAVED_COMMANDS
    SINGLE = SINGLE_CONDITIONS
    STEP_THREADS = smc2000_program.STEP_THREADS

    def __init__(
        self,
        where: LineAddress,
        clock: Clock,
        open_link: OpenLink,
        options: Smc2000DriverOptions,
        polled: PolledPoints,
    ) -> None:
        super().__init__(clock, open_link, options, polled.axes[-1] + 1)
        self._serial_options = options
        self.resident = self._serial_resident = SerialResidentProgram(options, chained=where.unit is not None)
        self._line = where.line
        self._unit = where.unit
        self._axes = polled.axes
        self._inputs = polled.inputs
        self._outputs = polled.outputs
        self._polled_session: PolledSession | None = None
        self._last_positions: tuple[int, dict[int, int]] | None = None
        """Sample and positions of the last polled line."""
        where.line.units.add(where.unit)

    @property
    def sharing_count(self) -> int:
        return len(self._line.units)

    # Connection

    async def connect(self) -> ControllerIdentity:
        await self.close()
        options = self._serial_options
        link = await self._line.attach_controller(self._unit, self._open_link, self._clock.now_ns())
        self._last_positions = None
        session = self._polled_session = PolledSession(
            self._line,
            link,
            self._clock,
            self._unit,
            LineTiming(options.timeout_s, options.hold_us * NS_PER_US, options.baud_tolerance),
        )
        session.log = self.log
        self.log.info("link opened", place=link.endpoint, address=self._unit)
        revision = await session.read_revision()
        present = len((await session.query_lines("RP")).lines[0].split(","))
        if present < self._axes_needed:
            letter = smc2000_program.LETTERS[self._axes_needed - 1]
            raise ControllerFault(
                "config-mismatch",
                f"the fleet file uses motor {letter}; the controller has {present} axes",
                "correct `motors`, or `address` of the link, in the fleet file",
            )
        return await self._load_and_identify(revision)

    async def close(self) -> None:
        self._polled_session = None
        await self._line.detach_controller(self._unit)

    async def install_program(self) -> None:
        session, is_chained = self.session, self._unit is not None
        program = smc2000_program.program_lines(
            self._axes, chained=is_chained, inputs=self._inputs, outputs=self._outputs, gate=self.gate
        )
        await self._serial_resident.install_lines(session, program)
        for name in smc2000_program.program_variables(self._axes, chained=is_chained):
            await session.send_command(f"{name}=0")
        if is_chained:
            await session.send_command(f"{ADDRESS}={self._unit}")
            session.verify_address()
        await arrays.free_arrays(session, (*smc2000_program.contour_arrays(self._axes), TABLE))

    async def list_program_lines(self, first: int, last: int) -> list[str]:
        return await self._serial_resident.list_own_lines(self.session, first, last)

    @property
    def is_chained(self) -> bool:
        """Return whether it has an address on a daisy chain."""
        return self._unit is not None

    @property
    def program_axes(self) -> Sequence[int]:
        return self._axes

    def exclusive_turn(self) -> AbstractAsyncContextManager[None]:
        return self.session.exclusive_turn()

    # Communication

    @property
    def session(self) -> PolledSession:
        if self._polled_session is None:
            raise LinkClosed("the controller is not connected")
        return self._polled_session

    async def read_record(self) -> DataRecord:
        record, _ = await self._poll_record()
        return record

    async def read_record_with(self, *operands: str) -> tuple[DataRecord, list[float]]:
        record = await self.read_record()
        values, _ = await self.session.read_numbers(*operands)
        return record, values

    async def poll_state(self) -> tuple[DataRecord, bool]:
        record, went_on = await self._poll_record()
        if not went_on:
            self._restarted = True
            self.log.warning("the sample counter began again: the controller was restarted")
            raise ControllerRestarted()
        is_restarted, self._restarted = self._restarted, False
        return record, is_restarted

    async def _poll_record(self) -> tuple[DataRecord, bool]:
        is_chained = self._unit is not None
        head_size = len(smc2000_program.printed_head(chained=is_chained, inputs=self._inputs, outputs=self._outputs))
        count = head_size + AXIS_VALUES * len(self._axes)
        try:
            status = await self.session.request_status(smc2000_program.POLL_COMMAND, count)
        except SmcCommandRefused:
            self.log.warning("the resident program is missing")
            self._restarted |= not await self._read_time()
            raise LinkClosed(
                "its resident program is missing; the connection is set up again from the beginning"
            ) from None
        values = status.values
        if is_chained:
            values = values[1:]
            head_size -= 1
        # Two commands were executed before the counter was read: XQ, and MG of the program.
        went_on = self.samples.add_full_reading(
            self._earliest_ns(self._earliest_ns(status.sent_ns)), status.received_ns, values[0]
        )
        words = values[1:head_size]
        inputs = _join_words(words[: self._inputs], smc2000_program.INPUTS_OF_WORD)
        outputs = _join_words(words[self._inputs :], smc2000_program.OUTPUTS_OF_WORD)
        return DataRecord(
            sample=values[0],
            inputs=inputs,
            outputs=outputs,
            program_runs=False,
            axes=self._axis_records(values[0], values[head_size:]),
            sent_ns=status.sent_ns,
            received_ns=status.complete_ns,
        ), went_on

    def _axis_records(self, ticks: int, values: Sequence[int]) -> tuple[AxisRecord, ...]:
        records = [_NOTHING] * (self._axes[-1] + 1)
        last_positions, positions = self._last_positions, dict[int, int]()
        for number, index in enumerate(self._axes):
            commanded_position, error, byte, code = values[AXIS_VALUES * number : AXIS_VALUES * (number + 1)]
            positions[index] = commanded_position - error
            # TV would average over a quarter of a second (L12193), and need to be printed as well.
            velocity = 0.0
            if last_positions is not None and ticks > last_positions[0]:
                way = positions[index] - last_positions[1][index]
                velocity = way / ((ticks - last_positions[0]) * self.samples.tick_ns) * NS_PER_S
            records[index] = AxisRecord(
                status=_axis_status(byte, code),
                switches=byte & SWITCHES,
                stop_code=code,
                commanded=commanded_position,
                actual=positions[index],
                error=error,
                auxiliary=0,
                velocity=round(velocity * VELOCITY_SCALE),
                torque=0,
            )
        self._last_positions = (ticks, positions)
        return tuple(records)

    # Stops

    async def stop_before_connect(self) -> bool:
        """Stop the controller before it is connected, over the line that other controllers may have open. Return False
        if it is alone on its line."""
        if self._unit is None:
            return False
        link = await self._line.attach_controller(self._unit, self._open_link, self._clock.now_ns())
        self.log.info("stopping the controller before it is connected", place=link.endpoint, address=self._unit)
        try:
            self._line.write_at_once(link, self._unit, stop_commands(abort=False), unknown=True)
            await sleep_ns(self._clock, STOP_SEND_NS)
        finally:
            await self._line.detach_controller(self._unit)
        return True

    async def wait_for_stops(self) -> None:
        """Do nothing: the controller executes later commands of the line later."""

    def stop_all(self, *, abort: bool) -> None:
        self.stop_counts.count_all()
        self.write_stop(*stop_commands(abort=abort))

    def write_stop(self, *commands: str) -> None:
        self.session.write_at_once(*commands)


def stop_commands(*, abort: bool) -> tuple[str, ...]:
    """Return the commands that stop all axes and prevent the waiting program from starting any.

    ST without letters stops all motion, and programs too (L11610-11613); HX halts all threads regardless of that
    (L9205). AB stops motion at once, and programs (L6768). A contour that has not begun yet is left by its own command;
    a contour in progress ends with its present record (SC 51, L11427-11493).
    """
    return (*(("AB", "HX") if abort else ("ST", "HX", "ST")), *LEAVE_CONTOUR, OUTPUT_PASSIVE)


_NOTHING = AxisRecord(
    status=0, switches=0, stop_code=0, commanded=0, actual=0, error=0, auxiliary=0, velocity=0, torque=0
)


def _join_words(words: Iterable[int], size: int) -> int:
    return sum(word << size * number for number, word in enumerate(words))


def _axis_status(byte: int, code: int) -> int:
    """Convert the switch byte (TS) and the stop code to the terms of the SMC-4000's record."""
    is_moving = bool(byte & TS_MOVING)
    return (
        (MOVING if is_moving else 0)
        | (STOPPING if is_moving and code in STOPPING_CODES else 0)
        | (MOTOR_OFF if byte & TS_MOTOR_OFF else 0)
        | (OFF_ON_ERROR if byte & TS_MOTOR_OFF and code == 8 else 0)
    )
