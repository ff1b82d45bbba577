"""One step of a drive: its set-point, or the start of its stream, loaded and read back, held back for the SYNC of the
bus, and followed to its end."""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, floor

from adapters.cia402 import objects as o
from adapters.cia402 import states
from adapters.cia402.costs import full_frame_ns, sync_ns
from adapters.cia402.lowering import CiaLowered
from adapters.cia402.node import Node
from adapters.cia402.objects import Obj
from adapters.cia402.options import Options
from adapters.cia402.power import Power
from adapters.cia402.ride import Ride
from adapters.cia402.sdo import bus_off
from adapters.cia402.starts import Shot, Starts
from adapters.cia402.states import State
from adapters.cia402.stream import COPIES, TAIL
from adapters.contract import CannotDo, DriverFault, Firer, Outcome, Span
from adapters.toolkit.firing import missed
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Timer
from orchestrator.link.base import LinkClosed

_GONE_NS = 50 * NS_PER_MS  # from a start to the first count of its motion that is told
_OVERDUE_NS = NS_PER_S  # a motion that ends later than this is held, or has never begun
_MODES = {
    o.PROFILE_POSITION_MODE: "profile position",
    o.INTERPOLATED_MODE: "interpolated position",
    o.CYCLIC_MODE: "cyclic synchronous position",
}
_SHORTEST_SYNC = 2  # its longest form has so many times the bits of its shortest one, at the most


@dataclass(slots=True, eq=False)
class Move:
    """A step that is loaded. boots, left: how often the drive had started, and this computer had left the bus. ride: in
    a stream."""

    lowered: CiaLowered
    t0_ns: int
    shot: Shot
    boots: int
    left: int
    outputs: int
    ride: Ride | None = None
    released: bool = False
    followed: bool = False
    started: Span | None = None
    stopped_ns: int | None = None
    release: Timer | None = None

    @property
    def waits(self) -> bool:
        """It was released, and its SYNC has not come."""
        return self.released and not self.shot.fired.done()


