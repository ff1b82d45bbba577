"""The control program of one unit: its switches, its program, its disk, and what is allowed when."""

import datetime
from collections.abc import Callable
from enum import Enum, auto
from typing import Protocol

from orchestrator.clock.base import NS_PER_US
from sim.ppsmc.axis import Axis
from sim.ppsmc.counter import Counter
from sim.ppsmc.disk import Disk
from sim.ppsmc.machine import Machine
from sim.ppsmc.options import Options
from sim.ppsmc.program import Memory
from sim.ppsmc.runner import Runner
from sim.ppsmc.settings import Settings

_CALENDAR_START = datetime.datetime(2012, 2, 1)
_DELIMITERS = ("", "\r", "\n", "\r\n")


class Client(Protocol):
    """Whoever sent a command: takes replies, and can be made to wait."""

    def say(self, text: str) -> None:
        """Send one reply; its delimiter is added."""
        ...

    def sleep(self, duration_ns: int) -> None:
        """Delay the client's next command (L2791)."""
        ...


class Restart(Enum):
    """What a command asks the unit to do once it is over."""

    RESET = auto()
    """To the power-on state, connections stay (L2652)."""
    REBOOT = auto()
    """The controller or its control program starts anew (L2598, L2680)."""
    SHUTDOWN = auto()
    """Off until the power comes again (L2765)."""


class ComPort:
    """The control COM port and the device on it (L4599-L4706)."""

    def __init__(self, replies: dict[str, str]) -> None:
        self._replies = replies
        self.open = False
        self.received = ""
        """What has come in, not yet read."""
        self.read = ""
        """What cc_read has read, for ?ccb."""

    def write(self, text: str) -> None:
        self.received += self._replies.get(text, "")


class Unit:
    """One unit, powered up. Commands and queries act upon it."""

    def __init__(self, machine: Machine, options: Options) -> None:
        self.machine = machine
        self.options = options
        self.counter = Counter(machine.time, options.counter_hz)
        self.memory = Memory(options.axes, options.msg_comma)
        self.runner = Runner(machine, self.memory, self.counter)
        self.disk = Disk([axis.settings.copy() for axis in machine.axes])
        self.com = ComPort(options.com_replies)
        self.restart_due: Restart | None = None
        self.buffers_due = False
        """The command buffers of the other connections are to be cleared (L1409)."""
        self._calendar_us = 0
        self._movers: dict[Axis, Client] = {}
        self.txdel = options.txdel
        self.stx = False
        self.echo = options.echo
        self.append_unit = False
        self.user_status = 0
        self.blocked = False
        self.local = True
        self.display = True
        self.sound = True
        self.second_page = False
        self.priority = 1
        machine.on_ended = self._axis_ended
        self.power_up()

    @property
    def modern(self) -> bool:
        """Whether the firmware is a later one than the manual's (decision 0)."""
        return self.options.firmware == "1.2"

    @property
    def version(self) -> str:
        return "smc 1.2.1093" if self.modern else "smc 1.1.165"

    @property
    def idle(self) -> bool:
        """No positioning, no program, no count."""
        return self.machine.still and not self.runner.running and not self.counter.counting

    def framed(self, text: str, serial: bool) -> bytes:
        """A reply as it goes out (L3108-L3112, L4720-L4723)."""
        if serial and self.stx:
            text = f"\x02{text}\x03"
        return (text + _DELIMITERS[self.txdel]).encode("latin-1", "replace")

    # Motion

    def moved_by(self, axis: Axis, client: Client) -> None:
        """Messages about the axis's motion go to `client`."""
        self._movers[axis] = client

    def _axis_ended(self, axis: Axis) -> None:
        client = self._movers.get(axis)
        if client is None:
            return
        number, text = axis.error
        if number and self.echo:
            client.say(f"error: axis {axis.number}: {number} {text}")
        elif self.echo > 1:
            client.say(f"status: axis {axis.number} ready")

    def stop_all(self) -> None:
        """q without an axis: programs, counts and motions end (L2546, L1465, L3832)."""
        self.runner.abort()
        if self.counter.counting:
            self.counter.stop()
        for axis in self.machine.axes:
            self.machine.stop(axis)

    def forget_client(self, client: Client) -> None:
        """Motions go on without the client that began them."""
        self._movers = {axis: other for axis, other in self._movers.items() if other is not client}

    # Configuration

    def apply(self, settings: list[Settings], names: tuple[str, ...] | None, axes: list[Axis]) -> None:
        """Take values (`names`, or all) of saved settings for `axes`."""
        for axis in axes:
            saved = settings[axis.number - 1]
            if names is None:
                axis.settings = saved.copy()
            else:
                axis.settings.take(saved, names)

    # Time of day

    @property
    def calendar(self) -> datetime.datetime:
        """The system clock; nothing but `?` shows it."""
        running_us = self.machine.time.now_ns() // NS_PER_US
        return _CALENDAR_START + datetime.timedelta(microseconds=running_us + self._calendar_us)

    def set_calendar(self, moment: datetime.datetime) -> None:
        self._calendar_us += (moment - self.calendar) // datetime.timedelta(microseconds=1)

    # Power

    def halt(self) -> None:
        """Stop everything dead."""
        self.runner.abort()
        self.counter.cancel()
        self.machine.halt()

    def power_up(self) -> None:
        """The power-on state: what was not saved is gone."""
        self.disk.start()
        self.machine.power_up()
        self.apply(self.disk.default, None, self.machine.axes)
        self.memory.clear()
        self.counter.clear()
        self.com = ComPort(self.options.com_replies)
        self._movers.clear()
        self.append_unit = self.disk.append_unit
        self.txdel, self.stx, self.echo = self.options.txdel, False, self.options.echo
        self.user_status = 0
        self.blocked = False
        self.local = self.display = self.sound = True
        self.second_page = False
        self.priority = 1
        self.runner.filter, self.runner.screen = 1, 0


Handler = Callable[[Unit, Client, str], None]
