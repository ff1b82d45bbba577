"""All motion of one controller: starting, stopping, ending it at its exact samples, and the truth about it."""

from collections.abc import Callable
from math import inf

from sim.core.controller import LimitSwitch, Motion
from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.model import Figures
from sim.yaskawa.base.timebase import NEVER_NS, Timebase
from sim.yaskawa.base.world import World
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.cam import Cam
from sim.yaskawa.motion.camming import Camming
from sim.yaskawa.motion.contour import Contour, Record
from sim.yaskawa.motion.coordinated import Coordinated
from sim.yaskawa.motion.homing import Homing
from sim.yaskawa.motion.profile import Profile, first_sample, plan_jog, plan_move, plan_stop
from sim.yaskawa.motion.sequence import System

FORWARD_CODE, REVERSE_CODE, STOP_CODE, ABORT_INPUT_CODE, ABORT_CODE, ERROR_CODE = 2, 3, 4, 6, 7, 8
SELECTIVE_CODE = 11
"""Stopped by the selective abort of `CN` (L9860)."""
LATCH_CODE, LATCH_OVERRUN_CODE, LATCH_SHORT_CODE = 40, 41, 42
"""At the target of LT, stopped on the way to it, or too near to stop (L7151-L7159)."""
NO_FORWARD, NO_REVERSE = 2147483647, -2147483648


