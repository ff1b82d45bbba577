"""Execution of the coordinate systems: effect of their sequences on the axes (L13004-L13033)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.sequence import CoordinateSystem, SequencePath
from sim.yaskawa.motion.services import MotionServices

RUNNING_CODE, DONE_CODE = 100, 101


class CoordinatedMotion:
    """Begins, ends and stops sequences of systems S and T."""

    def __init__(self, control: MotionServices) -> None:
        self.control = control

    def member_axes(self, system: CoordinateSystem) -> list[ServoAxis]:
        """Return the axes that a sequence moves, the tangent axis last."""
        names = (*system.axes, system.tangent) if system.tangent else system.axes
        return [self.control.axes[name] for name in names]

    def check_begin(self, system: CoordinateSystem, now: int) -> None:
        """Refuse an invalid `BG` (20, 21, 22, 24)."""
        if system.running:
            raise CommandError(21)
        if not system.segments:
            raise CommandError(24)
        for axis in self.member_axes(system):
            if axis.motor_off:
                raise CommandError(20)
            if axis.is_moving:
                raise CommandError(21)
        point_ahead = system.segments[0].point_at(min(1.0, system.segments[0].length))
        for axis, start, next_position in zip(
            self.member_axes(system), system.segments[0].start, point_ahead, strict=False
        ):
            if next_position != start and self.control.limits.is_blocked(axis, forward=next_position > start, now=now):
                raise CommandError(22)

    def begin_sequence(self, system: CoordinateSystem, at: int) -> None:
        """`BGS`, `BGT`."""
        members = self.member_axes(system)
        origin = tuple(self.control.axes[name].path.position(at) for name in system.axes)
        system.begin_path(at, origin)
        for index, axis in enumerate(members):
            axis.move_start = axis.reference_at(at)
            axis.mark = axis.command_at(at)
            axis.path, axis.profile = SequencePath(system, index if index < len(system.axes) else -1), None
            axis.mode, axis.stopping = "sequence", False
            axis.stop_code, axis.ending_code = RUNNING_CODE, DONE_CODE
        for axis in members:
            self.control.record.note_start(axis, at)

    def stop_sequence(self, member: ServoAxis, at: int, code: int) -> None:
        """Decelerate the whole sequence (D37)."""
        system = self.find_system(member)
        if system is not None and not system.stopping:
            system.stop_path(at)
            for axis in self.member_axes(system):
                axis.ending_code = code

    def find_system(self, member: ServoAxis) -> CoordinateSystem | None:
        path = member.path
        return path.system if isinstance(path, SequencePath) else None

    def finish_sequence(self, system: CoordinateSystem, at: int) -> None:
        """Finish: the path has been travelled, or the stop along it is complete."""
        for axis in self.member_axes(system):
            axis.stand_at(at, fixed.round_half_up(axis.path.position(at)))
            axis.stop_code = axis.ending_code
            self.control.record.note_end(axis, at)
        self.close_sequence(system)

    def drop_member(self, member: str, at: int) -> None:
        """Stop all axes of a sequence dead after one of them was stopped dead (L2191)."""
        for system in self.control.systems.values():
            axes = self.member_axes(system)
            if system.running and any(axis.name == member for axis in axes):
                for axis in axes:
                    if axis.name != member:
                        axis.stand_at(at, fixed.round_half_up(axis.path.position(at)))
                        axis.stop_code = 7
                        self.control.record.note_end(axis, at)
                self.close_sequence(system)

    def close_sequence(self, system: CoordinateSystem) -> None:
        """Empty the queue, keep the values of the status operands."""
        system.last_index = system.segment_index(self.control.timebase.current_sample())
        system.running = system.stopping = False
        profile = system.profile
        system.clear_queue()
        system.profile = profile
