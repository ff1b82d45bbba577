"""The controller behind its two handles: reached, identified, given its resident program, read in one record."""

import asyncio
from collections.abc import Iterable
from contextlib import AbstractAsyncContextManager, nullcontext, suppress

from adapters.contract import CannotDo, DriverFault, Identity, Restarted
from adapters.yaskawa.common import arrays
from adapters.yaskawa.common.gate import Gate
from adapters.yaskawa.common.model import LEAVE_CONTOUR
from adapters.yaskawa.common.options import Options
from adapters.yaskawa.common.program import DOG_THREAD, EDGE_THREAD, RELEASE, STEP_THREAD, VARIABLES, letters, program
from adapters.yaskawa.common.record import AXIS_LETTERS, Record, RecordFormat
from adapters.yaskawa.common.stops import SharedStops, StopHandle
from adapters.yaskawa.common.ticks import SampleClock
from adapters.yaskawa.smc4000.session import REVISION, Refused, Session, message, parse_numbers
from orchestrator.clock.base import NS_PER_US, Clock, sleep_ns
from orchestrator.link.base import Link, LinkClosed, OpenLink

THREADS = 8  # L12258
CONTOURING = 1 << 5  # of TB (L10224)


class Device:
    """One controller. Its commands and polls share one handle; stops have one of their own, where there can be two."""

    BESIDE = 0
    """Commands that may come into a look at its gate (see `Gate`)."""

    def __init__(
        self,
        clock: Clock,
        open_link: OpenLink,
        options: Options,
        axes_needed: int,
        goodbye: bytes = b"",
        shared: bool = False,
    ) -> None:
        """goodbye: what frees a handle where the controller can not see that its client has gone. shared: there is one
        port only, which no second connection can be made to."""
        self._clock = clock
        self._shared = shared
        self._goodbye = goodbye
        self._open_link = open_link
        self._options = options
        self._axes_needed = axes_needed
        self._session: Session | None = None
        self._stops: StopHandle | SharedStops | None = None
        self._format: RecordFormat | None = None
        self._close_link = lambda: asyncio.sleep(0)
        self.gate = Gate.of(options, self.BESIDE)
        # It outlives the links: only so can a power cycle be told from a broken cable.
        late_ns = (options.decode_us - options.decode_min_us) * NS_PER_US
        self.samples = SampleClock(options.tick_ns, late_ns)
        self._restarted = False
        self._must_reconnect = False
        # How many stops each axis has been given: what was on its way when one came must not begin a motion after it.
        self._stops_given = [0] * len(AXIS_LETTERS)
        self._stop_given = asyncio.Event()

    @property
    def sharing(self) -> int:
        """How many controllers take turns on its line."""
        return 1

    # Reaching it

    async def connect(self) -> Identity:
        """Open both handles, unload what an earlier client of ours left waiting, and install the program."""
        await self.close()
        self._must_reconnect = False
        link = await self._open_link()
        self._close_link = lambda: self._leave(link)
        session = self._session = Session(link, self._options.timeout_s)
        if self._shared:
            # The one port carries stops too, past whatever is under way on it; and it may echo (L4833).
            self._stops = SharedStops(session)
            await session.tell("EO 0")
        else:
            self._stops = StopHandle(await self._open_link(), self._options.timeout_s)
        # Messages of programs go to the serial port, not between our replies (L3556).
        await session.tell("CFS")
        revision = " ".join(await session.ask_all(REVISION))
        self._format = RecordFormat.from_sizes((await session.ask("QZ")).lines[0])
        if self._format.axes < self._axes_needed:
            raise DriverFault(
                "config-mismatch",
                f"the fleet file uses motor {AXIS_LETTERS[self._axes_needed - 1]}; the controller has "
                f"{self._format.axes} axes",
                "correct `motors` in the fleet file, or the address of the controller",
            )
        await self._install_program()
        (serial,), _ = await session.numbers("_BN")
        await self._read_time()
        model, _, firmware = revision.partition(" ")
        return Identity(model=model, firmware=firmware or revision, serial=str(int(serial)))

    async def close(self) -> None:
        """Close both handles, and leave the controller as it is."""
        session, self._session = self._session, None
        stops, self._stops = self._stops, None
        if stops is not None:
            await stops.close(self._goodbye)
        if session is not None:
            await self._close_link()

    async def _leave(self, link: Link) -> None:
        if self._goodbye:
            with suppress(LinkClosed):
                link.write(self._goodbye)
        await link.close()

    async def _install_program(self) -> None:
        session, wanted = self.session, program(self.format.axes, self.gate)
        present = [line.rstrip() for line in await session.ask_all("UL")]
        if present == list(wanted):
            # Ours may still wait for a start that nobody will release any more, or play a contour to its end.
            (status,), _ = await session.numbers("_TB")
            if int(status) & CONTOURING:
                # Without its program a contour would stop dead (L13968): by its ramps, then.
                await session.tell(f"ST{letters((1 << self.format.axes) - 1)}")
            await self.unload()
        else:
            await self._require_replaceable(present)
            try:
                await session.download(wanted)
            except Refused as refusal:
                raise DriverFault(
                    "program-refused",
                    f"the controller does not take its program: {refusal}",
                    "is its program memory locked (LC), or another port of it downloading?",
                ) from None
            if [line.rstrip() for line in await session.ask_all("UL")] != list(wanted):
                raise DriverFault(
                    "program-differs", "the program read back is not the one sent", "check the link; try again"
                )
        for name in VARIABLES:
            await session.tell(f"{name}=0")
        await arrays.free(session)

    async def unload(self) -> None:
        """Halt our program and leave contour mode: nothing starts, now or later."""
        threads = (STEP_THREAD, DOG_THREAD, EDGE_THREAD)
        # Outside contour mode there is nothing to leave, without a line none to release: the controller says so.
        with suppress(Refused):
            await self.session.tell_all((*(f"HX{thread}" for thread in threads), *LEAVE_CONTOUR, RELEASE))

    async def _require_replaceable(self, present: list[str]) -> None:
        running, _ = await self.session.numbers(*(f"_HX{thread}" for thread in range(4)))
        more, _ = await self.session.numbers(*(f"_HX{thread}" for thread in range(4, THREADS)))
        threads = [str(thread) for thread, state in enumerate(running + more) if state]
        if threads:
            raise DriverFault(
                "other-program",
                f"another program runs in the controller (thread {', '.join(threads)})",
                "stop it with HX, and its #AUTO start with it, if this controller belongs to the fleet",
            )
        if present and not self._options.replace_program:
            raise DriverFault(
                "other-program",
                f"the controller holds another program of {len(present)} lines, and may not be given ours",
                "save it, then set `replace_program: true` in the controller's options",
            )

    # Talking

    @property
    def session(self) -> Session:
        """The handle for commands. Raises `LinkClosed` when there is none."""
        if self._session is None:
            raise LinkClosed("the controller is not connected")
        return self._session

    @property
    def format(self) -> RecordFormat:
        """The layout of the record, known since `connect`."""
        if self._format is None:
            raise LinkClosed("the controller is not connected")
        return self._format

    async def record(self) -> Record:
        """Everything that changes, in one exchange; feeds the clock."""
        record, _, _ = await self._read_record()
        return record

    async def record_and(self, *operands: str) -> tuple[Record, list[float]]:
        """A record, and values as `Session.numbers` reads them, in one exchange where that can be."""
        asked = message(operands)
        record, _, lines = await self._read_record(asked)
        return record, parse_numbers("".join(lines[-1:]), len(operands), asked)

    async def _read_record(self, also: str = "") -> tuple[Record, bool, list[str]]:
        """A record, whether its sample number went on from the last reading, and the lines that answer `also`."""
        layout = self.format
        answer = await self.session.ask_record(layout.command, layout.header, layout.length, also)
        record = layout.parse(answer.record, answer.sent_ns, answer.received_ns)
        went_on = self.samples.take_low(self._earliest_ns(record.sent_ns), record.received_ns, record.sample)
        return record, went_on, answer.lines

    async def poll(self) -> tuple[Record, bool]:
        """A record that also feeds the clock; and whether the controller was restarted since the last one."""
        if self._stops is None or not self._stops.open:
            raise LinkClosed("the controller has closed the handle for stops")
        if self._must_reconnect:
            # It lost its settings and maybe its program with its counter: begin again from `connect`.
            raise Restarted()
        record, went_on, _ = await self._read_record()
        if not went_on:
            self._must_reconnect = not await self._read_time()
        restarted, self._restarted = self._restarted, False
        return record, restarted

    async def _read_time(self) -> bool:
        """Read the whole counter. False when the controller was restarted since the last reading."""
        (ticks,), answer = await self.session.numbers("TIME")
        went_on = self.samples.take_whole(self._earliest_ns(answer.sent_ns), answer.received_ns, int(ticks))
        self._restarted |= not went_on
        return went_on

    def _earliest_ns(self, sent_ns: int) -> int:
        """The earliest instant at which a command sent at `sent_ns` can have read the counter."""
        return sent_ns + self._options.decode_min_us * NS_PER_US

    # Beginning and stopping motion

    def together(self) -> AbstractAsyncContextManager[None]:
        """Within it nothing comes between the exchanges of this task, where others share the link."""
        return nullcontext()

    def stops_given(self, index: int) -> int:
        """A number that every stop of this axis raises."""
        return self._stops_given[index]

    def require_no_stop(self, axis: str, index: int, since: int) -> None:
        """Raises `CannotDo` when a stop has come since `stops_given` was `since`."""
        if self._stops_given[index] != since:
            raise CannotDo("stopped", f"axis {axis} was stopped meanwhile", "")

    async def stops_carried_out(self) -> None:
        """Until no stop is under way: it would halt what begins now. Raises `DriverFault`, `LinkClosed`."""
        if self._stops is not None:
            await self._stops.carried_out()

    async def begin(self, axis: str, index: int, since: int) -> None:
        """Begin what is loaded for one axis (BG, L3064), unless a stop has come since `stops_given` was `since`.

        Commands of two handles may overtake each other in the controller, so a stop that came while BG was under way
        is given again behind it. Raises `CannotDo`; then the axis stands still, or stops.
        """
        await self.stops_carried_out()
        sent = False

        def still() -> None:
            nonlocal sent
            self.require_no_stop(axis, index, since)
            sent = True

        try:
            await self.session.tell(f"BG{AXIS_LETTERS[index]}", still)
            self.require_no_stop(axis, index, since)
        except Refused:
            raise
        except BaseException:
            # Cancelled, without an answer, or stopped meanwhile: nobody would stop it any more.
            if sent:
                with suppress(LinkClosed):
                    self.brake([index])
            raise

    def stop_axes(self, indices: Iterable[int]) -> None:
        """Stop these axes by their ramps, now, without waiting for any reply; nothing on its way begins them."""
        chosen = list(indices)
        for index in chosen:
            self._stops_given[index] += 1
        self.brake(chosen)

    def brake(self, indices: Iterable[int]) -> None:
        """`ST` to these axes, now; programs and other axes go on (L10124)."""
        letters = "".join(AXIS_LETTERS[index] for index in indices)
        if letters:  # without letters it would be all of them
            self._write_past(f"ST{letters}")

    def stop(self, abort: bool) -> None:
        """Stop everything, now, without waiting for any reply."""
        self._count_stop()
        self._write_past(*stop_commands(abort))

    def _count_stop(self) -> None:
        """All axes are stopped."""
        self._stops_given = [given + 1 for given in self._stops_given]
        self._stop_given.set()
        self._stop_given = asyncio.Event()

    async def sleep_to_stop(self, span_ns: int) -> bool:
        """Sleep for `span_ns`, or until all axes are stopped; whether they were."""
        given = self._stop_given
        sleeping = asyncio.ensure_future(sleep_ns(self._clock, span_ns))
        stopping = asyncio.ensure_future(given.wait())
        try:
            await asyncio.wait([sleeping, stopping], return_when=asyncio.FIRST_COMPLETED)
        finally:
            sleeping.cancel()
            stopping.cancel()
        return given.is_set()

    def _write_past(self, *commands: str) -> None:
        """By the handle for stops, past everything that is under way on the other one."""
        if self._stops is not None:
            try:
                self._stops.write(*commands)
                return
            except LinkClosed:
                # Its end is not yet noticed elsewhere. The other handle may still be there.
                pass
        self.session.shout(*commands)


def stop_commands(abort: bool) -> tuple[str, ...]:
    """What stops all axes, keeps the waiting program from starting any, and leaves contour mode.

    Motion first, then the program, and motion again: the program may have begun between the two. ST without letters
    stops all axes and sequences (L10119) and may halt programs too; AB aborts motion and program at once (L2191).
    """
    halt = (f"HX{STEP_THREAD}", f"HX{DOG_THREAD}")
    after = (*LEAVE_CONTOUR, f"HX{EDGE_THREAD}", RELEASE)
    if abort:
        return ("AB", *halt, *after)
    return ("ST", halt[0], "ST", halt[1], *after)
