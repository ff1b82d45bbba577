"""The driver's knowledge of the controller between two commands, and its status queries."""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

from adapters.ppsmc import fleetaxes
from adapters.ppsmc.batches import PpSmcLine
from adapters.ppsmc.replies import (
    ASK_ERRORS,
    ASK_POSITIONS,
    ASK_STATUS,
    StatusBits,
    leading_number,
    parse_entries,
    parse_errors,
    parse_states,
)
from adapters.ppsmc.session import PpSmcSession
from adapters.ppsmc.stopper import StopConnection
from adapters.toolkit.stop_counter import StopCounter, send_or_brake
from orchestrator.clock.base import NS_PER_S
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller

_COUNT_MAX = 2**31


@dataclass(frozen=True, slots=True)
class PpSmcReading:
    """One reading of all axes of the controller, by number.

    counts: None while an axis oscillates; accurate to `grains` steps, by the reported decimals.
    begun_ns: when the query was sent.
    at_ns: when the answer had arrived.
    errors: number and text of the last error, by axis; None where they were not queried."""

    bits: Mapping[int, int]
    counts: Mapping[int, int | None]
    grains: Mapping[int, float]
    begun_ns: int
    at_ns: int
    errors: Mapping[int, tuple[int, str]] | None = None

    @property
    def is_idle(self) -> bool:
        """Whether nothing moves and no program runs."""
        return all(bits & StatusBits.IDLE and not bits & StatusBits.PROGRAM for bits in self.bits.values())

    @property
    def program_runs(self) -> bool:
        return any(bits & StatusBits.PROGRAM for bits in self.bits.values())

    @property
    def is_blocked(self) -> bool:
        return any(bits & StatusBits.BLOCKED for bits in self.bits.values())

    @property
    def on_limit(self) -> bool:
        return any(bits & (StatusBits.LIMIT_FORWARD | StatusBits.LIMIT_REVERSE) for bits in self.bits.values())

    def is_ready(self, motor: int) -> bool:
        return bool(self.bits[motor] & StatusBits.READY)


