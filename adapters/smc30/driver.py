"""The driver of one SMC30, alone on its line or on a bus."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from adapters.contract import (
    CannotDo,
    Capabilities,
    Driver,
    DriverFault,
    Identity,
    JogMove,
    Lowered,
    Outcome,
    Reading,
    Setup,
    Span,
)
from adapters.smc30 import startup
from adapters.smc30.costs import costs
from adapters.smc30.hand import Hand
from adapters.smc30.line import SHARED, Line
from adapters.smc30.lowering import LINES_BEFORE, Slots, SmcLowered, lower, slots
from adapters.smc30.mover import Mover, passive
from adapters.smc30.options import Options
from adapters.smc30.polling import Poller
from adapters.smc30.session import Busy, Session
from adapters.smc30.unitaxis import address, only_axis
from adapters.smc30.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.rate import CrystalRate
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import SerialLink
from orchestrator.model.messages import StartWay
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs

_BITS = 10  # of a character: start, seven data, parity, stop (L1003-L1011)
_BRIDGE_BAUD = 9600  # behind a TCP bridge: the quickest that the unit has


class SmcDriver(Driver):
    """Drives one unit. Its exchanges take turns with those of the other units of its line; a stop goes past them."""

    def __init__(self, setup: Setup, options: Options) -> None:
        self._setup = setup
        self._config = setup.config
        self._options = options
        self._clock = setup.clock
        self._axis, axis = only_axis(setup.config)
        self._address = address(setup.config)
        link = setup.config.link
        baud = link.baud if isinstance(link, SerialLink) else _BRIDGE_BAUD
        self._char_ns = _BITS * NS_PER_S // baud
        answer_ns = options.answer_ms * NS_PER_MS
        self._line: Line = setup.shared.setdefault(SHARED, Line(setup.clock, options.checksum, answer_ns))
        self._line.join(self._address, answer_ns)
        self._ramp_s = axis.limits.velocity / axis.limits.acceleration
        self._unit: UnitState | None = None
        self._mover: Mover | None = None
        self._hand: Hand | None = None
        self._poller: Poller | None = None
        self._enabled = True
        self._lost = False
        # Known beyond a connection.
        self._crystal = options.unread_clock(LINES_BEFORE)
        self._met = False
        self._restarted = False

    # Meeting the unit

    async def connect(self) -> Identity:
        if self._line.with_checksum != self._options.checksum:
            raise DriverFault(
                "config-mismatch",
                f"{self._setup.config.link.place}: the units of one line do not agree on option `checksum`",
                "give all of them the same, and set their switches CHS accordingly",
            )
        await self._line.attach(self._address, self._setup.open_link, self._char_ns)
        session = Session(self._line, self._clock, self._address, self._options.checksum)
        unit = self._unit = UnitState(session, self._clock, enabled=self._enabled, lost=self._lost)
        mover = self._mover = Mover(self._options, self._clock, self._setup.firer, unit, self._crystal, self._slots)
        hand = self._hand = Hand(
            self._config, self._options, self._clock, unit, lambda: mover.move is not None or unit.doing == "home"
        )
        self._poller = Poller(self._config, self._clock, unit, mover, hand)
        await startup.meet(unit)
        number = "" if self._address is None else f"address {self._address}"
        return Identity(model="SMC30", firmware="", serial=number)

    async def configure(self) -> None:
        fresh = await startup.configure(self._connected(), self._options, self._clock)
        # Said by the next poll: whoever reaches a unit again must hear that it was off meanwhile.
        self._restarted = self._restarted or (fresh and self._met)
        if fresh:
            self._crystal.forget()
            self._connected().lost = False
        self._met = True

    @property
    def _slots(self) -> Slots:
        return slots(self._options, self._char_ns, self._line.place(self._address), len(self._line.units))

    def _costs(self, ramp_s: float) -> Costs:
        return costs(self._options, self._char_ns, self._slots, ramp_s)

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(
            start_classes=("host", "line"), orders=(2,), independent_axes=False, costs=self._costs(self._ramp_s)
        )

    async def poll(self) -> Reading:
        unit = self._connected()
        assert self._poller is not None
        reading = await self._poller.poll()
        restarted, self._restarted = self._restarted, False
        self._lost = unit.lost
        return replace(reading, restarted=restarted)

    # A step

    def crystal(self) -> CrystalRate:
        return self._crystal.rate

    def lower(self, profiles: Mapping[str, Profile], how: StartWay, mapping: TickMapping | None) -> SmcLowered:
        ramp_s = max([self._ramp_s, *(max(each.durations_s, default=0.0) for each in profiles.values())])
        known = self._crystal.known(self._clock.now_ns())
        return lower(self._config, self._options, self._costs(ramp_s), self._slots, known, dict(profiles), how)

    async def arm(self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        assert isinstance(lowered, SmcLowered)
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
        """Z, by the ramp of the motion; or K, at once, after which its counter may be wrong (L1848-L1859)."""
        unit, mover = self._connected(), self._moving()
        after = passive(mover.move.lowered) if mover.move is not None else ()
        mover.interrupted(unit.stop("K" if abort else "Z", *after))

    async def stop_first(self) -> bool:
        if self._address is None:
            return False
        await self._line.attach(self._address, self._setup.open_link, self._char_ns)
        session = Session(self._line, self._clock, self._address, self._options.checksum)
        await UnitState(session, self._clock).stop_now()
        return True

    # By hand

    async def enable(self, axes: Sequence[str], on: bool) -> None:
        """By the standby current: the unit has nothing else to switch its motor with (L1998-L2001)."""
        if not axes:
            return
        unit = self._connected()
        await unit.stopped()
        await self._tell(f"CS{self._options.standby_ma if on else 0}")
        unit.enabled = self._enabled = on

    async def home(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        self._connected()
        assert self._hand is not None
        return await self._hand.home(found) if axes else {}

    async def jog(self, axis: str, move: JogMove) -> None:
        self._connected()
        assert self._hand is not None
        await self._hand.jog(move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        if axes:
            self._connected().stop("Z")

    async def set_output(self, number: int, on: bool) -> None:
        await self._tell(f"{'A' if on else 'C'}{number}")

    async def clear_faults(self) -> None:
        """The error of a program is told once; a counter that has run over is written anew (L1807-L1816), and the
        axis does not know where it is."""
        unit = self._connected()
        await unit.stopped()
        unit.program_error = False
        unit.limit = "none"
        if not (await unit.status()).busy and unit.overflow:
            try:
                counts = await unit.position()
            except Busy:
                raise CannotDo("moving", f"{unit.session.name} executes a program", "wait, or stop it") from None
            await self._tell(f"f{max(-8_388_606, min(8_388_606, counts)):+d}")
            unit.overflow, unit.lost = False, True
        unit.program_error = False

    async def raw(self, command: str) -> str:
        unit = self._connected()
        if not command.isascii() or not command.isprintable():
            raise CannotDo("raw-line", "a raw command is one line of printable ASCII", "send one line")
        async with unit.loading:
            unit.program = None
            return await unit.session.converse(command)

    async def close(self) -> None:
        unit, self._unit = self._unit, None
        mover, self._mover = self._mover, None
        if mover is not None and mover.move is not None and mover.move.order is not None and mover.move.order.cancel():
            assert mover.move.shot is not None
            self._line.release(mover.move.shot)
        if unit is not None:
            unit.forget_stops()
            await self._line.detach(self._address)

    # Inside

    def _connected(self) -> UnitState:
        if self._unit is None:
            raise LinkClosed(f"{self._setup.controller} is not connected")
        return self._unit

    def _moving(self) -> Mover:
        self._connected()
        assert self._mover is not None
        return self._mover

    async def _tell(self, command: str) -> None:
        unit = self._connected()
        session = unit.session
        try:
            async with unit.loading:
                await unit.leave_programming()
                await session.tell(command)
        except Busy:
            text = f"{session.name} executes a program, and takes no {command}"
            raise CannotDo("moving", text, "wait, or stop it") from None
