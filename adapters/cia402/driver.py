"""The driver of one CiA 402 drive."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Literal

from adapters.cia402 import eds, startup, states
from adapters.cia402 import objects as o
from adapters.cia402.bus import SHARED, Bus
from adapters.cia402.costs import costs
from adapters.cia402.fleetaxes import (
    POINTS,
    POSITION_MAX,
    node,
    only_axis,
    passive_outputs,
    ramp,
    ramp_s,
    streams,
    units,
)
from adapters.cia402.hand import Hand
from adapters.cia402.lowering import BusTimes, CiaLowered, lower
from adapters.cia402.moves import Mover
from adapters.cia402.node import Node
from adapters.cia402.objects import CONSUMER, CYCLIC_MODE, FOLLOWED, Obj, point_bit
from adapters.cia402.options import Options
from adapters.cia402.pdo import pdos
from adapters.cia402.power import Power
from adapters.cia402.sdo import bus_off
from adapters.cia402.starts import Starts
from adapters.cia402.states import State
from adapters.contract import (
    AxisReading,
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
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import CanBusLink
from orchestrator.model.messages import StartWay
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs, Fault

_STARTS = "cia402 starts"
_NEGATIVE_LIMIT, _POSITIVE_LIMIT = 1, 2  # bits of 60FDh


class CiaDriver(Driver):
    """Drives one node. Its state comes by PDO; SDOs take turns by node, and a stop is a frame of its own."""

    def __init__(self, setup: Setup, options: Options) -> None:
        self._setup = setup
        self._config = setup.config
        self._options = options
        self._clock = setup.clock
        self._number = node(setup.config)
        self._axis, axis = only_axis(setup.config)
        link = setup.config.link
        assert isinstance(link, CanBusLink)
        self._bus: Bus = setup.shared.setdefault(SHARED, Bus(setup.clock, link.bitrate))
        self._bus.join(self._number, options.start_us * NS_PER_US)
        self._starts: Starts = setup.shared.setdefault(_STARTS, Starts(self._bus))
        self._starts.lost(self._number)
        self._ramp, self._ramp_s = ramp(axis, units(options)), ramp_s(axis)
        self._settle_ns = round(axis.in_position_timeout_s * NS_PER_S)
        self._pdos = pdos(options, outputs=bool(setup.config.outputs))
        self._streams = streams(setup.config)
        if self._streams:
            self._bus.periods_ms[self._number] = options.period_ms
        if options.watchdog_ms is not None:
            self._bus.watchdogs_ms[self._number] = options.watchdog_ms
            self._bus.host_node = options.host_node
        self._following: int | None = CYCLIC_MODE
        """How the drive follows positions, as soon as it is known."""
        self._node: Node | None = None
        self._power: Power | None = None
        self._mover: Mover | None = None
        self._hand: Hand | None = None
        self._boots = 0
        self._met = self._stranger = self._restarted = False

    # Meeting the drive

    async def connect(self) -> Identity:
        link = self._config.link
        assert isinstance(link, CanBusLink)
        if self._bus.bitrate != link.bitrate:
            raise DriverFault(
                "config-mismatch",
                f"{link.place}: the drives of one bus do not agree on link.bitrate",
                "give all of them the same",
            )
        if self._bus.host_node in self._bus.units:
            raise DriverFault(
                "config-mismatch",
                f"{link.place}: a drive has the node number {self._bus.host_node} of this computer's heartbeat",
                "give this computer another one with `options.host_node`",
            )
        if len(set(self._bus.periods_ms.values())) > 1:
            raise DriverFault(
                "config-mismatch",
                f"{link.place}: the drives of one bus do not agree on options.period_ms, and one SYNC is for all",
                "give all of them the same",
            )
        await self._attach()
        found, power = self._connected(), self._power
        assert power is not None
        mover = self._mover = Mover(
            self._options, found, self._starts, self._setup.firer, power, self._settle_ns, self._ramp
        )
        hand = self._hand = Hand(self._config, self._options, found, power, lambda: mover.move is not None)
        mover.busy = lambda: hand.homing or hand.jogging
        identity = await startup.identify(found, self._options.boot_ms)
        if self._options.eds is not None:
            await startup.compare_product(found, self._product(self._options.eds))
        await self._see_how_it_follows(found)
        self._stranger = await startup.take_over(found, self._starts, self._options, self._pdos)
        self._boots = found.boots
        return identity

    async def _attach(self) -> None:
        answer_ns = self._options.answer_ms * NS_PER_MS
        name = f"node {self._number}"
        fresh = Node(self._bus, self._number, name, answer_ns, outputs=bool(self._config.outputs))
        await self._bus.attach(self._number, fresh, self._setup.open_link)
        self._node, self._power = fresh, Power(fresh, passive_outputs(self._config))

    async def _see_how_it_follows(self, found: Node) -> None:
        """Only a drive that is to move with limited jerk needs to."""
        if self._streams:
            self._following = await startup.way_to_follow(found)
            found.followed = None if self._following is None else FOLLOWED[self._following]
            self._pdos = pdos(self._options, outputs=bool(self._config.outputs), followed=found.followed)

    def _product(self, path: str) -> eds.Product:
        try:
            return eds.read(path, self._pdos)
        except ValueError as error:
            raise DriverFault("config-mismatch", str(error), "correct `options.eds`, or leave it out") from None

    async def configure(self) -> None:
        found = self._connected()
        await startup.rest(found, self._options.busy_wait_s)
        await startup.compare(found, self._config, self._options)
        # Said by the next poll: whoever reaches a drive again must hear that it was off meanwhile.
        self._restarted = self._restarted or (self._stranger and self._met)
        self._met = True

    def _costs(self, longest_ramp_s: float) -> Costs:
        return costs(self._options, self._bus.bitrate, len(self._bus.units), longest_ramp_s)

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(
            start_classes=("sync",),
            orders=(2, 3) if self._streams else (2,),
            independent_axes=False,
            costs=self._costs(self._ramp_s),
        )

    async def poll(self) -> Reading:
        """What the drive says by itself; it is asked nothing."""
        found = self._connected()
        patience_ns = 3 * max(self._options.heartbeat_ms, self._options.state_ms) * NS_PER_MS
        if self._bus.off:
            raise bus_off(found.name)
        began_ns = self._clock.now_ns()

        # What it said last is what holds now if it still speaks: it speaks at once when something changes.
        def heard() -> bool:
            return found.heard_ns > began_ns or found.boots != self._boots or self._bus.off

        if not await found.until(heard, began_ns + patience_ns):
            raise DriverFault(
                "no-answer",
                f"{found.name} has been silent for {(self._clock.now_ns() - found.heard_ns) // NS_PER_MS} ms, its "
                f"heartbeat comes every {self._options.heartbeat_ms} ms",
                "check its power, the cable and both terminations",
            )
        if self._bus.off:
            raise bus_off(found.name)
        restarted, self._restarted = self._restarted, False
        if found.boots != self._boots:
            restarted = True
            await self._recover(found)
        return self._reading(found, restarted)

    async def _recover(self, found: Node) -> None:
        """The drive was switched off and on: load again what it has lost."""
        self._moving().forget()
        boots = found.boots
        await startup.take_over(found, self._starts, self._options, self._pdos)
        await startup.compare(found, self._config, self._options)
        self._boots = boots

    def _reading(self, found: Node, restarted: bool) -> Reading:
        moving = self._moves(found)
        axis = AxisReading(
            commanded_counts=found.demand,
            actual_counts=float(found.actual),
            velocity_counts_s=found.velocity / float(self._options.velocity_units) if moving else 0.0,
            moving=moving,
            enabled=found.enabled,
            limit=_limit(found.inputs),
        )
        return Reading(
            at_ns=found.state_ns if moving and found.state_ns else found.heard_ns,
            axes={self._axis: axis},
            inputs={number: bool(found.inputs & point_bit(number)) for number in POINTS},
            outputs={number: bool(found.outputs & point_bit(number)) for number in POINTS}
            if self._config.outputs
            else {},
            faults=self._faults(found),
            restarted=restarted,
        )

    def _moves(self, found: Node) -> bool:
        """By its own word while something is under way; else by its position, which says it a little later."""
        assert self._hand is not None and self._power is not None
        if self._power.stopping:
            return True
        mover = self._moving()
        stepping = mover.move is not None and mover.move.started is not None
        under_way = stepping or self._hand.homing or self._hand.jogging
        if under_way and found.enabled and not found.status & states.TARGET_REACHED:
            return True
        return bool(found.moved_ns) and self._clock.now_ns() - found.moved_ns < 2 * self._options.inhibit_ms * NS_PER_MS

    def _faults(self, found: Node) -> list[Fault]:
        codes = dict(found.emergencies)
        if not codes and found.state in (State.FAULT, State.REACTION):
            codes = {0: found.why()}
        return [
            Fault(
                code="emergency" if code else "fault",
                text=f"{found.name}: {text}",
                remedy="take away its cause, then clear it with `tutti reset`",
                axis=self._axis,
            )
            for code, text in codes.items()
        ]

    # A step

    def lower(self, profiles: Mapping[str, Profile], how: StartWay, mapping: TickMapping | None) -> CiaLowered:
        longest_s = max([self._ramp_s, *(max(each.durations_s, default=0.0) for each in profiles.values())])
        times = BusTimes(self._bus.bitrate, self._bus.start_ns, len(self._bus.units))
        return lower(self._config, self._options, times, self._costs(longest_s), profiles, how, self._following)

    async def arm(self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        assert isinstance(lowered, CiaLowered)
        return await self._moving().arm(lowered, t0_ns)

    async def verify(self) -> None:
        await self._moving().verify()

    async def go(self, slack_ns: int = 0, sooner_ns: int = 0) -> None:
        # A SYNC may start several drives, and only all of them together: never sooner.
        await self._moving().go(slack_ns)

    async def disarm(self) -> None:
        await self._moving().disarm()

    async def started(self) -> Mapping[str, Span]:
        return await self._moving().started()

    async def outcome(self) -> Outcome:
        return await self._moving().outcome()

    async def stop(self, abort: bool) -> None:
        """Halt, by the deceleration of the profile; or quick stop, by the drive's own."""
        mover, power = self._moving(), self._power
        assert power is not None
        mover.interrupted(power.stop(abort))

    async def stop_first(self) -> bool:
        await self._attach()
        assert self._power is not None
        self._power.stop(False)
        return True

    # By hand

    async def enable(self, axes: Sequence[str], on: bool) -> None:
        self._connected()
        if axes:
            assert self._power is not None
            await self._power.switch(on)

    async def home(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        self._connected()
        assert self._hand is not None
        return await self._hand.home(axes, found) if axes else {}

    async def jog(self, axis: str, move: JogMove) -> None:
        del axis
        self._connected()
        assert self._hand is not None
        await self._hand.jog(move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        if axes:
            self._connected()
            assert self._power is not None
            self._power.stop(False)

    async def load_limits(self, limits: Mapping[str, tuple[int, int] | None]) -> None:
        """607Dh; the whole range for an axis that does not know where it is."""
        found = self._connected()
        for pair in limits.values():
            low, high = (-POSITION_MAX, POSITION_MAX) if pair is None else pair
            await startup.load(found, o.LIMIT_LOW, low)
            await startup.load(found, o.LIMIT_HIGH, high)

    async def set_output(self, number: int, on: bool) -> None:
        found = self._connected()
        mover = self._moving()
        if mover.move is not None and mover.move.lowered.drive is not None:
            raise CannotDo("busy", "a step drives an output, and all are written together", "wait for its end")
        if mover.move is not None and mover.move.waits:
            raise CannotDo(
                "busy", "a set-point waits for its SYNC, and outputs are written with it", "wait for the start"
            )
        bit = point_bit(number)
        found.outputs = found.outputs | bit if on else found.outputs & ~bit
        riding = mover.move is not None and mover.move.ride is not None
        found.order(found.control if riding else found.control & ~states.NEW_SET_POINT)
        held = await found.sdo.read(o.OUTPUTS)
        if held != found.outputs:
            raise DriverFault(
                "not-switched",
                f"{found.name} holds {held:#010x} in {o.OUTPUTS}, and was given {found.outputs:#010x}",
                "has the drive this output? Is another master on the bus?",
            )

    async def clear_faults(self) -> None:
        self._connected()
        assert self._power is not None
        await self._power.reset()

    async def raw(self, command: str) -> str:
        """`6041:0/16` reads an object of 16 bits, `6081:0/32=1000` writes it (hexadecimal index and sub-index)."""
        found = self._connected()
        obj, value = _parsed(command)
        if value is None:
            return str(await found.sdo.read(obj))
        await found.sdo.write(obj, value)
        return "ok"

    async def close(self) -> None:
        found, self._node = self._node, None
        if found is not None:
            self._starts.lost(self._number)
            if self._mover is not None:
                with suppress(DriverFault, LinkClosed):
                    await self._mover.abandon()
                    if self._options.watchdog_ms is not None and found.mapped:
                        await found.sdo.write(CONSUMER, 0)
                self._mover.forget()
            if self._power is not None:
                self._power.forget()
            await self._bus.detach(self._number, found)
            # Who waits for what it does, a search for one, hears nothing more of it.
            found.lost(LinkClosed(f"{self._setup.controller} is left"))

    # Inside

    def _connected(self) -> Node:
        if self._node is None:
            raise LinkClosed(f"{self._setup.controller} is not connected")
        return self._node

    def _moving(self) -> Mover:
        self._connected()
        assert self._mover is not None
        return self._mover


def _limit(inputs: int) -> Literal["none", "forward", "reverse", "both"]:
    """The limit switches in 60FDh."""
    negative, positive = inputs & _NEGATIVE_LIMIT, inputs & _POSITIVE_LIMIT
    if negative and positive:
        return "both"
    return "reverse" if negative else "forward" if positive else "none"


def _parsed(command: str) -> tuple[Obj, int | None]:
    place, given, value = command.partition("=")
    try:
        address, _, bits = place.partition("/")
        index, _, sub = address.partition(":")
        obj = Obj(
            int(index, 16), int(sub or "0", 16), int(bits or "32"), "object", signed=value.strip().startswith("-")
        )
        if obj.bits not in (8, 16, 32):
            raise ValueError
        number = int(value, 0) if given else None
        if number is not None:
            obj.encode(number)
    except (ValueError, OverflowError):
        raise CannotDo(
            "raw-line", f"{command!r} is no access to an object", "write 6041:0/16 to read, 6081:0/32=1000 to write"
        ) from None
    return obj, number
