"""The controller on its two handles: connection, identification, installation of its resident program, and polls of one
record."""

from collections.abc import Iterable, Sequence
from contextlib import AbstractAsyncContextManager, nullcontext, suppress
from dataclasses import dataclass, replace

from adapters.contract import NULL_LOG, ControllerIdentity, ControllerRestarted
from adapters.yaskawa.common.gate import GateTiming
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import (
    EDGE_THREAD,
    OUTPUT_PASSIVE,
    STEP_THREADS,
    WATCHDOG_THREAD,
    program_lines,
)
from adapters.yaskawa.common.resident import ResidentProgram
from adapters.yaskawa.common.stop_counts import StopCounts
from adapters.yaskawa.common.ticks import SampleClock
from adapters.yaskawa.language.numbers import parse_numbers
from adapters.yaskawa.shapes.model import LEAVE_CONTOUR
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.handles import HandleCleaner
from adapters.yaskawa.wire.record import AXIS_LETTERS, DataRecord, RecordFormat
from adapters.yaskawa.wire.session import CommandSession, print_command, session_tag
from adapters.yaskawa.wire.stops import SharedStops, StopHandle
from orchestrator.clock.base import NS_PER_US, Clock
from orchestrator.link.base import Link, LinkClosed, OpenLink


@dataclass(frozen=True, slots=True)
class SmcConnection:
    """The handles of one connection: for commands and polls, and for stops."""

    link: Link
    session: CommandSession
    stops: StopHandle | SharedStops


@dataclass(frozen=True, slots=True)
class HandleTraits:
    """The handles that a link allows.

    goodbye: bytes that free a handle where the controller cannot detect that its client is gone.
    shared: there is only one port, to which no second connection is possible."""

    goodbye: bytes = b""
    shared: bool = False


SEPARATE_HANDLES = HandleTraits()


