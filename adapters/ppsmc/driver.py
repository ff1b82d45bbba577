"""The driver of one pp-electronic SMC."""

import asyncio
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
from adapters.ppsmc import fleetaxes, startup
from adapters.ppsmc.costs import costs, longest_stop_s
from adapters.ppsmc.homing import home
from adapters.ppsmc.jogging import Jogging
from adapters.ppsmc.lowering import SmcLowered, lower
from adapters.ppsmc.moves import Mover
from adapters.ppsmc.options import Options
from adapters.ppsmc.polling import Poller
from adapters.ppsmc.replies import ASK_OUTPUTS, ASK_STATUS
from adapters.ppsmc.session import Session, refusal
from adapters.ppsmc.stopper import Stopper
from adapters.ppsmc.unitstate import UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.rate import CrystalRate
from orchestrator.link.base import LinkClosed
from orchestrator.model.messages import StartWay
from orchestrator.model.profile import Profile

_STOP_RAMP_NS = 2 * NS_PER_S


class PpSmcDriver(Driver):
    """Drives one unit. Its exchanges take turns on one connection; a stop goes past them by another."""

    def __init__(self, setup: Setup, options: Options) -> None:
        self._setup = setup
        self._config = setup.config
        self._options = options
        self._clock = setup.clock
        link = setup.config.link
        self._char_ns = 10 * NS_PER_S // link.baud if link.kind == "serial" else 0
        self._stop_s = longest_stop_s(fleetaxes.bounds(axis) for axis in setup.config.axes.values())
        self._unit: UnitState | None = None
        self._mover: Mover | None = None
        self._poller: Poller | None = None
        self._jogging: Jogging | None = None
        self._installed = max(fleetaxes.motors(setup.config).values())
        self._enabled: set[str] = set(setup.config.axes)
        # Known beyond a connection: the token that the unit held last.
        self._token = 0
        self._restarted = False
        # So is the crystal.
        self._crystal = options.unread_clock()

    # Meeting the unit

    async def connect(self) -> Identity:
        options, slow_ns = self._options, self._options.decode_ns[1]
        await self.close()
        session = Session(
            await self._setup.open_link(),
            self._clock,
            options.answer_ms * NS_PER_MS,
            slow_ns,
            self._token,
        )
        stopper = Stopper(self._setup.open_link, self._config.link.kind == "tcp")
        unit = self._unit = UnitState(session, stopper, self._config, slow_ns, enabled=self._enabled)
        longest_s = max(axis.in_position_timeout_s for axis in self._config.axes.values())
        settle_ns = round(longest_s * NS_PER_S) + _STOP_RAMP_NS
        self._mover = Mover(options, self._clock, self._setup.firer, unit, self._crystal, settle_ns)
        self._poller = Poller(self._config, options, unit)
        self._jogging = Jogging(self._config, self._clock, unit, self._mover)
        await stopper.open()
        identity = await startup.identify(unit)
        await startup.wait_idle(unit, self._clock, options)
        # Said by the first poll: whoever reaches a unit again must hear that it was off meanwhile.
        self._take_note(session)
        self._installed = max(self._installed, unit.installed)
        return identity

    async def configure(self) -> None:
        """A blocked unit answers nothing that could be compared: that is done as soon as it is released."""
        unit = self._connected()
        if not unit.session.blocked:
            async with unit.loading:
                await startup.introduce(unit, self._options)

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(
            start_classes=("host", "line") if self._options.io_port else ("host",),
            orders=(2,),
            independent_axes=False,
            costs=costs(self._options, self._char_ns, self._installed, self._stop_s),
        )

    async def poll(self) -> Reading:
        unit = self._connected()
        assert self._poller is not None
        reading = await self._poller.poll()
        self._token = unit.session.token
        resting = not any(axis.moving for axis in reading.axes.values())
        if not unit.introduced and resting and not unit.session.blocked:
            await self.configure()
        elif unit.untidy and resting and not unit.session.blocked:
            await self._moving().tidy()
        await unit.stopper.open()
        restarted, self._restarted = self._restarted, False
        return replace(reading, restarted=restarted)

    # A step

    def crystal(self) -> CrystalRate:
        return self._crystal.rate

    def lower(self, profiles: Mapping[str, Profile], how: StartWay, mapping: TickMapping | None) -> SmcLowered:
        known = self._crystal.known(self._clock.now_ns())
        return lower(self._config, self._options, self._char_ns, self._installed, known, profiles, how)

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
        """`q` ends all motions and programs by the ramp (L2542), the fastest stop that the unit has. An abort also
        blocks it, so that nothing that others have sent goes on (L1400), until `clear_faults`."""
        unit, mover = self._connected(), self._moving()
        unit.count_stop(range(1, self._installed + 1))
        outputs = mover.after_stop()
        lines = [*outputs, "q", *(["block"] if abort else [])]
        mover.interrupted(unit.write_stop(*lines))
        if abort:
            unit.session.block_sent()

    # By hand

    async def enable(self, axes: Sequence[str], on: bool) -> None:
        """The unit can not switch a motor off: a disabled axis is one that is not moved here."""
        unit = self._connected()
        await unit.session.ask(ASK_STATUS)
        self._enabled.update(axes) if on else self._enabled.difference_update(axes)

    async def home(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        if self._moving().move is not None:
            raise CannotDo("busy", "a move is loaded or under way", "disarm or stop it")
        try:
            return await home(self._config, self._clock, self._connected(), axes, found)
        except DriverFault as error:
            if error.fault.code == "blocked":
                raise refusal(error) from None
            raise

    async def jog(self, axis: str, move: JogMove) -> None:
        self._connected()
        assert self._jogging is not None
        await self._jogging.jog(axis, move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        unit = self._connected()
        motors = [fleetaxes.motor(self._config.axes[name]) for name in axes]
        unit.count_stop(motors)
        if motors:
            unit.brake(motors)

    async def set_output(self, number: int, on: bool) -> None:
        unit = self._connected()
        if not self._options.io_port:
            await unit.session.ask(ASK_STATUS)
            raise CannotDo(
                "no-output", f"there is no output {number}: the unit has no i/o port", "see `options.io_port`"
            )
        if unit.driving:
            raise CannotDo("busy", "a step drives an output, and all are written together", "wait for its end")
        async with self._output_turn:
            now, bit = int((await unit.session.ask(ASK_OUTPUTS)).text(ASK_OUTPUTS)), 1 << number
            value = now | bit if on else now & ~bit
            heard = await unit.session.settle((f"dout{value}",), ASK_OUTPUTS)
        if int(heard.text(ASK_OUTPUTS)) != value:
            raise CannotDo("not-switched", f"the outputs are {heard.text(ASK_OUTPUTS)} after dout{value}", "")

    async def clear_faults(self) -> None:
        """Release a blocked unit, and clear errors (L1630). Raises `CannotDo` while an axis moves."""
        unit = self._connected()
        # Whatever the last poll has seen: a block may be on its way.
        await unit.session.release()
        look = await unit.look()
        if look.blocked:
            raise CannotDo("blocked", "the controller is still blocked after `unblock`", "look at its screen")
        if not look.idle:
            raise CannotDo("moving", "errors can not be cleared while an axis moves", "wait, or stop it")
        await unit.session.settle(("cerr",), ASK_STATUS)
        if not unit.introduced:
            await self.configure()

    async def raw(self, command: str) -> str:
        unit = self._connected()
        if not command.isascii() or not command.isprintable():
            raise CannotDo("raw-line", "a raw command is one line of printable ASCII", "send one line")
        reply = await unit.session.converse(command)
        unit.profiles.clear()
        return reply

    async def close(self) -> None:
        unit, self._unit = self._unit, None
        if unit is not None:
            self._token = unit.session.token
            self._take_note(unit.session)
            if self._mover is not None:
                self._mover.forget()
            await unit.stopper.close()
            await unit.session.close()

    # Inside

    @property
    def _output_turn(self) -> asyncio.Lock:
        return self._connected().output_turn

    def _take_note(self, session: Session) -> None:
        if session.restarted:
            self._restarted, session.restarted = True, False
            self._crystal.forget()

    def _connected(self) -> UnitState:
        if self._unit is None:
            raise LinkClosed(f"{self._setup.controller} is not connected")
        return self._unit

    def _moving(self) -> Mover:
        self._connected()
        assert self._mover is not None
        return self._mover