class Mover:
    """Arms, starts and follows steps of one connection. ramp: by which a drive brakes that follows a stream (6084h)."""

    def __init__(
        self, options: Options, node: Node, starts: Starts, firer: Firer, power: Power, settle_ns: int, ramp: int
    ) -> None:
        self._options = options
        self._node = node
        self._starts = starts
        self._firer = firer
        self._power = power
        self._settle_ns = settle_ns
        self._ramp = ramp
        self.move: Move | None = None
        self.busy: Callable[[], bool] = lambda: False
        """Whether something else moves the axis."""

    # Before the start

    async def arm(self, lowered: CiaLowered, t0_ns: int) -> Mapping[str, int]:
        """Raises `CannotDo`; then nothing is loaded."""
        node = self._node
        if self.move is not None or self.busy():
            raise CannotDo("busy", "a motion is loaded or under way", "disarm or stop it")
        # The last SYNC of a stream is a period behind its end, and may be late.
        course_ns = 0 if lowered.course is None else (lowered.course.count + TAIL) * lowered.course.period_ns
        shot = self._starts.reserve(node.number, t0_ns, t0_ns + course_ns)
        move = self.move = Move(lowered, t0_ns, shot, node.boots, node.left_bus, node.outputs)
        try:
            return await self._load(move)
        except BaseException:
            self._starts.drop(node.number, shot)
            if self.move is move:
                self.move = None
            raise

    async def _load(self, move: Move) -> Mapping[str, int]:
        node, lowered = self._node, move.lowered
        await self._power.stopped()
        began_ns, stops = node.clock.now_ns(), node.stops
        if lowered.drive is not None and node.outputs != lowered.drive.switched(node.outputs, active=False):
            raise CannotDo(
                "line-level",
                f"output {lowered.drive.name} is active already",
                "make the line passive; see `active` in the fleet file",
            )
        node.require_well()
        if lowered.target is None:
            return {"wire": 0}
        self._require_start(move)
        loaded = await (self._load_set_point(lowered) if lowered.course is None else self._load_stream(lowered))
        loaded_ns = node.clock.now_ns()
        for obj, value in loaded.items():
            found = await node.sdo.read(obj)
            if found != value:
                raise CannotDo(
                    "load-garbled",
                    f"{node.name} holds {found} in {obj}, and was given {value}",
                    "arm again; is another master on the bus?",
                )
        if node.stops != stops:
            raise CannotDo("stopped", "a stop came while arming", "")
        self._require_start(move)
        return {"wire": loaded_ns - began_ns, "verify": node.clock.now_ns() - loaded_ns}

    async def _load_set_point(self, lowered: CiaLowered) -> Mapping[Obj, int]:
        """What it must hold afterwards."""
        node, shape, target = self._node, lowered.shape, lowered.target
        assert shape is not None and target is not None
        node.order(states.ENABLE, o.PROFILE_POSITION_MODE)
        await node.set_point(target, shape.velocity, shape.acceleration, shape.deceleration)
        await self._require_mode(o.PROFILE_POSITION_MODE, lambda: not node.status & states.ACKNOWLEDGED)
        return {
            o.TARGET: target,
            o.PROFILE_VELOCITY: shape.velocity,
            o.ACCELERATION: shape.acceleration,
            o.DECELERATION: shape.deceleration,
        }

    async def _load_stream(self, lowered: CiaLowered) -> Mapping[Obj, int]:
        """The drive follows where it stands, until the first SYNC."""
        node, here = self._node, lowered.start_counts
        assert node.followed is not None
        await node.sdo.write(o.DECELERATION, self._ramp)
        await node.sdo.write(node.followed, here)
        node.order(states.ENABLE, lowered.mode)
        await self._require_mode(lowered.mode, lambda: True)
        if lowered.mode == o.INTERPOLATED_MODE:
            node.order(states.ENABLE | states.FOLLOW)
            if not await node.soon(lambda: bool(node.status & states.FOLLOWS)):
                await node.look()
                raise CannotDo("wrong-mode", f"{node.name} does not begin to interpolate", "see its manual")
        return {node.followed: here, o.DECELERATION: self._ramp}

    async def _require_mode(self, mode: int, ready: Callable[[], bool]) -> None:
        """Raises `CannotDo` (wrong-mode)."""
        node = self._node
        there = await node.soon(lambda: (node.mode == mode and ready()) or not node.enabled)
        if not there or not node.enabled:
            await node.look()
            raise CannotDo(
                "wrong-mode",
                f"{node.name} does not go over to {_MODES[mode]} mode; it shows mode {node.mode} and is "
                f"{node.state.value}",
                "does it have this mode (6502h)? Is another master on the bus?",
            )

    async def verify(self) -> None:
        """Still loaded, still where the plan starts. Raises `CannotDo`."""
        move, node = self._require(), self._node
        await node.look()
        node.require_well()
        if node.boots != move.boots:
            raise CannotDo("not-loaded", f"{node.name} was switched off and on", "arm again")
        if move.left != node.left_bus:
            raise CannotDo("bus-off", f"{node.name} could not be reached meanwhile", "arm again")
        if move.lowered.target is not None:
            self._require_start(move)
            if node.mode != move.lowered.mode:
                raise CannotDo("not-loaded", f"{node.name} shows mode {node.mode} of operation", "arm again")

    async def go(self, slack_ns: int) -> None:
        """Have what starts wait in the drive for the SYNC, and the SYNC written so that the motion is at T0, or
        `slack_ns` later than promised: but not before a stream, whose later SYNCs have their own instants."""
        move, node = self._require(), self._node
        lowered = move.lowered
        if lowered.target is None and lowered.drive is None:
            return
        at_ns = move.t0_ns - lowered.lead_ns
        # What waits in the drive must be there before the SYNC.
        if node.clock.now_ns() + NS_PER_MS >= at_ns:
            raise CannotDo("late", "the instant to write the SYNC is past", "give more lead time")
        control = node.control if lowered.shape is None else states.ENABLE | states.NEW_SET_POINT
        course = lowered.course
        outputs = node.outputs
        if lowered.drive is not None:
            outputs = lowered.drive.switched(outputs, active=True)
            self._power.drives(True, lowered.drive.switched(outputs, active=False))
        move.released = node.loaded = True
        frames = [node.at_sync(control, outputs)]
        if course is not None:
            ride = move.ride = Ride(node, course, lambda: self._derailed(move))
            self._starts.ride(node.number, move.shot, ride, self._firer, at_ns, course.period_ns)
            frames += [ride.frame(0)] * COPIES
        elif node.followed == o.TARGET and lowered.target is not None:
            # The SYNC takes what waits there, too: not an older position.
            frames.append(node.position(lowered.target))
        latest_ns = self._options.latest_ns(at_ns, slack_ns if move.shot.stream is None else 0)
        self._starts.load(node.number, move.shot, frames, self._firer, at_ns, latest_ns)

    async def disarm(self) -> None:
        """Take back what waits in the drive, and the SYNC unless others need it. Nothing starts any more."""
        move, self.move = self.move, None
        if move is not None:
            self._take_back(move)
        await self._power.stopped()

    def _take_back(self, move: Move) -> None:
        node = self._node
        waits = self._starts.drop(node.number, move.shot)
        self._passive(move)
        if waits:
            # Whatever SYNC takes it finds what the drive was told last; until then every order overwrites it.
            mode = o.PROFILE_POSITION_MODE if move.lowered.course is not None and move.stopped_ns is None else None
            node.order(node.control & ~states.NEW_SET_POINT, mode)
            node.loaded = not self._starts.flush()
        else:
            node.loaded = False

    def _passive(self, move: Move) -> None:
        """The driven output is passive, now and when its time is over."""
        if move.release is not None:
            move.release.cancel()
            move.release = None
        drive, node = move.lowered.drive, self._node
        if drive is not None:
            self._power.drives(False, 0)
            node.outputs = drive.switched(node.outputs, active=False)
            if move.released and node.mapped:
                node.order(node.control if move.ride is not None else node.control & ~states.NEW_SET_POINT)

    def interrupted(self, at_ns: int) -> None:
        """A stop was written at that instant."""
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        before = not move.shot.fired.done()
        self._take_back(move)
        if before or not move.followed:
            self.move = None
        self._node.wake()

    def _derailed(self, move: Move) -> None:
        """Its stream can not go on: it brakes."""
        with suppress(LinkClosed):
            if move.stopped_ns is None and self.move is move:
                self._power.stop(False)
            self._starts.drop(self._node.number, move.shot)
            self._starts.flush()

    async def abandon(self) -> None:
        """Nobody leads the drive on: it halts, and says so. Raises `DriverFault`, `LinkClosed`."""
        move = self.move
        if move is not None and move.ride is not None and not move.ride.done and move.shot.fired.done():
            await self._node.sdo.write(o.CONTROLWORD, states.ENABLE | states.HALT)

    def forget(self) -> None:
        """The connection ends; what waits for an instant does not any more."""
        move, self.move = self.move, None
        if move is not None:
            self._starts.drop(self._node.number, move.shot)
            if move.release is not None:
                move.release.cancel()

    # After the start

    async def started(self) -> Mapping[str, Span]:
        """When the axis started; raises `DriverFault` when it did not."""
        move, node = self._require(), self._node
        move.followed = True
        lowered = move.lowered
        names = list(lowered.durations_s)
        if lowered.target is None and lowered.drive is None:
            return {name: Span(move.t0_ns, move.t0_ns) for name in names}
        fired = await asyncio.shield(move.shot.fired)
        node.loaded = False
        if fired is None or (move.stopped_ns is not None and move.stopped_ns < fired.written_ns):
            raise DriverFault("not-started", "the order to start was taken back", "")
        if fired.late:
            self._take_back(move)
            raise missed("the SYNC", node.bus.can.link, fired)
        if lowered.drive is not None:
            self._hold(move)
        if lowered.target is None:
            return {name: Span(move.t0_ns, move.t0_ns) for name in names}
        earliest_ns, latest_ns = self._promised(fired.written_ns)

        def taken_ns() -> int:
            """When it has said that it has taken what it was to start with; 0: it has not."""
            said_ns = node.acknowledged_ns if move.ride is None else node.answer.at_ns
            return said_ns if said_ns > fired.written_ns else 0

        taken = await node.until(lambda: self._interrupted_now(move) or bool(taken_ns()), latest_ns + node.answer_ns)
        if not taken_ns() and move.stopped_ns is None:
            # It may be slow rather than deaf, and start with a SYNC that comes late: not behind anybody's back.
            await node.until(lambda: not self._power.stopping, latest_ns + node.answer_ns)
            raise self._not_started(move, taken)
        # On a limit a set-point is taken, and nothing moves.
        gone_ns = node.clock.now_ns() + _GONE_NS
        await node.until(lambda: self._interrupted_now(move) or node.demand != lowered.start_counts, gone_ns)
        if move.stopped_ns is None and self._trouble(move) and node.demand == lowered.start_counts:
            raise self._not_started(move, True)
        if taken_ns():
            # It does not say that it moves already.
            latest_ns = max(earliest_ns, min(latest_ns, taken_ns() + self._after_taking_ns))
        span = move.started = Span(earliest_ns, latest_ns, late_ns=self._options.beyond_ns(fired))
        if move.stopped_ns is None and move.ride is None:
            node.order(states.ENABLE)
        return dict.fromkeys(names, span)

    @property
    def _after_taking_ns(self) -> int:
        """From taking a set-point to the motion, at the most."""
        options = self._options
        return (options.cycle_us + options.start_us + options.start_spread_us) * NS_PER_US

    def _promised(self, written_ns: int) -> tuple[int, int]:
        """Where the start lies after the SYNC was handed over at `written_ns`."""
        options, bitrate = self._options, self._node.bus.bitrate
        least_us = max(0, options.start_us - options.start_spread_us)
        earliest_ns = written_ns + sync_ns(bitrate) // _SHORTEST_SYNC + least_us * NS_PER_US
        wire_ns = options.wire_jitter_us * NS_PER_US + full_frame_ns(bitrate) + sync_ns(bitrate)
        return earliest_ns, written_ns + wire_ns + self._after_taking_ns

    def _not_started(self, move: Move, said: bool) -> DriverFault:
        node = self._node
        if node.bus.off or move.left != node.left_bus:
            fault = bus_off(node.name).fault
            return DriverFault(fault.code, fault.text, fault.remedy)
        why = "has not taken its set-point with the SYNC" if not said else self._trouble(move) or "does not move"
        return DriverFault(
            "not-started",
            f"{node.name} {why}; it is {node.state.value}" + (f": {node.why()}" if node.emergencies else ""),
            "check the cable and both terminations; is another master on the bus?",
        )

    async def outcome(self) -> Outcome:
        """Wait until the axis is at its target by the drive's own word, or will not get there."""
        move, node, lowered = self._require(), self._node, self._require().lowered
        at_t0 = {name: Span(move.t0_ns, move.t0_ns) for name in lowered.durations_s}
        if lowered.target is None or move.started is None:
            await self._held(move)
            self._over(move)
            return (
                Outcome("done", at_t0) if move.stopped_ns is None else Outcome("stopped", at_t0, "stopped on request")
            )
        seconds = lowered.durations_s[lowered.axis]
        earliest_ns = move.started.earliest_ns + self._device_ns(seconds, -1) - self._between_ns(lowered)
        latest_ns = move.started.latest_ns + self._device_ns(seconds, 1) + self._between_ns(lowered)

        def arrived() -> bool:
            if move.ride is not None:
                return move.ride.arrived
            return (
                node.clock.now_ns() >= earliest_ns
                and bool(node.status & states.TARGET_REACHED)
                and node.demand == lowered.target
            )

        await node.until(lambda: self._interrupted_now(move), earliest_ns)
        overdue_ns = latest_ns + self._settle_ns + _OVERDUE_NS
        there = await node.until(lambda: arrived() or self._interrupted_now(move), overdue_ns)
        if move.stopped_ns is None and not self._interrupted_now(move) and there:
            await self._held(move)
        trouble = self._trouble(move)
        stopped = move.stopped_ns is not None
        if stopped:
            await self._power.stopped()
        self._over(move)
        now_ns = node.clock.now_ns()
        if not stopped and not trouble and there:
            if move.ride is not None and lowered.course is not None:
                earliest_ns, latest_ns = self._rode(move.ride, lowered.course.period_ns)
                await self._leave_stream()
            return Outcome("done", {lowered.axis: Span(min(earliest_ns, latest_ns), latest_ns)})
        spans = {lowered.axis: Span(min(move.started.earliest_ns, now_ns), now_ns)}
        stands = f"axis {lowered.axis} stands at {node.actual}, its target is {lowered.target}"
        if stopped:
            return Outcome("stopped", spans, f"stopped on request; {stands}")
        return Outcome("fault", spans, f"{node.name} {trouble or 'does not come to its end'}; {stands}")

    def _between_ns(self, lowered: CiaLowered) -> int:
        """A drive that was stopped may stand between two counts, and says the nearer one: its way is up to half a count
        longer or shorter than it was planned."""
        if lowered.shape is None:
            return 0
        counts_s = lowered.shape.velocity / float(self._options.velocity_units)
        return ceil(0.5 / counts_s * NS_PER_S)

    def _rode(self, ride: Ride, period_ns: int) -> tuple[int, int]:
        """Where the end lies: a period after its last SYNC had its effect."""
        earliest_ns, latest_ns = self._promised(ride.last_written_ns)
        if ride.last_heard_ns:
            latest_ns = max(earliest_ns, min(latest_ns, ride.last_heard_ns + self._after_taking_ns))
        period_s = period_ns / NS_PER_S
        return earliest_ns + self._device_ns(period_s, -1), latest_ns + self._device_ns(period_s, 1)

    async def _leave_stream(self) -> None:
        """A drive that follows positions needs SYNC; in profile position mode it rests without."""
        node = self._node
        node.order(states.ENABLE, o.PROFILE_POSITION_MODE)
        await node.soon(lambda: node.mode == o.PROFILE_POSITION_MODE)

    def _interrupted_now(self, move: Move) -> bool:
        return move.stopped_ns is not None or bool(self._trouble(move))

    def _trouble(self, move: Move) -> str:
        """What has befallen the drive since it was armed; empty: nothing."""
        node = self._node
        if node.boots != move.boots:
            return "was switched off and on"
        if node.bus.off or node.left_bus != move.left:
            return "could not be reached: this computer has left the bus (bus-off)"
        if node.state in (State.FAULT, State.REACTION):
            return f"has a fault: {node.why()}"
        if move.ride is not None and move.ride.trouble:
            return move.ride.trouble
        if move.lowered.target is not None and not node.enabled:
            return f"is {node.state.value}: was it switched off by its enable input, or stopped by another master?"
        if move.lowered.target is not None and node.status & states.INTERNAL_LIMIT:
            return "was stopped by a limit of its own (switch or software limit)"
        return ""

    # The driven line

    def _hold(self, move: Move) -> None:
        drive, node = move.lowered.drive, self._node
        assert drive is not None
        node.outputs = drive.switched(node.outputs, active=True)

        def over() -> None:
            if self.move is move:
                with suppress(LinkClosed):
                    self._passive(move)
                node.wake()

        move.release = node.clock.call_at_ns(move.t0_ns + move.lowered.window_ns[1] + drive.hold_ns, over)

    async def _held(self, move: Move) -> None:
        """Until the driven line is passive again."""
        if move.release is not None:
            await self._node.until(
                lambda: move.release is None or self._interrupted_now(move), self._node.clock.now_ns() + 2**62
            )

    # Inside

    def _over(self, move: Move) -> None:
        self._passive(move)
        self._starts.drop(self._node.number, move.shot)
        if self.move is move:
            self.move = None

    def _require(self) -> Move:
        if self.move is None:
            raise CannotDo("not-armed", "no step is loaded", "arm it")
        return self.move

    def _require_start(self, move: Move) -> None:
        node, lowered = self._node, move.lowered
        if not node.enabled:
            raise CannotDo("not-enabled", f"axis {lowered.axis} is not enabled", f"enable {lowered.axis} first")
        if node.demand != lowered.start_counts:
            raise CannotDo(
                "other-start",
                f"axis {lowered.axis} stands at {node.demand} counts; the plan starts at {lowered.start_counts}",
                "plan again from where it stands",
            )

    def _device_ns(self, seconds: float, sign: int) -> int:
        """A duration by the slowest (1) or quickest (-1) crystal."""
        exact = seconds * NS_PER_S * (1 + sign * self._options.clock_ppm * 1e-6)
        return ceil(exact) if sign > 0 else floor(exact)
