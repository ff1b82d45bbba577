"""Slaves of the electronic cam: engaging, disengaging, and reported positions (L4585-L4640, L13736-L13771)."""

from math import inf

from sim.yaskawa.base import fixed
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.cam import CamPath
from sim.yaskawa.motion.services import MotionServices


class CamFollowers:
    """Drives the axes in the mode `cam`. Instants are samples, positions counts."""

    def __init__(self, control: MotionServices) -> None:
        self.control = control

    def master_position(self, at: float) -> float:
        """Return the unmodularised position of the cam's master."""
        name = self.control.cam.master
        if name is None:
            return 0.0
        axis = self.control.axes[name[-1]]
        if len(name) > 1:
            return float(axis.auxiliary)
        if axis.virtual:
            return axis.command_at(at)
        return axis.frozen if axis.frozen is not None else axis.command_at(at - axis.lag)

    def master_turns(self) -> int:
        """Return the whole cycles of the master up to now."""
        return self.control.cam.count_turns(self.master_position(self.control.timebase.current_sample()))

    def set_modulus(self, cycle: int) -> None:
        """Report the master axis within its cycle (0: no longer); not for an auxiliary encoder."""
        master = self.control.axes.get(self.control.cam.master or "")
        if master is None:
            return
        if self.control.figures.cycles_by_turns:
            master.turned = (lambda: cycle * self.master_turns()) if cycle else None
        else:
            master.modulus = cycle

    def engage_slave(self, slave: ServoAxis, at: int) -> None:
        """Make the slave follow the table from `at` on."""
        cam = self.control.cam
        slave.stand_at(at, slave.take_gear_share(at))
        slave.path, slave.profile = CamPath(cam, slave.name, self.master_position), None
        slave.mode = "cam"
        cycle = cam.cycles.get(slave.name, 0)
        if self.control.figures.cycles_by_turns:
            slave.turned = lambda: cycle * self.master_turns()
        else:
            slave.modulus = cycle
        cam.followers.add(slave.name)
        master = self.control.axes.get(cam.master or "")
        if master is not None and master.is_moving:
            self.control.record.note_start(slave, at)

    def disengage_slave(self, slave: ServoAxis, at: int) -> None:
        """Stop the slave at its present position."""
        position = slave.report_counts(fixed.round_half_up(slave.path.position(at)))
        slave.stand_at(at, position)
        slave.modulus, slave.turned = 0, None
        self.control.cam.followers.discard(slave.name)
        self.control.record.note_end(slave, at)

    def poll_waiting(self, now: int) -> bool:
        """Engage and disengage the slaves whose master has reached their position; return whether there was one."""
        cam, has_changed = self.control.cam, False
        waits = dict(cam.waiting)
        for (name, op), position in waits.items():
            if op == "EQ" and (name, "EG") in waits:
                continue
            distance_before, distance = (self.master_position(now - 1) - position, self.master_position(now) - position)
            cycle = cam.effective_cycle or inf
            if (
                distance_before // cycle != distance // cycle
                or distance == 0
                or (cycle == inf and (distance_before < 0) != (distance < 0))
            ):
                del cam.waiting[name, op]
                has_changed = True
                (self.engage_slave if op == "EG" else self.disengage_slave)(self.control.axes[name], now)
        return has_changed
