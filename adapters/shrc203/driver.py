"""The driver of one SHRC-203."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from adapters.contract import (
    CannotDo,
    Capabilities,
    Driver,
    Identity,
    JogMove,
    Lowered,
    Outcome,
    Reading,
    Setup,
    Span,
)
from adapters.shrc203 import fleetaxes, startup
from adapters.shrc203.axes import letter
from adapters.shrc203.chain import Chain, ChainMove, ChainReport
from adapters.shrc203.costs import costs
from adapters.shrc203.homing import home
from adapters.shrc203.jogging import Jogging
from adapters.shrc203.lowering import ShrcLowered, Wire, lower
from adapters.shrc203.moves import Mover
from adapters.shrc203.options import Options
from adapters.shrc203.polling import Poller
from adapters.shrc203.registered import Kind, registered
from adapters.shrc203.replies import BITS, flags
from adapters.shrc203.session import Session
from adapters.shrc203.standby import can_wait_at_rest
from adapters.shrc203.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.rate import CrystalRate
from orchestrator.link.base import LinkClosed
from orchestrator.model.messages import StartWay
from orchestrator.model.profile import Profile

_RAMP_NS = NS_PER_S  # the longest ramp of a stop
# While a completion is owed, `1` could be the answer to these as well.
_DIGIT_QUERIES = ("?:", "I:", "PIT:GET", "PAV:GET", "MS:")


class ShrcDriver(Driver):
    """Drives one unit over one line. Its exchanges take turns; a stop goes past them."""

    def __init__(self, setup: Setup, options: Options) -> None:
        self._setup = setup
        self._config = setup.config
        self._options = options
        self._clock = setup.clock
        self._char_ns = _char_ns(setup, options)
        self._costs = costs(options, self._char_ns)
        self._line_costs = costs(options, self._char_ns, line=True)
        self._unit: UnitState | None = None
        self._mover: Mover | None = None
        self._poller: Poller | None = None
        self._jogging: Jogging | None = None
        self._outputs = asyncio.Lock()
        # Known beyond a connection: of the unit that still holds the sentinel.
        self._crystal = options.unread_clock()
        self._sentinel: tuple[str, str] | None = None
        self._restarted = False  # since the last poll

    # Meeting the unit

    async def connect(self) -> Identity:
        link = await self._setup.open_link()
        session = Session(link, self._clock, max(link.char_ns, self._char_ns), self._options.answer_ms * NS_PER_MS)
        unit = self._unit = UnitState(session)
        longest_s = max(axis.in_position_timeout_s for axis in self._config.axes.values())
        settle_ns = round(longest_s * NS_PER_S) + _RAMP_NS
        self._mover = Mover(self._options, self._clock, self._setup.firer, unit, self._crystal, settle_ns)
        self._poller = Poller(self._config, self._options, self._clock, unit)
        self._jogging = Jogging(self._config, self._clock, unit, self._mover)
        identity = await startup.identify(session)
        unit.controllable = await startup.controllable_axes(session, self._clock, self._options.busy_wait_s)
        await self._read_motors(unit)
        await unit.make_harmless()
        return identity

    async def configure(self) -> None:
        unit = self._connected()
        await startup.compare(unit.session, self._config, self._options, unit.controllable)
        loops = await unit.session.ask("?:FW", flags(len(unit.controllable)))
        unit.closed_loop = {m: each == "0" for m, each in zip(unit.controllable, loops.split(","), strict=True)}
        if self._sentinel is not None:
            unit.sentinel = self._sentinel
            if await unit.is_restarted():
                self._crystal.forget()
                self._restarted = True
        unit.sentinel = await startup.load_sentinel(unit.session, self._config, unit.controllable)
        self._sentinel = unit.sentinel
        if self._config.inputs:
            unit.line_starts = await can_wait_at_rest(unit)

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(
            start_classes=("host", "line") if self._line_starts else ("host",),
            orders=(2,),
            independent_axes=False,
            costs=self._costs,
        )

    @property
    def _line_starts(self) -> bool:
        """Whether a move can wait for an input; a unit that has not been asked yet is thought to."""
        return self._unit is None or self._unit.line_starts

    async def poll(self) -> Reading:
        self._connected()
        assert self._poller is not None
        reading = await self._poller.poll()
        if self._connected().untidy_at_rest and not any(axis.moving for axis in reading.axes.values()):
            await self._moving().tidy()
        restarted, self._restarted = self._restarted, False
        return replace(reading, restarted=restarted)

    # A step

    def crystal(self) -> CrystalRate:
        return self._crystal.rate

    def lower(self, profiles: Mapping[str, Profile], how: StartWay, mapping: TickMapping | None) -> ShrcLowered:
        loops = {} if self._unit is None else self._unit.closed_loop
        closed_loop = frozenset(motor for motor, closed in loops.items() if closed)
        known = self._crystal.known(self._clock.now_ns())
        wire = Wire(self._char_ns, self._line_starts, self._costs, self._line_costs, known, closed_loop)
        return lower(self._config, self._options, wire, profiles, how)

    async def arm(self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        assert isinstance(lowered, ShrcLowered)
        return await self._moving().arm(lowered, t0_ns)

    async def verify(self) -> None:
        await self._moving().verify()

    async def go(self, slack_ns: int = 0, sooner_ns: int = 0) -> None:
        await self._moving().go(slack_ns, sooner_ns)

    async def disarm(self) -> None:
        await self._moving().disarm()

    async def started(self) -> Mapping[str, Span]:
        return await self._moving().started()

    async def outcome(self) -> Outcome:
        return await self._moving().outcome()

    async def stop(self, abort: bool) -> None:
        """`L:E`, which is never refused; or `L:` to the axes whose motors are on, and then to each by itself,
        because `L:` is refused for all where one motor is off (L2988)."""
        unit = self._connected()
        mover = self._moving()
        unit.count_stop((1, 2, 3))
        if abort:
            lines = ["L:E"]
        else:
            on = [motor for motor in unit.controllable or (1, 2, 3) if unit.excited.get(motor, True)]
            lines = [*mover.before_stop(), f"L:{letter(on)}" if on else "L:W", *(f"L:{motor}" for motor in on)]
        mover.interrupted(unit.session.interrupt(*lines, *mover.after_stop()))

    # By hand

    async def enable(self, axes: Sequence[str], on: bool) -> None:
        unit = self._connected()
        motors = {fleetaxes.motor(self._config.axes[name]) for name in axes}
        if not motors:
            return
        await unit.session.tell(f"C:{letter(motors)}{int(on)}")
        await self._read_motors(unit)
        wrong = [name for name in axes if unit.excited[fleetaxes.motor(self._config.axes[name])] != on]
        if wrong:
            raise CannotDo("not-switched", f"axis {wrong[0]} is not {'on' if on else 'off'} yet", "look at the unit")
        if on:
            await unit.make_harmless()

    async def home(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        return await home(self._config, self._clock, self._connected(), axes, found)

    async def jog(self, axis: str, move: JogMove) -> None:
        self._connected()
        assert self._jogging is not None
        await self._jogging.jog(axis, move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        unit = self._connected()
        motors = [fleetaxes.motor(self._config.axes[name]) for name in axes]
        unit.count_stop(motors)
        unit.brake(motors)

    async def run_chain(
        self, moves: Mapping[str, Sequence[ChainMove]], say: Callable[[str], None] = lambda _: None
    ) -> ChainReport:
        """Run sequences of moves, each begun by the unit itself when the one before it has ended; `stop` ends them.

        Raises `CannotDo`; then nothing has moved. say: told of every underrun.
        """
        unit = self._connected()
        wrong = [name for name, each in moves.items() if name not in self._config.axes or not each]
        if wrong or not moves:
            raise CannotDo(
                "bad-chain",
                f"axis {wrong[0]} is unknown, or has no moves" if wrong else "a chain without axes",
                f"give moves to some of {', '.join(self._config.axes)}",
            )
        async with unit.loading:
            if self._moving().busy:
                raise CannotDo("busy", "a move is loaded or under way", "disarm or stop it")
            unit.chaining = True
        return await Chain(self._config, self._clock, unit, self._options.clock_ppm, say).run(moves)

    async def set_output(self, number: int, on: bool) -> None:
        unit = self._connected()
        if unit.session.owed:
            raise CannotDo("moving", "outputs can not be read back while an axis moves", "wait for its end")
        if unit.driving:
            raise CannotDo("busy", "a step drives an output, and all are written together", "wait for its end")
        async with self._outputs:
            now, bit = int(await unit.session.ask("?:O", BITS)), 1 << (number - 1)
            unit.outputs = now | bit if on else now & ~bit
            await unit.session.tell(f"O:{unit.outputs}")

    async def clear_faults(self) -> None:
        """Clear limit error, overflow error and emergency stop (L2452-L2454). Motors stay as they are."""
        unit = self._connected()
        await unit.session.tell("BEC:W")
        await self._read_motors(unit)

    async def registered(self, kind: Kind) -> Mapping[int, Mapping[str, int]]:
        """Positions that are registered in the unit: pulses by axis, by number (1 to 20).

        kind: `place` of the stage, in coordinates of now (PIT:), or `coordinates` (PAV:). Raises `CannotDo`.
        """
        found = await registered(self._connected().session, kind)
        motors = fleetaxes.motors(self._config)
        return {number: {name: record[motors[name] - 1] for name in motors} for number, record in found.items()}

    async def raw(self, command: str) -> str:
        session = self._connected().session
        if not command.isascii() or not command.isprintable():
            raise CannotDo("raw-line", "a raw command is one line of printable ASCII", "send one line")
        if session.owed and command.upper().startswith(_DIGIT_QUERIES):
            raise CannotDo(
                "moving", f"the answer to {command!r} could not be told from a completion line", "ask again at rest"
            )
        return await session.converse(command)

    async def close(self) -> None:
        unit, self._unit = self._unit, None
        if unit is not None:
            assert self._mover is not None
            self._mover.forget()
            await unit.session.close()

    # Inside

    def _connected(self) -> UnitState:
        if self._unit is None:
            raise LinkClosed(f"{self._setup.controller} is not connected")
        return self._unit

    def _moving(self) -> Mover:
        self._connected()
        assert self._mover is not None
        return self._mover

    async def _read_motors(self, unit: UnitState) -> None:
        answer = await unit.session.ask("?:CW", flags(len(unit.controllable)))
        unit.excited = {m: each == "1" for m, each in zip(unit.controllable, answer.split(","), strict=True)}


def _char_ns(setup: Setup, options: Options) -> int:
    """One character on the serial side: start, data, parity and stop bits at the baud rate."""
    link = setup.config.link
    if link.kind != "serial":
        return 10 * NS_PER_S // options.bridge_baud
    bits_per_character = 1 + link.data_bits + (link.parity != "none") + link.stop_bits
    return bits_per_character * NS_PER_S // link.baud