@dataclass(slots=True)
class PpSmcState:
    """One connection to one controller.

    gears: steps per mm or deg, by axis number.
    homes: position after a reference search, by axis number.
    closed: axes in closed loop.
    enabled: names of the axes that the adapter may move.
    referenced: axes that have been seen with an installed reference since the last search.
    spoiled: axes that a limit switch has stopped, whose position is not valid (L2546); kept over connections.
    loading: lock for configuring the controller.
    output_lock: lock for changing outputs.
    untidy: a stop or a move may have left targets.
    profiles: what is known to be loaded. compared_ns: when all settings were compared at loading, and the panel locked.
    introduced: compared with the fleet file.
    settings: the settings of ?conf that are expected, by axis number and name.
    suspects_settings: others were found while arming.
    driving: a step switches an output.
    on_reading: called with every reading while a move is in progress.
    """

    session: PpSmcSession
    stopper: StopConnection
    config: Controller
    slow_ns: int
    gears: dict[int, Fraction] = field(default_factory=dict[int, Fraction])
    homes: dict[int, int] = field(default_factory=dict[int, int])
    closed: set[int] = field(default_factory=set[int])
    enabled: set[str] = field(default_factory=set[str])
    referenced: set[int] = field(default_factory=set[int])
    spoiled: set[int] = field(default_factory=set[int])
    loading: asyncio.Lock = field(default_factory=asyncio.Lock)
    jogging_motors: set[int] = field(default_factory=set[int])
    compared_ns: int = -3600 * NS_PER_S
    profiles: dict[int, tuple[int, int, int, int]] = field(default_factory=dict[int, tuple[int, int, int, int]])
    output_lock: asyncio.Lock = field(default_factory=asyncio.Lock)
    untidy: bool = False
    introduced: bool = False
    settings: dict[int, dict[str, str]] = field(default_factory=dict[int, dict[str, str]])
    suspects_settings: bool = False
    driving: bool = False
    on_reading: Callable[[PpSmcReading], None] | None = None
    installed: int = 0
    stops: StopCounter = field(default_factory=StopCounter)

    # Status

    async def read_state(self, *, with_errors: bool = False) -> PpSmcReading:
        """Return status and positions of all axes, also of a blocked controller, which does not report errors. Raises
        `ControllerFault`."""
        session, queries = self.session, [ASK_STATUS, ASK_POSITIONS]
        if not session.blocked:
            try:
                reply = await session.send_queries(*queries, *([ASK_ERRORS] if with_errors else []))
            except ControllerFault as error:
                if error.code != "blocked":
                    raise
            else:
                status, positions = reply.first_line(ASK_STATUS), reply.first_line(ASK_POSITIONS)
                reading = self.parse_state(status, positions, reply.written_ns)
                return replace(reading, errors=parse_errors(reply.reply_texts(ASK_ERRORS))) if with_errors else reading
        status, positions = await session.query_blocked()
        return self.parse_state(status, positions, status.at_ns)

    def parse_state(self, status: PpSmcLine, positions: PpSmcLine, begun_ns: int) -> PpSmcReading:
        """Parse two answers. Raises `ControllerFault` when an axis is missing in them."""
        bits = parse_states(status.text)
        counts: dict[int, int | None] = {}
        grains: dict[int, float] = {}
        for number, text in parse_entries(positions.text).items():
            distance = leading_number(text)
            gear = self.gears.get(number, Fraction(1))
            counts[number] = None if distance is None else fleetaxes.parse_steps(distance, gear)
            grains[number] = 1.0 if distance is None else fleetaxes.position_resolution(distance, gear)
        for motor in fleetaxes.axis_numbers(self.config).values():
            if abs(counts.get(motor) or 0) > _COUNT_MAX:
                raise ControllerFault(
                    "garbage",
                    f"axis {motor} is at step {counts[motor]} by {positions.text[:200]!r}; no counter is that long",
                    "check cable and ground",
                )
            if motor not in bits or motor not in counts:
                raise ControllerFault(
                    "garbage",
                    f"axis {motor} is missing in the answers {status.text!r} and {positions.text!r}",
                    "check cable and ground, and `motors` in the fleet file",
                )
        self.installed = max(bits)
        look = PpSmcReading(bits, counts, grains, begun_ns, positions.at_ns)
        if self.on_reading is not None:
            self.on_reading(look)
        return look

    async def read_errors(self) -> dict[int, tuple[int, str]]:
        """Return number and text of the last error, by axis."""
        reply = await self.session.send_queries(ASK_ERRORS)
        return parse_errors(reply.reply_texts(ASK_ERRORS))

    # Starts and stops

    async def start_motion(self, command: str, axis: str, motor: int, since: int) -> None:
        """Send a command that moves one motor, unless a stop has come since `stops.stop_count` returned `since`, or the
        controller has restarted: its position and its speeds differ then. Raises `Refusal`; then nothing was sent."""

        def check_can_begin() -> None:
            self.stops.require_no_stop(axis, motor, since)
            if self.session.batches.restarted:
                raise Refusal("not-started", f"the unit was restarted before axis {axis} began", "home it first")

        await send_or_brake(
            lambda check: self.session.send_once((command,), before_send=check),
            check_can_begin,
            lambda: self.brake_axes([motor]),
        )

    def brake_axes(self, motors: Iterable[int]) -> int:
        """Send `q` to each axis, bypassing everything else."""
        return self.write_stop(*(f"q{motor}" for motor in motors))

    def write_stop(self, *lines: str) -> int:
        """Write on both connections: on the one for stops, because nothing precedes it there; on the first, because
        earlier commands there must not be executed after the stop. Return the instant. Raises `LinkClosed`."""
        alone_ns = self.stopper.write_stop(*lines)
        try:
            at_ns = self.session.write_at_once(*lines)
        except LinkClosed:
            if alone_ns is None:
                raise
            return alone_ns
        return at_ns if alone_ns is None else alone_ns

    def require_enabled(self, names: Iterable[str]) -> None:
        """Raise `Refusal` for an axis that is disabled in the adapter; the controller itself has no such switch."""
        for name in names:
            if name not in self.enabled:
                raise Refusal("not-enabled", f"axis {name} is not enabled", f"enable {name} first")