class SmcDevice:
    """One controller. Its commands and polls share one handle; stops have a second handle where two are possible."""

    BESIDE = 0
    """Commands of other threads that may interrupt a check of its release gate (see `GateTiming`)."""
    SINGLE = 0
    """Further commands before a step that follows another one, because conditions cannot be combined."""
    STEP_THREADS: tuple[int, int] = STEP_THREADS
    """The threads of a step, and of one that follows it."""

    def __init__(
        self,
        clock: Clock,
        open_link: OpenLink,
        options: YaskawaOptions,
        axes_needed: int,
        handles: HandleTraits = SEPARATE_HANDLES,
    ) -> None:
        self.log = NULL_LOG
        self._clock = clock
        self._traits = handles
        self._open_link = open_link
        self._options = options
        self._axes_needed = axes_needed
        self._connection: SmcConnection | None = None
        self._format: RecordFormat | None = None
        self.resident = ResidentProgram(options, self.STEP_THREADS)
        self.gate = GateTiming.for_options(options, self.BESIDE, self.SINGLE)
        # It outlives the links: only then a power cycle differs from a broken cable.
        self.samples = SampleClock(options.tick_ns, (options.decode_us - options.decode_min_us) * NS_PER_US)
        self._restarted = False
        self._handles = HandleCleaner()
        self._reconnect_required = False
        self.stop_counts = StopCounts(clock)

    @property
    def sharing_count(self) -> int:
        """Return how many controllers take turns on its line."""
        return 1

    # Connection

    async def connect(self) -> ControllerIdentity:
        """Open both handles, unload what an earlier adapter process left waiting, and install the program."""
        await self.close()
        self._reconnect_required = False
        link = await self._open_link()
        self.log.info("link opened", place=link.endpoint)
        session = CommandSession(link, self._options.timeout_s, session_tag(self._clock.now_ns()))
        session.log = self.log
        # Until there is a second handle, the one port carries stops too, bypassing other traffic.
        connection = self._connection = SmcConnection(link, session, SharedStops(session))
        if self._traits.shared:
            await session.send_command("EO 0")  # it may echo (L4833)
        else:
            self._handles.log = self.log
            await self._handles.close_stale_handles(session)
            stops = StopHandle(await self._open_link(), self._options.timeout_s)
            self._connection = replace(connection, stops=stops)
            await self._handles.note_second_handle(session)
        # Messages of programs go to the serial port, not between the replies (L3556).
        await session.send_command("CFS")
        revision = await session.read_revision()
        self._format = await self._find_format(session, revision)
        self._format.require_axes(self._axes_needed)
        return await self._load_and_identify(revision)

    async def _find_format(self, session: CommandSession, revision: str) -> RecordFormat:
        """Return the layout of the record. Raises `ControllerFault` for a controller that is not of this model."""
        del revision
        return RecordFormat.from_sizes((await session.query_lines("QZ")).lines[0])

    def _make_program(self) -> tuple[str, ...]:
        """Return the lines of the resident program."""
        return program_lines(self.record_format.axes, self.gate)

    async def _load_and_identify(self, revision: str) -> ControllerIdentity:
        """Install the program and read the sample counter. revision: the reply to the query of the revision."""
        await self.install_program()
        (serial,), _ = await self.session.read_numbers("_BN")
        await self._read_time()
        model, _, firmware = revision.partition(" ")
        return ControllerIdentity(model=model, firmware=firmware or revision, serial=str(int(serial)))

    async def close(self) -> None:
        """Close both handles; the controller stays as it is."""
        old_connection, self._connection = self._connection, None
        if old_connection is not None:
            await old_connection.stops.close(self._traits.goodbye)
            await self._close_handle(old_connection.link)

    async def _close_handle(self, link: Link) -> None:
        if self._traits.goodbye:
            with suppress(LinkClosed):
                link.write(self._traits.goodbye)
        await link.close()

    async def install_program(self) -> None:
        """Install the resident program if the controller does not have it. Raises `ControllerFault`."""
        await self.resident.install(self.session, self._make_program(), self.record_format.axes)

    async def unload_program(self) -> None:
        """Halt the resident program and leave contour mode: nothing starts, now or later."""
        await self.resident.unload(self.session)

    async def list_program_lines(self, first: int, last: int) -> list[str]:
        """Return lines of the program by their numbers (LS, L7093), as far as it has them."""
        return await self.resident.list_lines(self.session, first, last)

    # Communication

    @property
    def connection(self) -> SmcConnection:
        """The connection. Raises `LinkClosed` when there is none."""
        if self._connection is None:
            raise LinkClosed("the controller is not connected")
        return self._connection

    @property
    def session(self) -> CommandSession:
        """The handle for commands. Raises `LinkClosed` when there is none."""
        return self.connection.session

    @property
    def record_format(self) -> RecordFormat:
        """Return the layout of the record, known since `connect`."""
        if self._format is None:
            raise LinkClosed("the controller is not connected")
        return self._format

    @property
    def axes_count(self) -> int:
        """The number of axes of the controller; 0 until it was connected once."""
        return 0 if self._format is None else self._format.axes

    @property
    def program_axes(self) -> Sequence[int]:
        """The axes that its resident program serves, by index."""
        return range(self.record_format.axes)

    async def read_record(self) -> DataRecord:
        """Return the whole changing state in one exchange; it also updates the clock estimate."""
        return (await self._read_record())[0]

    async def read_record_with(self, *operands: str) -> tuple[DataRecord, list[float]]:
        """Return a record, and values as `Session.read_numbers` returns them, in one exchange where possible."""
        message = print_command(operands)
        record, _, lines = await self._read_record(message)
        return record, parse_numbers("".join(lines[-1:]), len(operands), message)

    async def _read_record(self, also: str = "") -> tuple[DataRecord, bool, list[str]]:
        """Return a record, whether its sample number continued from the last reading, and the lines that answer
        `also`."""
        layout = self.record_format
        answer = await self.session.query_record(layout.command, layout.header, layout.length, also)
        record = layout.parse_record(answer.record, answer.sent_ns, answer.received_ns)
        went_on = self.samples.add_low_reading(self._earliest_ns(record.sent_ns), record.received_ns, record.sample)
        return record, went_on, answer.lines

    async def poll_state(self) -> tuple[DataRecord, bool]:
        """Return a record that also updates the clock estimate, and whether the controller was restarted since the last
        one."""
        if not self.connection.stops.open:
            raise LinkClosed("the controller has closed the handle for stops")
        if self._reconnect_required:
            # It lost its settings and possibly its program with its counter: begin again from `connect`.
            raise ControllerRestarted()
        record, went_on, _ = await self._read_record()
        if not went_on:
            self._reconnect_required = not await self._read_time()
            self.log.warning("the sample counter was interrupted", restarted=self._reconnect_required)
        is_restarted, self._restarted = self._restarted, False
        return record, is_restarted

    async def _read_time(self) -> bool:
        """Read the whole counter. Return False when the controller was restarted since the last reading."""
        (ticks,), answer = await self.session.read_numbers("TIME")
        went_on = self.samples.add_full_reading(self._earliest_ns(answer.sent_ns), answer.received_ns, int(ticks))
        self._restarted |= not went_on
        return went_on

    def _earliest_ns(self, sent_ns: int) -> int:
        """Return the earliest instant at which a command sent at `sent_ns` can have read the counter."""
        return sent_ns + self._options.decode_min_us * NS_PER_US

    # Begin and stop of motion

    def exclusive_turn(self) -> AbstractAsyncContextManager[None]:
        """Return a context in which exchanges of this task are not interleaved with others on a shared link."""
        return nullcontext()

    async def wait_for_stops(self) -> None:
        """Wait until no stop is under way: it would halt a motion that begins now. Raises `ControllerFault`,
        `LinkClosed`."""
        await self.connection.stops.wait_until_executed()

    async def begin_motion(self, axis: str, index: int, since: int) -> None:
        """Begin what is loaded for one axis (BG, L3064), unless a stop has come since `stop_count` returned `since`.

        Commands of two handles may overtake each other in the controller, so a stop that came while BG was under way is
        repeated after it. Raises `Refusal`; then the axis is at rest, or stops.
        """
        await self.wait_for_stops()
        is_sent = False

        def check_no_stop() -> None:
            nonlocal is_sent
            self.stop_counts.require_no_stop(axis, index, since)
            is_sent = True

        try:
            await self.session.send_command(f"BG{AXIS_LETTERS[index]}", check_no_stop)
            self.stop_counts.require_no_stop(axis, index, since)
        except SmcCommandRefused:
            raise
        except BaseException:
            # Cancelled, unanswered, or stopped meanwhile: no caller would stop the axis later.
            self.log.warning(f"the begin of axis {axis} did not succeed", stopped=is_sent)
            if is_sent:
                with suppress(LinkClosed):
                    self.brake_axes([index])
            raise

    def stop_axes(self, indices: Iterable[int]) -> None:
        """Stop these axes by their ramps, now, without waiting for any reply; no command under way begins them."""
        axis_indices = list(indices)
        for index in axis_indices:
            self.stop_counts.count_axis(index)
        self.brake_axes(axis_indices)

    def brake_axes(self, indices: Iterable[int], *halts: str) -> None:
        """Send `ST` to these axes, now; other axes and programs continue (L10124), but for those that `halts` end."""
        letters = "".join(AXIS_LETTERS[index] for index in indices)
        if letters:  # without letters it would stop all axes
            self.write_stop(*halts, f"ST{letters}")

    def stop_all(self, *, abort: bool) -> None:
        """Stop everything, now, without waiting for any reply."""
        self.stop_counts.count_all()
        self.write_stop(*stop_commands(abort=abort))

    def write_stop(self, *commands: str) -> None:
        """Write to the handle for stops, bypassing everything that is under way on the other handle."""
        try:
            self.connection.stops.write_stop(*commands)
        except LinkClosed:
            # The loss of this handle is not noticed elsewhere yet; the other handle may still work.
            self.log.warning("the handle for stops is closed; the stop is written to the handle for commands")
            self.session.write_at_once(*commands)


def stop_commands(*, abort: bool) -> tuple[str, ...]:
    """Return the commands that stop all axes, prevent the waiting program from starting any, and leave contour mode.

    Motion first, then the program, and motion again: the program may have begun a motion in between. ST without letters
    stops all axes and sequences (L10119) and may halt programs too; AB aborts motion and program at once (L2191).
    """
    steps = tuple(f"HX{thread}" for thread in STEP_THREADS)
    last_commands = (f"HX{WATCHDOG_THREAD}", *LEAVE_CONTOUR, f"HX{EDGE_THREAD}", OUTPUT_PASSIVE)
    if abort:
        return ("AB", *steps, *last_commands)
    return ("ST", *steps, "ST", *last_commands)
