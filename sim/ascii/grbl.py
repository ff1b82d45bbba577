"""A simulated GRBL 1.1, read from its wiki and its source (https://github.com/gnea/grbl, v1.1): protocol.c, system.c,
gcode.c, motion_control.c, limits.c, report.c.

Counts are steps from the position that the controller has after homing: the register is then zero at the reference.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import sqrt

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.errors import TuttiError
from sim.core.controller import LimitSwitch
from sim.core.lines import LineController, LineDevice, LineFirmware

GREETING = "\r\nGrbl 1.1h ['$' for help]\r\n"
RX_BYTES = 128  # serial.h: RX_BUFFER_SIZE
AXES = ("X", "Y", "Z")
# defaults.h: generic machine.
DEFAULTS: Mapping[int, float] = {
    0: 10, 1: 25, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.010, 12: 0.002, 13: 0, 20: 0, 21: 0, 22: 0, 23: 0,
    24: 25.0, 25: 500.0, 26: 250, 27: 1.0, 30: 1000, 31: 0, 32: 0,
    100: 250.0, 101: 250.0, 102: 250.0, 110: 500.0, 111: 500.0, 112: 500.0,
    120: 10.0, 121: 10.0, 122: 10.0, 130: 200.0, 131: 200.0, 132: 200.0,
}  # fmt: skip
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_GCODES = {"G0", "G1", "G17", "G21", "G53", "G54", "G90", "G94"}  # of the blocks that move here; others are refused


class _LineRefused(TuttiError):
    """A line that is answered `error:` with a number (report.h)."""

    def __init__(self, number: int) -> None:
        super().__init__(str(number))
        self.number = number


@dataclass(frozen=True, slots=True)
class GrblMachine:
    """What surrounds the controller. switch_counts: by motor, steps from power-up. search_speed: mm/s."""

    switch_counts: Mapping[str, int]
    search_speed: float
    startup_ms: int


class GrblController(LineController):
    """One GRBL with three axes."""

    def __init__(self, device: LineDevice, settings: Mapping[int, float], machine: GrblMachine) -> None:
        super().__init__(AXES, device)
        self.firmware = LineFirmware(startup_ms=machine.startup_ms, longest_line=RX_BYTES)
        self.settings = {**DEFAULTS, **settings}
        self._machine = machine
        self._state = "Alarm" if self.settings[22] else "Idle"  # main.c: HOMING_INIT_LOCK
        self._is_suspended = False
        self._motion = ""
        self._tool = 0
        self._planned: list[tuple[dict[str, float], float]] = []
        self._homing_reply: Callable[[str], None] | None = None
        self._generation = 0
        for axis in self.axes.values():
            axis.set_position(self._home_steps(axis.name))

    def _steps_per_mm(self, axis: str) -> float:
        return self.settings[100 + AXES.index(axis)]

    def _home_steps(self, axis: str) -> float:
        """Counts of machine position 0: the reference has minus the pull-off (limits.c: limits_go_home)."""
        return round(self.settings[27] * self._steps_per_mm(axis))

    def _to_mm(self, axis: str, counts: float) -> float:
        return round(counts - self._home_steps(axis)) / self._steps_per_mm(axis)

    # Power and reset

    def reset_volatile(self) -> None:
        self._reset("Alarm" if self.settings[22] else "Idle")

    def set_power(self, *, on: bool) -> None:
        super().set_power(on=on)
        if on:
            for axis in self.axes.values():
                axis.set_position(self._home_steps(axis.name))

    def greet(self) -> str:
        return GREETING + ("[MSG:'$H'|'$X' to unlock]\r\n" if self._state == "Alarm" else "")

    def _reset(self, state: str) -> None:
        self._generation += 1
        self._state, self._is_suspended, self._motion, self._tool = state, False, "", 0
        self._planned.clear()
        self._homing_reply = None
        self.discard_received()

    def _soft_reset(self) -> None:
        """motion_control.c: mc_reset. In motion the steppers are stopped dead, and the position is lost."""
        state = "Idle" if self._state != "Alarm" else "Alarm"
        if self._motion == "home":
            self.send_to_all("ALARM:6\r\n")
            state = "Alarm"
        elif any(axis.is_moving for axis in self.axes.values()):
            self.send_to_all("ALARM:3\r\n")
            state = "Alarm"
        for axis in self.axes.values():
            axis.halt()
        self._reset(state)
        self.send_to_all(self.greet())

    # Single bytes that act at once (serial.c: ISR)

    def take_immediate(self, data: bytes, reply: Callable[[str], None]) -> bytes:
        line = bytearray()
        for byte in data:
            match byte:
                case 0x3F if self._motion != "home":  # limits.c: no time for reports while it searches
                    reply(self._make_report(len(line)))
                case 0x3F:
                    pass
                case 0x21:
                    self._hold()
                case 0x7E:
                    self._resume()
                case 0x18:
                    line.clear()
                    self._soft_reset()
                case 0x85:
                    if self._motion == "jog":
                        self._brake_all()
                case _:
                    line.append(byte)
        return bytes(line)

    def _hold(self) -> None:
        if self._state == "Alarm" or self._motion == "home":
            return
        if self._motion == "jog":  # protocol.c: a hold cancels a jog
            self._brake_all()
        elif not self._is_suspended:
            self._is_suspended = True
            self._brake_all()

    def _brake_all(self) -> None:
        for axis in self.axes.values():
            axis.brake()

    def _resume(self) -> None:
        if not self._is_suspended or any(axis.is_moving for axis in self.axes.values()):
            return
        self._is_suspended = False
        self._run_planned()
        self.parse_again()

    def may_parse(self) -> bool:
        """While it is suspended, and while it searches, the interpreter takes no lines."""
        return not self._is_suspended and self._motion != "home"

    def _make_report(self, following: int) -> str:
        """report.c: report_realtime_status. following: number of bytes in the same packet before the request."""
        state = self._state
        is_moving = any(axis.is_moving for axis in self.axes.values())
        if self._state != "Alarm":
            state = {"jog": "Jog", "run": "Run", "": "Idle"}[self._motion if is_moving else ""]
            if self._is_suspended:
                state = "Hold:1" if is_moving else "Hold:0"
        positions = ",".join(f"{self._to_mm(name, axis.position):.3f}" for name, axis in self.axes.items())
        buffer = ""
        if int(self.settings[10]) & 2:
            blocks = 15 - len(self._planned) - bool(self._motion)
            buffer = f"|Bf:{blocks},{RX_BYTES - self.waiting_bytes() - following}"
        return f"<{state}|MPos:{positions}{buffer}|FS:0,0>\r\n"

    # Lines

    def handle_line(self, line: str, reply: Callable[[str], None]) -> None:
        text = line.replace(" ", "").upper()
        try:
            if text.startswith("$"):
                self._execute_system(text, reply)
            elif not text:
                reply("ok\r\n")
            elif self._state == "Alarm" or self._motion == "jog":
                raise _LineRefused(9)
            else:
                self._execute_block(text)
                reply("ok\r\n")
        except _LineRefused as error:
            reply(f"error:{error.number}\r\n")

    def _execute_system(self, text: str, reply: Callable[[str], None]) -> None:
        """system.c: system_execute_line."""
        busy = bool(self._motion) or self._is_suspended
        if text == "$":
            reply("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n")
        elif text == "$G":
            reply(f"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T{self._tool} F0 S0]\r\n")
        elif text.startswith("$J="):
            self._start_jog(text[3:])
        elif busy:
            raise _LineRefused(8)
        elif text == "$$":
            for number, value in sorted(self.settings.items()):
                reply(
                    f"${number}={value:.3f}\r\n"
                    if number >= 100 or number in (11, 12, 24, 25, 27)
                    else f"${number}={value:.0f}\r\n"
                )
        elif text == "$I":
            reply("[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\n")
        elif text == "$X":
            if self._state == "Alarm":
                reply("[MSG:Caution: Unlocked]\r\n")
                self._state = "Idle"
        elif text == "$H":
            if not self.settings[22]:
                raise _LineRefused(5)
            self._start_homing(reply)
            return
        else:
            self._store_setting(text)
        reply("ok\r\n")

    def _store_setting(self, text: str) -> None:
        parts = re.fullmatch(r"\$(\d+)=([-+]?[\d.]+)", text)
        if parts is None or int(parts[1]) not in self.settings:
            raise _LineRefused(3)
        self.settings[int(parts[1])] = float(parts[2])

    def _read_words(self, text: str) -> dict[str, float]:
        """Return axis words and F of a block, absolute, in mm. G-codes that it does not use here are refused."""
        if "".join(f"{letter}{number}" for letter, number in _WORD.findall(text)) != text:
            raise _LineRefused(1)
        values: dict[str, float] = {}
        for letter, number in _WORD.findall(text):
            if letter == "G":
                if f"G{float(number):g}" not in _GCODES:
                    raise _LineRefused(20)
            elif letter in (*AXES, "F", "T"):
                if letter in values:
                    raise _LineRefused(25)
                values[letter] = float(number)
            else:
                raise _LineRefused(20)
        return values

    def _execute_block(self, text: str) -> None:
        """gcode.c, as far as straight lines in machine coordinates."""
        values = self._read_words(text)
        if "T" in values:
            self._tool = int(values.pop("T"))
        feed = values.pop("F", 0.0)
        if not values:
            return
        if "G53" not in text or not re.search(r"G0?1(?!\d)", text):
            raise _LineRefused(30)
        if feed <= 0:
            raise _LineRefused(22)
        self._planned.append((values, feed / 60))
        if not self._motion:
            self._run_planned()

    def _start_jog(self, text: str) -> None:
        if self._state != "Idle" or self._is_suspended or self._motion not in ("", "jog"):
            raise _LineRefused(9)
        values = self._read_words(text)
        feed = values.pop("F", 0.0)
        if feed <= 0:
            raise _LineRefused(22)
        if self._motion:  # another jog is planned behind this one; not needed here
            raise _LineRefused(9)
        self._start_line(values, feed / 60, "jog")

    def _run_planned(self) -> None:
        if self._planned and not self._motion and not self._is_suspended:
            self._start_line(*self._planned.pop(0), "run")

    def _start_line(self, goals: Mapping[str, float], feed: float, motion: str) -> None:
        """planner.c: one straight line; its speed and acceleration are limited by those of each axis."""
        ways = {name: goal - self._to_mm(name, self.axes[name].position) for name, goal in goals.items()}
        length = sqrt(sum(way**2 for way in ways.values()))
        if length == 0:
            return
        shares = {name: abs(way) / length for name, way in ways.items() if way}
        acceleration = min(self.settings[120 + AXES.index(name)] / part for name, part in shares.items())
        rate = min([feed, *(self.settings[110 + AXES.index(n)] / 60 / part for n, part in shares.items())])
        self._motion = motion
        for name, part in shares.items():
            scale = self._steps_per_mm(name)
            target = round(goals[name] * scale) + self._home_steps(name)
            self.axes[name].start_move(target, rate * part * scale, acceleration * part * scale)
        self.handle_rest()

    def handle_rest(self) -> None:
        if any(axis.is_moving for axis in self.axes.values()) or self._motion == "home":
            return
        if not self._is_suspended:
            self._motion = ""
            self._run_planned()

    # Homing

    def _start_homing(self, reply: Callable[[str], None]) -> None:
        """limits.c: all axes search their switches; the position is then minus the pull-off, with $23=0."""
        self._motion, self._homing_reply, self._state = "home", reply, "Idle"
        longest_s = 0.0
        for name, axis in self.axes.items():
            switch = self._machine.switch_counts.get(name)
            if switch is None:
                continue
            speed = self._machine.search_speed * self._steps_per_mm(name)
            way = switch - axis.physical_position
            acceleration = self.settings[120 + AXES.index(name)] * self._steps_per_mm(name)
            axis.start_move(axis.position + way, speed, acceleration)
            longest_s = max(longest_s, abs(way) / speed + speed / acceleration)
        generation = self._generation
        after_ns = round(longest_s * NS_PER_S) + 50 * NS_PER_MS  # the pull-off
        self.time.call_after(after_ns, lambda: self._end_homing(generation))

    def _end_homing(self, generation: int) -> None:
        if generation != self._generation or self._motion != "home" or not self.is_on:
            return
        if any(axis.is_moving for axis in self.axes.values()):
            self.time.call_after(10 * NS_PER_MS, lambda: self._end_homing(generation))
            return
        for axis in self.axes.values():
            axis.set_position(0.0)
        self._motion = ""
        reply, self._homing_reply = self._homing_reply, None
        if reply is not None:
            reply("ok\r\n")
        self.parse_again()

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        """A limit switch stops all steppers dead, and locks ($21 is on in a machine with switches)."""
        if which != "none" and any(axis.is_moving for axis in self.axes.values()):
            for stage in self.axes.values():
                stage.halt()
            self._reset("Alarm")
            self.send_to_all("ALARM:1\r\n")
