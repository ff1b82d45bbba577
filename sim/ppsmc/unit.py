"""Control program of one controller: its switches, its program, its disk, and its permissions."""

import datetime
from collections.abc import Callable
from enum import Enum, auto
from typing import Protocol

from orchestrator.clock.base import NS_PER_US
from sim.ppsmc.axis import StepperAxis
from sim.ppsmc.counter import PulseCounter
from sim.ppsmc.disk import HardDisk
from sim.ppsmc.machine import StepperHardware
from sim.ppsmc.options import PpsmcOptions
from sim.ppsmc.program import ProgramMemory
from sim.ppsmc.runner import ProgramRunner
from sim.ppsmc.settings import AxisSettings

_CALENDAR_START = datetime.datetime(2012, 2, 1)
_DELIMITERS = ("", "\r", "\n", "\r\n")


class CommandClient(Protocol):
    """Sender of a command: receives replies, and can be delayed."""

    def send_reply(self, text: str) -> None:
        """Send one reply; its delimiter is added."""
        ...

    def delay_next(self, duration_ns: int) -> None:
        """Delay the client's next command (L2791)."""
        ...


class RestartKind(Enum):
    """Restart that a command requests, done after it ends."""

    RESET = auto()
    """To the power-on state, connections stay (L2652)."""
    REBOOT = auto()
    """Restart of the controller or its control program (L2598, L2680)."""
    SHUTDOWN = auto()
    """Off until the next power-up (L2765)."""


class ComPort:
    """The control COM port and the device on it (L4599-L4706)."""

    def __init__(self, replies: dict[str, str]) -> None:
        self._replies = replies
        self.open = False
        self.received = ""
        """Received characters, not yet read."""
        self.read = ""
        """Characters that cc_read has read, for ?ccb."""

    def write_text(self, text: str) -> None:
        self.received += self._replies.get(text, "")


class ControlProgram:
    """One powered-up controller. Commands and queries act on it."""

    def __init__(self, machine: StepperHardware, options: PpsmcOptions) -> None:
        self.machine = machine
        self.options = options
        self.counter = PulseCounter(machine.time, options.counter_hz)
        self.memory = ProgramMemory(options.axes, options.msg_comma)
        self.runner = ProgramRunner(machine, self.memory, self.counter)
        self.disk = HardDisk([axis.settings.copy_settings() for axis in machine.axes])
        self.com = ComPort(options.com_replies)
        self.restart_due: RestartKind | None = None
        self.buffers_due = False
        """The command buffers of the other connections are to be cleared (L1409)."""
        self._calendar_us = 0
        self._movers: dict[StepperAxis, CommandClient] = {}
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
        machine.on_ended = self._handle_axis_end
        self.power_up()

    @property
    def is_modern(self) -> bool:
        """Return whether the firmware is later than the manual's (decision 0)."""
        return self.options.firmware == "1.2"

    @property
    def firmware_version(self) -> str:
        return "smc 1.2.1093" if self.is_modern else "smc 1.1.165"

    @property
    def is_idle(self) -> bool:
        """Return whether no positioning, no program and no count runs."""
        return self.machine.is_still and not self.runner.is_running and not self.counter.is_counting

    def frame_reply(self, text: str, *, serial: bool) -> bytes:
        """Encode a reply for transmission (L3108-L3112, L4720-L4723)."""
        if serial and self.stx:
            text = f"\x02{text}\x03"
        return (text + _DELIMITERS[self.txdel]).encode("latin-1", "replace")

    # Motion

    def send_messages_to(self, axis: StepperAxis, client: CommandClient) -> None:
        """Send messages about the axis's motion to `client`."""
        self._movers[axis] = client

    def _handle_axis_end(self, axis: StepperAxis) -> None:
        client = self._movers.get(axis)
        if client is None:
            return
        number, text = axis.error
        if number and self.echo:
            client.send_reply(f"error: axis {axis.number}: {number} {text}")
        elif self.echo > 1:
            client.send_reply(f"status: axis {axis.number} ready")

    def stop_all(self) -> None:
        """q without an axis: end programs, counts and motions (L2546, L1465, L3832)."""
        self.runner.abort_program()
        if self.counter.is_counting:
            self.counter.stop_count()
        for axis in self.machine.axes:
            self.machine.stop_axis(axis)

    def forget_client(self, client: CommandClient) -> None:
        """Continue motions without the client that began them."""
        self._movers = {axis: other_mover for axis, other_mover in self._movers.items() if other_mover is not client}

    # Configuration

    def apply_settings(
        self, settings: list[AxisSettings], names: tuple[str, ...] | None, axes: list[StepperAxis]
    ) -> None:
        """Apply values (`names`, or all) of saved settings to `axes`."""
        for axis in axes:
            saved_setting = settings[axis.number - 1]
            if names is None:
                axis.settings = saved_setting.copy_settings()
            else:
                axis.settings.take_values(saved_setting, names)

    # Time of day

    @property
    def system_clock(self) -> datetime.datetime:
        """The system clock; only `?` shows it."""
        running_us = self.machine.time.now_ns() // NS_PER_US
        return _CALENDAR_START + datetime.timedelta(microseconds=running_us + self._calendar_us)

    def set_system_clock(self, moment: datetime.datetime) -> None:
        self._calendar_us += (moment - self.system_clock) // datetime.timedelta(microseconds=1)

    # Power

    def halt_all(self) -> None:
        """Stop everything dead."""
        self.runner.abort_program()
        self.counter.cancel_count()
        self.machine.halt_axes()

    def power_up(self) -> None:
        """Enter the power-on state: unsaved state is lost."""
        self.disk.start_system()
        self.machine.power_up()
        self.apply_settings(self.disk.default, None, self.machine.axes)
        self.memory.clear_program()
        self.counter.clear_memory()
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


Handler = Callable[[ControlProgram, CommandClient, str], None]
