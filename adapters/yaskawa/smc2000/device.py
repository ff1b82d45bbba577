"""An SMC-2000 behind a serial line: reached, identified, given its resident program, read in one printed line."""

from collections.abc import Iterable, Sequence
from contextlib import AbstractAsyncContextManager

from adapters.contract import DriverFault, Identity, Restarted
from adapters.yaskawa.common import arrays
from adapters.yaskawa.common.model import LEAVE_CONTOUR
from adapters.yaskawa.common.program import RELEASE
from adapters.yaskawa.common.record import MOTOR_OFF, MOVING, OFF_ON_ERROR, STOPPING, VELOCITY_SCALE, AxisRecord, Record
from adapters.yaskawa.smc2000 import program as smc2000_program
from adapters.yaskawa.smc2000.line import Line
from adapters.yaskawa.smc2000.options import Smc2000Options
from adapters.yaskawa.smc2000.polls import PolledSession
from adapters.yaskawa.smc2000.program import AXIS_VALUES
from adapters.yaskawa.smc2000.session import ADDRESS
from adapters.yaskawa.smc4000.device import Device
from adapters.yaskawa.smc4000.session import Refused
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, sleep_ns
from orchestrator.link.base import LinkClosed, OpenLink

THREADS = 4  # L3405
STOP_LEAVES_NS = 50 * NS_PER_MS  # for a stop's bytes to be sent before the port may be closed
AROUND_LISTED = 6  # characters of a listed line beside its text: number, blank, CR LF
LISTING_CHARACTERS = 8000  # a program may be so long; a controller need not send it as it reads it
STOPPING_CODES = (2, 3, 4)  # of SC: by a limit or ST, while it still decelerates (L11427-11493)

# Bits of TS (L12128-12165)
TS_MOVING = 1 << 7
TS_MOTOR_OFF = 1 << 5
SWITCHES = 1 << 3 | 1 << 2  # forward, reverse; 1 = inactive, whatever CN says


