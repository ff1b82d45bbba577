"""A start at a sample: loaded, let through the gate, watched, and known by the program's own evidence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from adapters.contract import CannotDo, DriverFault, Outcome, Span
from adapters.yaskawa.common import arrays
from adapters.yaskawa.common.lowering import AxisMove, LoweredMoves, Records, fields
from adapters.yaskawa.common.options import Options
from adapters.yaskawa.common.program import (
    DOG_THREAD,
    EDGE_THREAD,
    STEP_THREAD,
    entry,
)
from adapters.yaskawa.common.record import AXIS_LETTERS, Record
from adapters.yaskawa.common.words import stop_words
from adapters.yaskawa.smc4000.device import Device
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns, sleep_until_ns
from orchestrator.clock.estimator import TickMapping

TICKS_MAX = 2_147_483_647  # L10613
EVIDENCE_WAIT_NS = 200 * NS_PER_MS  # a start is proven or disproven so long after its instant
WATCH_NS = 100 * NS_PER_MS
FED_IN_TIME = 3  # controllers on one line of 19,200 baud that can be fed within half of the watchdog's time
SETTLE_NS = 5 * NS_PER_MS


@dataclass(slots=True)
class _Loaded:
    """What is loaded. ticks: XT0. started: by axis, once known."""

    lowered: LoweredMoves
    ticks: int
    t0_ns: int
    mapping: TickMapping
    started: dict[str, Span]


class Start:
    """The one move that the resident program can hold."""

    LATE_TICKS = 4
    """Of a contour's stamps: from the last record to its stamp there are two commands."""

    def __init__(self, device: Device, clock: Clock, options: Options) -> None:
        self._device = device
        self._clock = clock
        self._options = options
        self._loaded: _Loaded | None = None

    # Before T0

    async def arm(self, lowered: LoweredMoves, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        """Load the registers, read them back, and send the program to its gate, where `verify` looks for it.

        All of that is told without waiting for the answers: whatever they are, the program goes no further.
        """
        if mapping is None:
            raise CannotDo("no-clock", "the controller's clock is not known yet", "wait a second")
        began_ns = self._clock.now_ns()
        first, _ = self._options.begin_ticks(mapping.tick_ns, beside=True)
        ticks = round(mapping.ticks(t0_ns)) - first
        if ticks > TICKS_MAX:
            raise CannotDo("counter-full", "the sample counter ends before the start", "restart the controller")
        if mapping.ticks(began_ns) > ticks - self._device.gate.release:
            raise CannotDo("late", "T0 is too near to arm", "give more lead time")
        loaded = _Loaded(lowered, ticks, t0_ns, mapping, {})
        await self._device.stops_carried_out()
        self._require_ready(await self._device.record(), lowered)
        session, drives = self._device.session, lowered.drives
        checked_ns = self._clock.now_ns()
        # The sample of the begin lies beside T0 by a part of one.
        phase = ticks + first - mapping.ticks(t0_ns)
        # An earlier step's dog would bite at this one's beginning, and a second one can not be begun (L10305).
        shut = ("XGO=0", "XARM=0", "XOK=0", "XLATE=0", f"HX{DOG_THREAD}")
        gate = (*shut, f"XT0={ticks}", f"XLI={_line(lowered)}", self._food(ticks))
        if isinstance(lowered.load, Records):
            await arrays.load(session, lowered.load.arrays(phase, mapping.tick_ns), lowered.load.packets)
        self._loaded = loaded
        await self._load(lowered, gate, f"XQ {entry(lowered.mask, isinstance(lowered.load, Records))},{STEP_THREAD}")
        if drives is not None:
            await session.tell_all((f"XLO={drives.number}", f"XLV={drives.level}", f"XLH={drives.hold_ticks}"))
            await session.tell(f"XQ #EDGE,{EDGE_THREAD}")
        return {"check": checked_ns - began_ns, "wire": self._clock.now_ns() - checked_ns}

    async def _load(self, lowered: LoweredMoves, gate: Sequence[str], then: str) -> None:
        """Load the move, and with it what `gate` sets, ask for what was loaded, and tell `then` behind it. Raises
        `CannotDo` if it is something else."""
        load = lowered.load
        commands = load.commands
        if isinstance(load, Records):
            commands = (f"DC {fields(load.brakes)}", *(f"{name}={value}" for name, value in load.variables.items()))
        wanted = {
            f"_{command}{AXIS_LETTERS[index]}": value
            for command, values in self._registers(lowered).items()
            for index, value in values.items()
        }
        if isinstance(load, Records):
            wanted |= load.variables
        wanted["XLI"] = _line(lowered)
        held = await self._device.session.tell_and_read((*gate, *commands), list(wanted), then)
        for (operand, value), found in zip(wanted.items(), held, strict=True):
            if found != value:
                raise CannotDo("read-back", f"{operand} reads back as {found:.0f}, not {value}", "try again")

    def _registers(self, lowered: LoweredMoves) -> Mapping[str, Mapping[int, int]]:
        """What is read back, by command and axis."""
        return lowered.load.held

    def _food(self, ticks: int) -> str:
        """What keeps the dog quiet until some time after sample `ticks`."""
        # On a line of many, one of its turns comes after those of all the others.
        patience_s = self._options.watchdog_s * max(1.0, self._device.sharing / FED_IN_TIME)
        patience = round(patience_s * NS_PER_S / self._device.samples.tick_ns)
        return f"XDL={min(ticks + patience, TICKS_MAX)}"

    def _require_ready(self, record: Record, lowered: LoweredMoves) -> None:
        if lowered.waits is not None:
            lowered.waits.require_passive(record.inputs)
        if lowered.drives is not None:
            lowered.drives.require_passive(record.outputs)
        for move in lowered.moves:
            axis = record.axes[move.index]
            if axis.moving:
                raise CannotDo("moving", f"axis {move.axis} is moving", "wait, or stop it")
            if not axis.enabled:
                raise CannotDo("not-enabled", f"axis {move.axis} is not enabled", f"enable {move.axis} first")
            if axis.commanded != move.start:
                raise CannotDo(
                    "other-start",
                    f"axis {move.axis} stands at {axis.commanded} counts; the plan starts at {move.start}",
                    "plan again from where it stands",
                )

    async def verify(self) -> None:
        """Just before the promise: until the program waits at its gate."""
        loaded, asked = self._require_loaded(), ("XARM", f"_HX{STEP_THREAD}", "XLATE")
        record, (armed, running, late) = await self._device.record_and(*asked)
        self._require_ready(record, loaded.lowered)
        while True:
            # The program ends by itself, too, when it comes to its gate after that was to be shut.
            if late or self._clock.now_ns() > loaded.t0_ns:
                raise CannotDo("late", "the gate is shut already", "give more lead time")
            if not running:
                raise CannotDo("not-armed", "the controller does not wait for this start any more", "arm again")
            if armed:
                break
            (armed, running, late), _ = await self._device.session.numbers(*asked)
        if int(armed) != loaded.ticks:
            raise CannotDo("not-armed", "the controller waits for another start", "arm again")

    async def go(self, sooner_ns: int) -> None:
        """Open the gate, and see that the program went through. The gate and the wait behind it look at XT0 anew each
        time: a sooner one is told in front of the release."""
        loaded, session = self._require_loaded(), self._device.session
        told, asked = ["XGO=1"], ["XOK", "XLATE", f"_HX{STEP_THREAD}"]
        if sooner_ns:
            loaded.ticks -= round(sooner_ns / loaded.mapping.tick_ns)
            loaded.t0_ns -= sooner_ns
            told = [f"XT0={loaded.ticks}", self._food(loaded.ticks), *told]
            asked.append("XT0")
        if loaded.mapping.ticks(self._clock.now_ns()) > loaded.ticks - self._device.gate.release:
            raise CannotDo("late", "it is too late to release the start", "give more lead time")
        opened_ns = await session.tell_all(told)
        await sleep_until_ns(self._clock, opened_ns + round(self._device.gate.soon * loaded.mapping.tick_ns))
        while True:
            (passed, late, running, *ticks), _ = await session.numbers(*asked)
            if ticks and ticks[0] != loaded.ticks:
                raise CannotDo("read-back", f"XT0 reads back as {ticks[0]:.0f}, not {loaded.ticks}", "try again")
            if late:
                raise CannotDo("late", "the gate was shut before the release came", "give more lead time")
            if not running:
                raise CannotDo("not-armed", "the controller does not wait for this start any more", "arm again")
            if passed:
                return
            await sleep_ns(self._clock, round(self._device.gate.seen * loaded.mapping.tick_ns / 4))

    async def disarm(self) -> None:
        """Nothing starts from the program, now or later."""
        self._loaded = None
        session = self._device.session
        await self._device.unload()
        await session.tell("XGO=0")
        (running,), _ = await session.numbers(f"_HX{STEP_THREAD}")
        if running:
            raise DriverFault("not-halted", "the waiting program does not halt", "reset the controller")

    def forget(self) -> None:
        """What was loaded is not, any more."""
        self._loaded = None

    def _require_loaded(self) -> _Loaded:
        if self._loaded is None:
            raise CannotDo("not-armed", "nothing is loaded", "arm it")
        return self._loaded

    # After T0

    async def started(self) -> Mapping[str, Span]:
        """When the axes began.

        BG took effect before XACT was read and after XT0 had come, and the command between the two takes less than
        a sample: so it was in sample XACT or the one before it, and the profile's origin is a sample from the one that
        BG fell into to the one after it. Hence from XACT - 1, and not before XT0, to XACT + 1; each edge as far off
        as the clock mapping may be. Behind a line, XT0 has no part in it.
        """
        loaded = self._require_loaded()
        mapping, waits = loaded.mapping, loaded.lowered.waits
        _, last = self._options.begin_ticks(mapping.tick_ns, beside=True)
        late_ns = sum(term.latest_ns for term in loaded.lowered.terms)
        await sleep_until_ns(self._clock, mapping.host_ns(loaded.ticks + last + 1) + mapping.bound_at_ns(loaded.t0_ns))
        while True:
            (acted, late, running), _ = await self._device.session.numbers("XACT", "XLATE", f"_HX{STEP_THREAD}")
            if late:
                raise DriverFault("late", "the gate was shut before the release came; nothing started", "try again")
            if acted:
                break
            if not running or self._clock.now_ns() > loaded.t0_ns + late_ns + EVIDENCE_WAIT_NS:
                words = (await self._device.session.ask("TC1")).lines[0]
                raise DriverFault("not-started", f"the controller did not start; its last error: {words}", "try again")
            await sleep_ns(self._clock, SETTLE_NS)
        bound_ns = mapping.bound_at_ns(loaded.t0_ns)
        not_before = int(acted) - 1 if waits is not None else max(int(acted) - 1, loaded.ticks)
        span = Span(mapping.host_ns(not_before) - bound_ns, mapping.host_ns(int(acted) + 1) + bound_ns)
        loaded.started = dict.fromkeys((move.axis for move in loaded.lowered.moves), span)
        return loaded.started

    async def outcome(self) -> Outcome:
        """Watch until no axis of the step moves, then say how it ended."""
        loaded = self._require_loaded()
        moves = loaded.lowered.moves
        seen_ns = {move.axis: loaded.started[move.axis].earliest_ns for move in moves}
        ended: dict[str, Span] = {}
        planned_ns = {axis: loaded.t0_ns + round(s * 1e9) for axis, s in loaded.lowered.durations_s.items()}
        stopped = False
        while True:
            record = await self._device.record()
            for move in moves:
                if record.axes[move.index].moving:
                    seen_ns[move.axis] = record.sent_ns
                elif move.axis not in ended:
                    ended[move.axis] = Span(seen_ns[move.axis], record.received_ns)
            if len(ended) == len(moves):
                break
            ticks = round((self._device.samples.mapping() or loaded.mapping).ticks(record.received_ns))
            await self._device.session.tell(self._food(ticks))
            # Look again soon after the next planned end: the stamps tell the last end only.
            left_ns = min(planned_ns[axis] for axis in seen_ns if axis not in ended) + SETTLE_NS - self._clock.now_ns()
            watch_ns = min(WATCH_NS, left_ns) if left_ns > 0 and not stopped else SETTLE_NS
            stopped = await self._device.sleep_to_stop(watch_ns) or stopped
        reasons = {move.axis: self._reason(move, record) for move in moves}
        states = {state for state, _ in reasons.values()}
        if states <= {"done"}:
            late = await self._refine(loaded, ended)
            return Outcome("fault", ended, late) if late else Outcome("done", ended)
        text = "; ".join(f"axis {axis} {words}" for axis, (state, words) in reasons.items() if state != "done")
        (bitten,), _ = await self._device.session.numbers("XDOG")
        if bitten:
            text += "; by its own watchdog: it had not heard of its adapter, or its program had failed"
        return Outcome("fault" if "fault" in states else "stopped", ended, text)

    def _reason(self, move: AxisMove, record: Record) -> tuple[str, str]:
        if not move.samples:
            return "done", ""
        axis = record.axes[move.index]
        code = stop_words(axis.stop_code)
        if code.state == "done" and axis.commanded != move.end:
            return "fault", f"stands at {axis.commanded} counts, not at {move.end}"
        return code.state, code.text

    async def _refine(self, loaded: _Loaded, ended: dict[str, Span]) -> str:
        """Narrow the ends by the program's own stamps; says if a contour was fed too slowly.

        XEn is read after AM of axis n, or WC behind a contour's last record, has let go: the axis had ended by then,
        but it may have ended long before, if the program came to the wait late. It can not have ended before its
        profile was through, counted from its start. Axes that end within a contour read as moving until all of it is
        over, but ended as much earlier as their records are fewer.
        """
        way, load = loaded.lowered.way, loaded.lowered.load
        contour = load.contour if isinstance(load, Records) else None
        # A contour has one stamp for all its axes. The line for all of them would be too long (L12254).
        names = [f"XE{move.index + 1}" for move in way]
        asked = names if contour is None else [names[0], "XACT"]
        until_ns = self._clock.now_ns() + EVIDENCE_WAIT_NS
        while True:
            (done, *values), _ = await self._device.session.numbers("XDONE", *asked)
            if done:
                break
            if self._clock.now_ns() > until_ns:
                return ""
            # The axes are through, the program's last lines not yet.
            await sleep_ns(self._clock, SETTLE_NS)
        mapping = self._device.samples.mapping() or loaded.mapping
        total = 0 if contour is None else contour.instants[-1]
        for move in loaded.lowered.moves:
            if not move.samples:
                ended[move.axis] = loaded.started[move.axis]
        for place, move in enumerate(way):
            start, seen = loaded.started[move.axis], ended[move.axis]
            not_before_ns = start.earliest_ns + round((move.samples - 1) * mapping.tick_ns)
            if contour is None:
                by_ns = mapping.host_ns(int(values[place]) + 1)
                not_before_ns = max(seen.earliest_ns, not_before_ns)
            else:
                by_ns = mapping.host_ns(int(values[0]) + 1 - total + move.samples)
            ended[move.axis] = Span(not_before_ns, min(seen.latest_ns, by_ns + mapping.bound_at_ns(by_ns)))
        late = 0 if contour is None else int(values[0] - values[1]) - total
        if late > self.LATE_TICKS:
            return (
                f"the contour ended {late} samples late: its records came too slowly; raise the controller's option "
                "decode_us to what a command of its programs really takes"
            )
        return ""


def _line(lowered: LoweredMoves) -> int:
    """The input to begin by, 0 for none."""
    return 0 if lowered.waits is None else lowered.waits.number
