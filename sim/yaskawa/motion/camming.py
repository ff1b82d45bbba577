"""Slaves of the electronic cam: engaging, quitting, and how positions are told (L4585-L4640, L13736-L13771)."""

from math import inf
from typing import TYPE_CHECKING

from sim.yaskawa.base import fixed
from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.cam import CamPath

if TYPE_CHECKING:
    from sim.yaskawa.motion.control import MotionControl


class Camming:
    """Drives the axes in the mode `cam`. Instants are samples, positions counts."""

    def __init__(self, control: "MotionControl") -> None:
        self.control = control

    def master(self, at: float) -> float:
        """Unmodularised position of the cam's master."""
        name = self.control.cam.master
        if name is None:
            return 0.0
        axis = self.control.axes[name[-1]]
        if len(name) > 1:
            return float(axis.auxiliary)
        if axis.virtual:
            return axis.command(at)
        return axis.frozen if axis.frozen is not None else axis.command(at - axis.lag)

    def turns(self) -> int:
        """Whole cycles of the master up to now."""
        return self.control.cam.turns(self.master(self.control.timebase.sample()))

    def modularise(self, cycle: int) -> None:
        """The master axis is reported within its cycle (0: no more); an auxiliary encoder is not."""
        master = self.control.axes.get(self.control.cam.master or "")
        if master is None:
            return
        if self.control.figures.cycles_by_turns:
            master.turned = (lambda: cycle * self.turns()) if cycle else None
        else:
            master.modulus = cycle

    def engage(self, slave: Axis, at: int) -> None:
        """The slave follows the table from `at` on."""
        cam = self.control.cam
        slave.rest(at, slave.path.position(at))
        slave.path, slave.profile = CamPath(cam, slave.name, self.master), None
        slave.mode = "cam"
        cycle = cam.cycles.get(slave.name, 0)
        if self.control.figures.cycles_by_turns:
            slave.turned = lambda: cycle * self.turns()
        else:
            slave.modulus = cycle
        cam.followers.add(slave.name)
        master = self.control.axes.get(cam.master or "")
        if master is not None and master.moving:
            self.control.note_start(slave, at)

    def disengage(self, slave: Axis, at: int) -> None:
        """The slave stands where it is."""
        position = slave.reported(fixed.rounded(slave.path.position(at)))
        slave.rest(at, position)
        slave.modulus, slave.turned = 0, None
        self.control.cam.followers.discard(slave.name)
        self.control.note_end(slave, at)

    def poll(self, now: int) -> bool:
        """Let go those whose master has come to their place; whether there was one."""
        cam, changed = self.control.cam, False
        waiting = dict(cam.waiting)
        for (name, what), place in waiting.items():
            if what == "EQ" and (name, "EG") in waiting:
                continue
            before, here = (self.master(now - 1) - place, self.master(now) - place)
            cycle = cam.cycle or inf
            if before // cycle != here // cycle or here == 0 or (cycle == inf and (before < 0) != (here < 0)):
                del cam.waiting[name, what]
                changed = True
                (self.engage if what == "EG" else self.disengage)(self.control.axes[name], now)
        return changed
