"""Running the coordinate systems: what their sequences do to the axes (L13004-L13033)."""

from typing import TYPE_CHECKING

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.sequence import SequencePath, System

if TYPE_CHECKING:
    from sim.yaskawa.motion.control import MotionControl

RUNNING_CODE, DONE_CODE = 100, 101


class Coordinated:
    """Begins, ends and stops sequences of systems S and T."""

    def __init__(self, control: "MotionControl") -> None:
        self.control = control

    def members(self, system: System) -> list[Axis]:
        """The axes that a sequence moves, the tangent axis last."""
        names = (*system.axes, system.tangent) if system.tangent else system.axes
        return [self.control.axes[name] for name in names]

    def check(self, system: System, now: int) -> None:
        """Refuse a `BG` that cannot be (20, 21, 22, 24)."""
        if system.running:
            raise CommandError(21)
        if not system.segments:
            raise CommandError(24)
        for axis in self.members(system):
            if axis.motor_off:
                raise CommandError(20)
            if axis.moving:
                raise CommandError(21)
        ahead = system.segments[0].point(min(1.0, system.segments[0].length))
        for axis, start, near in zip(self.members(system), system.segments[0].start, ahead, strict=False):
            if near != start and self.control.blocked(axis, near > start, now):
                raise CommandError(22)

    def begin(self, system: System, at: int) -> None:
        """`BGS`, `BGT`."""
        members = self.members(system)
        origin = tuple(self.control.axes[name].path.position(at) for name in system.axes)
        system.begin(at, origin)
        for index, axis in enumerate(members):
            axis.move_start = axis.reference(at)
            axis.mark = axis.command(at)
            axis.path, axis.profile = SequencePath(system, index if index < len(system.axes) else -1), None
            axis.mode, axis.stopping = "sequence", False
            axis.stop_code, axis.ending_code = RUNNING_CODE, DONE_CODE
        for axis in members:
            self.control.note_start(axis, at)

    def stop(self, member: Axis, at: int, code: int) -> None:
        """The whole sequence decelerates (D37)."""
        system = self.system_of(member)
        if system is not None and not system.stopping:
            system.stop(at)
            for axis in self.members(system):
                axis.ending_code = code

    def system_of(self, member: Axis) -> System | None:
        path = member.path
        return path.system if isinstance(path, SequencePath) else None

    def finish(self, system: System, at: int) -> None:
        """The path has been travelled, or the stop along it is done."""
        for axis in self.members(system):
            axis.rest(at, fixed.rounded(axis.path.position(at)))
            axis.stop_code = axis.ending_code
            self.control.note_end(axis, at)
        self.close(system)

    def drop(self, member: str, at: int) -> None:
        """One axis of a sequence is stopped dead: so are the others (L2191)."""
        for system in self.control.systems.values():
            axes = self.members(system)
            if system.running and any(axis.name == member for axis in axes):
                for axis in axes:
                    if axis.name != member:
                        axis.rest(at, fixed.rounded(axis.path.position(at)))
                        axis.stop_code = 7
                        self.control.note_end(axis, at)
                self.close(system)

    def close(self, system: System) -> None:
        """Empty the queue, keep what the status operands tell."""
        system.last_index = system.index(self.control.timebase.sample())
        system.running = system.stopping = False
        travelled = system.profile
        system.clear()
        system.profile = travelled