class MotionControl:
    """Axes, coordinate systems, contour and cam. Instants are samples; `now` is the sample that runs."""

    def __init__(
        self,
        timebase: Timebase,
        world: World,
        letters: str,
        figures: Figures,
        on_limit: Callable[[], None],
        on_error: Callable[[], None],
    ) -> None:
        self.timebase = timebase
        self.figures = figures
        self.world = world
        self.on_limit = on_limit
        self.on_error = on_error
        self.axes: dict[str, Axis] = {name: Axis(name, index, figures.lag) for index, name in enumerate(letters)}
        self.real = tuple(self.axes.values())
        if figures.virtual_axis:
            self.axes["N"] = Axis("N", len(letters), figures.lag)
            self.axes["N"].motor_off, self.axes["N"].frozen = False, None
        self._all = tuple(self.axes.values())
        self.systems = {name: System(name, figures.vector) for name in figures.systems}
        self.contour: Contour | None = None
        self.contour_interval = 0
        self.contour_late = False
        self.cam = Cam(figures.cam_points)
        self.motions: list[Motion] = []
        self.homing = Homing(self, figures.home_speed)
        self.coordinated = Coordinated(self)
        self.camming = Camming(self)
        self.abort_input = False

    # What moves

    def all_axes(self) -> tuple[Axis, ...]:
        return self._all

    def active(self) -> bool:
        """Whether anything is commanded to move."""
        return any(axis.mode and axis.mode != "cam" for axis in self._all)

    def due(self) -> float:
        """The next sample at which something happens by itself."""
        # Asked at each command: mostly nothing moves, and that is to be known at once.
        due = inf
        at_rest = True
        for axis in self._all:
            if axis.end < due:
                due = axis.end
            if axis.watch < due:
                due = axis.watch
            if axis.mode or axis.gear.on:
                at_rest = False
        for system in self.systems.values():
            if system.running:
                due = min(due, system.end())
        if self.contour is not None:
            due = min(due, self.contour.end)
        if not at_rest and self._polled():
            due = min(due, self.timebase.sample() + 1)
        return due

    def _polled(self) -> bool:
        """Whether limits or cams have to be looked at in every sample."""
        moving = geared = False
        for axis in self._all:
            geared = geared or axis.gear.on
            if not axis.mode or axis.mode == "cam":
                continue
            if self.cam.waiting:
                return True
            moving = True
            if axis.virtual:
                continue
            if axis.mode in ("sequence", "contour") and self._bounded(axis):
                return True
            if axis.frozen is not None and self._error_limit(axis):
                return True
        return moving and geared and any(axis.gear.on and self._bounded(axis) for axis in self.real)

    def _bounded(self, axis: Axis) -> bool:
        return (
            axis.registers["FL"] != fixed.whole(NO_FORWARD)
            or axis.registers["BL"] != fixed.whole(NO_REVERSE)
            or axis.name in self.world.travel
            or self.world.limits.get(axis.name, "none") != "none"
        )

    def _error_limit(self, axis: Axis) -> int:
        return fixed.truncated(axis.registers["ER"])

    # Independent motion

    def begin(self, axes: list[Axis], at: int) -> None:
        """`BG` on axes that have been checked: all start at the same sample."""
        for axis in axes:
            self._start(axis, at)

    def _start(self, axis: Axis, at: int) -> None:
        origin = axis.path.position(at)
        axis.profile = Profile(at, origin, axis.registers["IT"] / fixed.ONE)
        axis.path = axis.profile
        axis.stopping, axis.ending_code, axis.stop_code = False, 1, 0
        axis.move_start = axis.reference(at)
        axis.mark = axis.command(at)
        if axis.armed in ("HM", "FE", "FI"):
            self.homing.start(axis, at)
        elif axis.armed == "JG":
            axis.mode = "jog"
            self.plan(axis, at)
        else:
            axis.mode = "move"
            step = fixed.truncated(axis.registers["PR"])
            axis.target = origin + step if axis.armed == "PR" else fixed.truncated(axis.registers["PA"])
            self.plan(axis, at)
        self.note_start(axis, at)

    def plan(self, axis: Axis, at: int) -> None:
        """Lay the profile anew from the state at `at` with the registers as they are now."""
        profile = axis.profile
        if profile is None or not axis.moving:
            return
        up, down = axis.acceleration("AC"), axis.acceleration("DC")
        if axis.stopping:
            plan_stop(profile, at, down)
        elif axis.mode == "move":
            plan_move(profile, at, axis.target, axis.speed("SP"), up, down)
        elif axis.mode == "jog":
            plan_jog(profile, at, axis.speed("JG"), up, down)
        else:
            self.homing.plan(axis, profile, at)
        self.schedule(axis, at)

    def schedule(self, axis: Axis, at: int) -> None:
        """Find when the profile ends and when it meets a limit."""
        profile = axis.profile
        if profile is None:
            return
        axis.end = profile.last_sample()
        axis.watch, axis.watch_code = self.homing.watch(axis, profile, at)
        if axis.virtual or axis.stopping:
            return
        forward = self._direction(axis, at) > 0
        for threshold in self._thresholds(axis, forward):
            sample = first_sample(profile, at, threshold - axis.gear.position(at), forward)
            if sample < axis.watch:
                axis.watch, axis.watch_code = sample, FORWARD_CODE if forward else REVERSE_CODE

    def _direction(self, axis: Axis, at: int) -> int:
        if axis.mode == "move":
            return 1 if axis.target >= axis.path.position(at) else -1
        velocity = axis.path.velocity(at + 1)
        return 1 if velocity > 0 or (velocity == 0 and axis.registers["JG"] >= 0) else -1

    def _thresholds(self, axis: Axis, forward: bool) -> list[int]:
        limit = fixed.truncated(axis.registers["FL" if forward else "BL"])
        found = [limit + 1 if forward else limit - 1] if limit != (NO_FORWARD if forward else NO_REVERSE) else []
        travel = self.world.travel.get(axis.name)
        if travel is not None and axis.name not in self.world.limits:
            found.append(travel[1 if forward else 0] + axis.physical_zero)
        return found

    def limit_active(self, axis: Axis, forward: bool, now: int) -> bool:
        """Whether the limit switch is pressed."""
        if axis.virtual:
            return False
        pressed: LimitSwitch | None = self.world.limits.get(axis.name)
        if pressed is not None:
            return pressed in ("both", "forward" if forward else "reverse")
        travel = self.world.travel.get(axis.name)
        if travel is None:
            return False
        place = axis.physical(now + 1)
        return place >= travel[1] if forward else place <= travel[0]

    def blocked(self, axis: Axis, forward: bool, now: int) -> bool:
        """Whether a limit switch or a software limit forbids to move that way."""
        place = axis.reference(now)
        limit = fixed.truncated(axis.registers["FL" if forward else "BL"])
        return self.limit_active(axis, forward, now) or (place > limit if forward else place < limit)

    # Stopping

    def stop(self, axis: Axis, at: int, code: int = STOP_CODE) -> None:
        """Decelerate an axis, whatever it does (L10124)."""
        if axis.mode == "sequence":
            self.coordinated.stop(axis, at, code)
            return
        if axis.gear.engaged and not axis.gear.gantry:
            if self._follows(axis) and code in (FORWARD_CODE, REVERSE_CODE):
                axis.stop_code = code
            axis.registers["GR"] = 0
            self.set_gear_ratio(axis, 0.0, at)
        if axis.mode == "contour":
            self._stop_contour(at, code)
        elif axis.mode == "cam":
            self.camming.disengage(axis, at)
        elif axis.moving and not axis.stopping:
            axis.stopping = True
            axis.ending_code = LATCH_OVERRUN_CODE if axis.ending_code == LATCH_CODE else code
            self._note_slowing(axis, at)
            self.plan(axis, at)

    def _follows(self, axis: Axis) -> bool:
        """Whether it is moved by gearing alone, which a limit ends (L5543)."""
        return axis.gear.engaged and not axis.gear.gantry and not axis.moving

    def _stop_contour(self, at: int, code: int) -> None:
        if self.contour is not None and code == STOP_CODE and self.figures.contour_stops_at_record:
            self.contour.waiting = Record((0,) * len(self.contour.axes), 0)
            if not self.contour.executing:
                self.leave_contour(at)
            return
        contour, self.contour = self.contour, None
        if contour is None:
            return
        for index, name in enumerate(contour.axes):
            axis = self.axes[name]
            velocity = contour.velocity(index, at)
            profile = Profile(at, contour.position(index, at), 1.0, velocity)
            axis.profile = axis.path = profile
            axis.mode, axis.stopping, axis.ending_code = "move", True, code
            if axis.motion is None:
                self.note_start(axis, at)
            self._note_slowing(axis, at)
            plan_stop(profile, at, axis.acceleration("DC"))
            profile.land(fixed.rounded(profile.end_position))
            self.schedule(axis, at)

    def freeze(self, at: int, code: int, axes: tuple[Axis, ...] | None = None) -> None:
        """Stop the profiler dead (L2191); sequences and the contour with it."""
        for axis in axes if axes is not None else self.all_axes():
            if not axis.moving and axis.mode != "cam" and not axis.gear.engaged:
                continue
            here = axis.path.position(at)
            if axis.mode == "sequence":
                self.coordinated.drop(axis.name, at)
            if axis.mode == "contour":
                self.contour = None
            was_moving = axis.moving
            axis.rest(at, fixed.rounded(here))
            if was_moving:
                axis.stop_code = code
            self._note_slowing(axis, at)
            self.note_end(axis, at)
        for system in self.systems.values():
            if system.running and all(self.axes[name].mode != "sequence" for name in system.axes):
                self.coordinated.close(system)

    def look_at_limits(self, at: int) -> None:
        """A limit switch has changed."""
        for axis in self.real:
            if (not axis.moving and not self._follows(axis)) or axis.stopping:
                continue
            velocity = axis.command_velocity(at) or axis.command_velocity(at + 1)
            if velocity and self.limit_active(axis, velocity > 0, at):
                self.stop(axis, at, FORWARD_CODE if velocity > 0 else REVERSE_CODE)
                self.on_limit()
            elif axis.profile is not None and axis.watch > at:
                # What it comes to in this very sample is met first: from behind it, it would be looked for in vain.
                self.schedule(axis, at)

    def latch(self, axis: Axis, now: int) -> None:
        """A latch input has captured the position (L2541); LT stops the axis behind it (L7138)."""
        axis.latch_armed, axis.latch_used = False, True
        axis.latched = axis.actual(now)
        distance = fixed.truncated(axis.registers["LT"])
        profile = axis.profile
        if distance in (0, NO_FORWARD) or profile is None or axis.mode not in ("move", "jog") or axis.stopping:
            return
        at = self.timebase.next_sample()
        rate, down = profile.velocity(at), axis.acceleration("DC")
        target = axis.latched + (abs(distance) if rate >= 0 else -abs(distance))
        if rate * rate / (2 * down) > abs(target - profile.position(at)):
            axis.stopping, axis.ending_code = True, LATCH_SHORT_CODE
            self.plan(axis, at)
            return
        axis.mode, axis.target, axis.ending_code = "move", float(target), LATCH_CODE
        plan_move(profile, at, axis.target, abs(rate), axis.acceleration("AC"), down)
        self.schedule(axis, at)

    # What happens by itself

    def settle(self, now: int) -> bool:
        """Bring everything up to sample `now`; whether anything has changed."""
        changed = False
        for axis in self._all:
            while axis.watch <= now or axis.end <= now:
                changed = True
                if axis.watch < axis.end and axis.watch <= now:
                    self._met(axis, int(axis.watch))
                else:
                    self._finish(axis, int(axis.end))
        for system in self.systems.values():
            if system.running and system.end() <= now:
                changed = True
                self.coordinated.finish(system, int(system.end()))
        while self.contour is not None and self.contour.end <= now:
            changed = True
            self._next_record(self.contour, int(self.contour.end))
        if self._polled():
            changed = self._poll(now) or changed
        return changed

    def _met(self, axis: Axis, at: int) -> None:
        axis.watch = inf
        if axis.watch_code in (FORWARD_CODE, REVERSE_CODE):
            self.stop(axis, at, axis.watch_code)
            self.on_limit()
        else:
            self.homing.reached(axis, at)

    def _finish(self, axis: Axis, at: int) -> None:
        profile = axis.profile
        if axis.mode == "home" and not axis.stopping and profile is not None:
            self.homing.reached(axis, at)
            return
        axis.end = axis.watch = inf
        axis.mode, axis.stopping = "", False
        axis.stop_code = axis.ending_code
        if profile is not None:
            whole = fixed.rounded(profile.end_position)
            if whole != profile.end_position:
                profile.land(whole)
        self.note_end(axis, at)

    def _next_record(self, contour: Contour, at: int) -> None:
        contour.end = inf
        record, contour.waiting = contour.waiting, None
        if record is None:
            self.contour_late = True
        elif record.samples:
            contour.execute(record, at)
        else:
            self.leave_contour(at)

    def leave_contour(self, at: int, code: int = 51) -> None:
        """Contouring is over (D18)."""
        contour, self.contour = self.contour, None
        if contour is None:
            return
        for index, name in enumerate(contour.axes):
            axis = self.axes[name]
            moved = axis.mode == "contour"
            axis.rest(at, fixed.rounded(contour.position(index, at)))
            if moved:
                axis.stop_code = code
                last = contour.changed[index]
                self.note_end(axis, last if last is not None and last <= at else contour.started or at)

    def _poll(self, now: int) -> bool:
        changed = False
        for axis in self.real:
            running = axis.mode in ("sequence", "contour", "move", "jog") and not axis.stopping
            if (running or self._follows(axis)) and self._bounded(axis):
                velocity = axis.command_velocity(now)
                if velocity and self.blocked(axis, velocity > 0, now):
                    self.stop(axis, now, FORWARD_CODE if velocity > 0 else REVERSE_CODE)
                    self.on_limit()
                    changed = True
            if axis.frozen is not None and axis.registers["OE"] and not axis.motor_off:
                limit = self._error_limit(axis)
                if limit and abs(axis.error(now)) > limit:
                    self.off_on_error(axis, now)
                    changed = True
        return self.camming.poll(now) or changed

    def off_on_error(self, axis: Axis, now: int) -> None:
        """`OE`: the amplifier goes off, the motion of the axis ends there (D47)."""
        self.freeze(now, ERROR_CODE, (axis,))
        axis.stop_code = ERROR_CODE
        axis.off_on_error = True
        self.on_error()
        self.motor_off(axis, now)

    def motor_off(self, axis: Axis, now: int) -> None:
        axis.freeze(now)
        axis.motor_off = True

    def motor_on(self, axis: Axis, now: int) -> None:
        """`SH`: command := actual, servo on (L9924)."""
        axis.motor_off = axis.off_on_error = False
        actual = axis.actual(now)
        if actual != axis.reference(now):
            axis.rest(now, actual - axis.gear.position(now))
        axis.thaw()

    # Contour

    def enter_contour(self, axes: tuple[str, ...], now: int) -> None:
        """`CM`."""
        for name in axes:
            if self.axes[name].moving and self.axes[name].mode != "contour":
                raise CommandError(7)
        if self.contour is not None:
            if self.contour.executing:
                raise CommandError(7)
            self.leave_contour(now)
        positions = tuple(self.axes[name].path.position(now) for name in axes)
        self.contour = Contour(axes, now, positions)

    # Gearing

    def set_gear_ratio(self, axis: Axis, ratio: float, at: int) -> None:
        """`GR`: takes effect at once; a slave of a moving master begins or ends its motion."""
        axis.gear.set_ratio(ratio, at)
        follows = any(axis in self._followers(master) for master in self.all_axes() if master.moving)
        if follows:
            self.note_start(axis, at)
        elif axis.motion is not None and not axis.moving:
            self.note_end(axis, at)

    # The truth

    def note_start(self, axis: Axis, at: int) -> None:
        """A commanded motion begins, and that of everything geared to the axis."""
        for follower in (axis, *self._followers(axis)):
            if follower.motion is None:
                start_ns = self.timebase.true_ns(at)
                follower.motion = Motion(follower.name, start_ns, follower.command(at))
                self.motions.append(follower.motion)

    def samples_again(self) -> None:
        """The sample clock has come: what was begun without one starts at its next sample."""
        for axis in self.real:
            if axis.motion is not None and axis.motion.start_ns == NEVER_NS:
                axis.motion.start_ns = self.timebase.true_ns(self.timebase.sample() + 1)

    def _note_slowing(self, axis: Axis, at: int) -> None:
        """A stop takes effect at sample `at`."""
        if axis.motion is not None and axis.motion.slowing_ns is None:
            axis.motion.slowing_ns = self.timebase.true_ns(at)

    def note_end(self, axis: Axis, at: int) -> None:
        """The last commanded change was at sample `at`."""
        for follower in (axis, *self._followers(axis)):
            motion = follower.motion
            if motion is not None and (follower is axis or not follower.moving):
                motion.end_ns = self.timebase.true_ns(at)
                motion.end_counts = follower.command(at)
                follower.motion = None

    def _followers(self, master: Axis) -> list[Axis]:
        return [
            axis
            for axis in self.real
            if axis is not master
            and (
                (axis.gear.engaged and axis.gear.source.removeprefix("C") == master.name)
                or (axis.mode == "cam" and self.cam.master == master.name)
            )
        ]