class SerialDevice(Device):
    """One controller of a serial line. axes: indices of its motors; inputs, outputs: words of them that are polled."""

    BESIDE = smc2000_program.BESIDE

    def __init__(
        self,
        line: Line,
        unit: int | None,
        clock: Clock,
        open_link: OpenLink,
        options: Smc2000Options,
        axes: Sequence[int],
        inputs: int,
        outputs: int,
    ) -> None:
        super().__init__(clock, open_link, options, max(axes) + 1)
        self._serial_options = options
        self._line = line
        self._unit = unit
        self._axes = sorted(axes)
        self._inputs = inputs
        self._outputs = outputs
        self._talk: PolledSession | None = None
        self._before: tuple[int, dict[int, int]] | None = None
        """Sample and positions of the last line."""
        line.units.add(unit)

    @property
    def sharing(self) -> int:
        return len(self._line.units)

    # Reaching it

    async def connect(self) -> Identity:
        await self.close()
        options = self._serial_options
        link = await self._line.attach(self._unit, self._open_link)
        self._before = None
        session = self._talk = PolledSession(
            self._line,
            link,
            self._clock,
            self._unit,
            options.timeout_s,
            options.hold_us * NS_PER_US,
            options.baud_tolerance,
        )
        revision = await session.revision()
        present = len((await session.ask("RP")).lines[0].split(","))
        if present < self._axes_needed:
            letter = smc2000_program.LETTERS[self._axes_needed - 1]
            raise DriverFault(
                "config-mismatch",
                f"the fleet file uses motor {letter}; the controller has {present} axes",
                "correct `motors`, or `unit` of the link, in the fleet file",
            )
        await self._install()
        (serial,), _ = await session.numbers("_BN")
        await self._read_time()
        model, _, firmware = revision.partition(" ")
        return Identity(model=model, firmware=firmware or revision, serial=str(int(serial)))

    async def close(self) -> None:
        self._talk = None
        await self._line.detach(self._unit)

    async def _install(self) -> None:
        session, chained = self.session, self._unit is not None
        wanted = smc2000_program.program(self._axes, chained, self._inputs, self._outputs, self.gate)
        await self._unload_ours()
        if not await self._holds(wanted):
            await self._require_no_other()
            try:
                await session.download(wanted)
            except Refused as refusal:
                raise DriverFault(
                    "program-refused",
                    f"the controller does not take its program: {refusal}",
                    "is its program memory locked (LC)?",
                ) from None
            if not await self._holds(wanted):
                raise DriverFault(
                    "program-differs", "the program read back is not the one sent", "check the cable; it is tried again"
                )
        for name in smc2000_program.variables(self._axes):
            await session.tell(f"{name}=0")
        if chained:
            await session.tell(f"{ADDRESS}={self._unit}")
            session.know_address()
        await arrays.free(session, smc2000_program.arrays(self._axes))

    async def _unload_ours(self) -> None:
        """Ours may still wait for a start that nobody will release any more: its first line tells that it is ours, long
        before all of it is read."""
        if any(smc2000_program.HEADING in line for line in await self._lines(0, 0)):
            await self.unload()

    async def _holds(self, wanted: tuple[str, ...]) -> bool:
        """Whether `wanted` is the controller's program."""
        if self._unit is None:
            return await self._listing() == list(wanted)
        at = 0
        for part in self.session.parts(wanted):
            # A controller need not send it as it reads it.
            characters = sum(len(line) + AROUND_LISTED for line in part)
            if await self._lines(at, at + len(part) - 1, characters) != list(part):
                return False
            at += len(part)
        return not await self._lines(at, at)

    async def _lines(self, first: int, last: int, characters: int = 0) -> list[str]:
        """Lines of the program by their numbers (LS, L10135); none where it has none, or does not tell them."""
        try:
            listed = await self.session.ask_all(f"LS {first},{last}", characters)
        except Refused:
            return []
        return [line.partition(" ")[2].rstrip() for line in listed]

    async def _listing(self) -> list[str]:
        try:
            return [line.rstrip() for line in await self.session.ask_all("UL", LISTING_CHARACTERS)]
        except Refused as refusal:
            raise DriverFault(
                "program-refused", f"the controller does not show its program: {refusal}", "unlock it (LC password,0)"
            ) from None

    async def _require_no_other(self) -> None:
        running, _ = await self.session.numbers(*(f"_HX{thread}" for thread in range(THREADS)))
        threads = [str(thread) for thread, state in enumerate(running) if state]
        if threads:
            raise DriverFault(
                "other-program",
                f"another program runs in the controller (thread {', '.join(threads)})",
                "stop it with HX, and its #AUTO start with it, if this controller belongs to the fleet",
            )
        present = await self._listing()
        if present and not self._serial_options.replace_program:
            raise DriverFault(
                "other-program",
                f"the controller holds another program of {len(present)} lines, and may not be given ours",
                "save it, then set `replace_program: true` in the controller's options",
            )

    def together(self) -> AbstractAsyncContextManager[None]:
        return self.session.together()

    # Talking

    @property
    def session(self) -> PolledSession:
        if self._talk is None:
            raise LinkClosed("the controller is not connected")
        return self._talk

    async def record(self) -> Record:
        record, _ = await self._poll_record()
        return record

    async def record_and(self, *operands: str) -> tuple[Record, list[float]]:
        record = await self.record()
        values, _ = await self.session.numbers(*operands)
        return record, values

    async def poll(self) -> tuple[Record, bool]:
        record, went_on = await self._poll_record()
        if not went_on:
            self._restarted = True
            raise Restarted()
        restarted, self._restarted = self._restarted, False
        return record, restarted

    async def _poll_record(self) -> tuple[Record, bool]:
        chained = self._unit is not None
        before = len(smc2000_program.head(chained, self._inputs, self._outputs))
        count = before + AXIS_VALUES * len(self._axes)
        try:
            status = await self.session.status(smc2000_program.POLL, count)
        except Refused:
            self._restarted |= not await self._read_time()
            raise LinkClosed("its program has gone; the controller is connected again from the beginning") from None
        values = status.values
        if chained:
            values = values[1:]
            before -= 1
        # Two commands were carried out before the counter was read: XQ, and MG of the program.
        went_on = self.samples.take_whole(
            self._earliest_ns(self._earliest_ns(status.sent_ns)), status.received_ns, values[0]
        )
        words = values[1:before]
        inputs = _joined(words[: self._inputs], smc2000_program.INPUTS_OF_WORD)
        outputs = _joined(words[self._inputs :], smc2000_program.OUTPUTS_OF_WORD)
        return Record(
            sample=values[0],
            inputs=inputs,
            outputs=outputs,
            program_runs=False,
            axes=self._axis_records(values[0], values[before:]),
            sent_ns=status.sent_ns,
            received_ns=status.heard_ns,
        ), went_on

    def _axis_records(self, ticks: int, values: Sequence[int]) -> tuple[AxisRecord, ...]:
        records = [_NOTHING] * (self._axes[-1] + 1)
        before, positions = self._before, dict[int, int]()
        for number, index in enumerate(self._axes):
            commanded, error, byte, code = values[AXIS_VALUES * number : AXIS_VALUES * (number + 1)]
            positions[index] = commanded - error
            # TV would average over a quarter of a second (L12193), and be printed, too.
            velocity = 0.0
            if before is not None and ticks > before[0]:
                way = positions[index] - before[1][index]
                velocity = way / ((ticks - before[0]) * self.samples.tick_ns) * NS_PER_S
            records[index] = AxisRecord(
                status=_status(byte, code),
                switches=byte & SWITCHES,
                stop_code=code,
                commanded=commanded,
                actual=positions[index],
                error=error,
                auxiliary=0,
                velocity=round(velocity * VELOCITY_SCALE),
                torque=0,
            )
        self._before = (ticks, positions)
        return tuple(records)

    # Stopping

    async def stop_first(self) -> bool:
        """Stop it before it is connected, over the line that others have open perhaps. False: it is alone on its."""
        if self._unit is None:
            return False
        link = await self._line.attach(self._unit, self._open_link)
        try:
            self._line.shout(link, self._unit, stop_commands(False), unknown=True)
            await sleep_ns(self._clock, STOP_LEAVES_NS)
        finally:
            await self._line.detach(self._unit)
        return True

    def stop(self, abort: bool) -> None:
        self._count_stop()
        self._write_past(*stop_commands(abort))

    def _write_past(self, *commands: str) -> None:
        self.session.shout(*commands)


def stop_commands(abort: bool) -> tuple[str, ...]:
    """What stops all axes and keeps the waiting program from starting any.

    ST without letters stops all motion, and programs too (L11610-11613); HX halts all threads whether it does or not
    (L9205). AB stops motion at once, and programs (L6768). A contour that has not begun yet is left by its own command;
    one that plays ends with its present record (SC 51, L11427-11493).
    """
    return (*(("AB", "HX") if abort else ("ST", "HX", "ST")), *LEAVE_CONTOUR, RELEASE)


_NOTHING = AxisRecord(0, 0, 0, 0, 0, 0, 0, 0, 0)


def _joined(words: Iterable[int], size: int) -> int:
    return sum(word << size * number for number, word in enumerate(words))


def _status(byte: int, code: int) -> int:
    """The switch byte (TS) and the stop code in the terms of the SMC-4000's record."""
    moving = bool(byte & TS_MOVING)
    return (
        (MOVING if moving else 0)
        | (STOPPING if moving and code in STOPPING_CODES else 0)
        | (MOTOR_OFF if byte & TS_MOTOR_OFF else 0)
        | (OFF_ON_ERROR if byte & TS_MOTOR_OFF and code == 8 else 0)
    )
