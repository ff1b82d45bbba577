"""A simulated GRBL 1.1 or grblHAL, read from wiki and source (https://github.com/gnea/grbl, v1.1;
https://github.com/grblHAL/core): protocol.c, system.c, gcode.c, motion_control.c, limits.c, report.c.

Counts are steps from the position that the controller has after homing: the register is then zero at the reference.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import sqrt

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from sim.ascii.grbl_family import AXES, GrblFamily, GrblRefusal, format_setting, read_words
from sim.core.controller import LimitSwitch
from sim.core.lines import LineController, LineDevice, LineFirmware

# defaults.h: generic machine.
DEFAULTS: Mapping[int, float] = {
    0: 10, 1: 25, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.010, 12: 0.002, 13: 0, 20: 0, 21: 0, 22: 0, 23: 0,
    24: 25.0, 25: 500.0, 26: 250, 27: 1.0, 30: 1000, 31: 0, 32: 0,
    100: 250.0, 101: 250.0, 102: 250.0, 110: 500.0, 111: 500.0, 112: 500.0,
    120: 10.0, 121: 10.0, 122: 10.0, 130: 200.0, 131: 200.0, 132: 200.0,
}  # fmt: skip
_SEARCH_SCALAR = 1.5  # limits.c: HOMING_AXIS_SEARCH_SCALAR, of the maximum travel


@dataclass(frozen=True, slots=True)
class GrblMachine:
    """The firmware, and what surrounds it. switch_counts: by motor, steps from power-up. search_speed: mm/s."""

    family: GrblFamily
    switch_counts: Mapping[str, int]
    search_speed: float
    startup_ms: int


class GrblController(LineController):
    """One GRBL with three axes."""

    def __init__(self, device: LineDevice, settings: Mapping[int, float], machine: GrblMachine) -> None:
        super().__init__(AXES, device)
        self._family = family = machine.family
        self.firmware = LineFirmware(startup_ms=machine.startup_ms, longest_line=family.rx_bytes)
        self.settings = {**DEFAULTS, **settings}
        self._machine = machine
        self._state = "Alarm" if self.settings[22] else "Idle"  # main.c: HOMING_INIT_LOCK
        self._is_suspended = False
        self._motion = ""
        self._modal: dict[str, float] = {"T": 0.0, "F": 0.0, "S": 0.0}
        self._planned: list[tuple[dict[str, float], float]] = []
        self._homing_reply: Callable[[str], None] | None = None
        self._is_search_vain = False
        self._generation = 0
        for axis in self.axes.values():
            axis.set_position(self._home_steps(axis.name))

    def _steps_per_mm(self, axis: str) -> float:
        return self.settings[100 + AXES.index(axis)]

    def _home_steps(self, axis: str) -> float:
        """Counts of machine position 0 (limits.c: limits_go_home): the reference has minus the pull-off, after a search
        in negative direction ($23) the pull-off minus the maximum travel."""
        index, pull_off = AXES.index(axis), self.settings[27]
        is_negative = int(self.settings[23]) >> index & 1
        reference = pull_off - self.settings[130 + index] if is_negative else -pull_off
        return round(-reference * self._steps_per_mm(axis))

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
        return self._family.greeting + ("[MSG:'$H'|'$X' to unlock]\r\n" if self._state == "Alarm" else "")

    def _reset(self, state: str) -> None:
        self._generation += 1
        self._state, self._is_suspended, self._motion = state, False, ""
        self._modal = dict.fromkeys(self._modal, 0.0)  # gcode.c: gc_init
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
            match self._family.bytes_at_once.get(byte):
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
                case _ if byte < 0x80:
                    line.append(byte)
                case _:
                    pass
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
        self.send_to_all(self._family.message)
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
            blocks = self._family.blocks - len(self._planned) - bool(self._motion)
            buffer = f"|Bf:{blocks},{self._family.rx_bytes - self.waiting_bytes() - following}"
        return f"<{state}|MPos:{positions}{buffer}{self._family.feed}>\r\n"

    # Lines

    def handle_line(self, line: str, reply: Callable[[str], None]) -> None:
        text = line.replace(" ", "").upper()
        try:
            if text.startswith("$"):
                self._execute_system(text, reply)
            elif not text:
                reply("ok\r\n")
            elif self._state == "Alarm" or self._motion == "jog":
                raise GrblRefusal(9)
            else:
                self._execute_block(text)
                reply("ok\r\n")
        except GrblRefusal as error:
            reply(f"error:{error.number}\r\n")

    def _execute_system(self, text: str, reply: Callable[[str], None]) -> None:
        """system.c: system_execute_line."""
        busy = bool(self._motion) or self._is_suspended
        if text == "$":
            reply("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n")
        elif text == "$G":
            reply(self._family.format_modes(self._modal))
        elif text.startswith("$J="):
            self._start_jog(text[3:])
        elif busy:
            raise GrblRefusal(8)
        elif text == "$$":
            for number, value in sorted(self.settings.items()):
                reply(format_setting(self._family, number, value))
        elif text == "$I":
            reply(self._family.identity)
        elif text == "$X":
            if self._state == "Alarm":
                reply(self._family.unlocked)
                self._state = "Idle"
        elif text == "$H":
            if not self.settings[22]:
                raise GrblRefusal(5)
            self._start_homing(reply)
            return
        else:
            self._store_setting(text)
        reply("ok\r\n")

    def _store_setting(self, text: str) -> None:
        parts = re.fullmatch(r"\$(\d+)=([-+]?[\d.]+)", text)
        if parts is None or int(parts[1]) not in self.settings:
            raise GrblRefusal(3)
        self.settings[int(parts[1])] = float(parts[2])

    def _execute_block(self, text: str) -> None:
        """gcode.c, as far as straight lines in machine coordinates."""
        values = read_words(text)
        # Each line without T sets it to 0; S lasts (gcode.c: "Select tool", "Set spindle speed").
        modal = {name: values.pop(name, self._modal[name]) for name in "FS"}
        modal["T"], feed = values.pop("T", 0.0) * self._family.shows_tool, modal["F"]
        if not values:
            self._modal = modal
            return
        if "G53" not in text or not re.search(r"G0?1(?!\d)", text):
            raise GrblRefusal(30)
        if feed <= 0:
            raise GrblRefusal(22)
        self._modal = modal
        self._planned.append((values, feed / 60))
        if not self._motion:
            self._run_planned()

    def _start_jog(self, text: str) -> None:
        if self._state != "Idle" or self._is_suspended or self._motion not in ("", "jog"):
            raise GrblRefusal(9)
        values = read_words(text)
        feed = values.pop("F", 0.0)
        if feed <= 0:
            raise GrblRefusal(22)
        if self._motion:  # another jog is planned behind this one; not needed here
            raise GrblRefusal(9)
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
        """limits.c: all axes search their switches, $130 and half as far at most."""
        self._motion, self._homing_reply, self._state = "home", reply, "Idle"
        longest_s, self._is_search_vain = 0.0, False
        for name, axis in self.axes.items():
            switch = self._machine.switch_counts.get(name)
            if switch is None:
                continue
            scale = self._steps_per_mm(name)
            speed, acceleration = self._machine.search_speed * scale, self.settings[120 + AXES.index(name)] * scale
            way = switch - axis.physical_position
            farthest = _SEARCH_SCALAR * self.settings[130 + AXES.index(name)] * scale
            self._is_search_vain |= abs(way) > farthest
            way = max(-farthest, min(way, farthest))
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
        reply, self._homing_reply, self._motion = self._homing_reply, None, ""
        if self._is_search_vain:  # the reset comes behind the reply, which is `ok` all the same
            self.send_to_all("ALARM:9\r\n")
        else:
            for axis in self.axes.values():
                axis.set_position(0.0)
        if reply is not None:
            reply(f"{'' if self._is_search_vain else self._family.message}ok\r\n")
        if self._is_search_vain:
            self._reset("Alarm")
            self.send_to_all(self.greet())
        self.parse_again()

    def set_limit(self, axis: str, which: LimitSwitch) -> None:
        """A limit switch stops all steppers dead, and locks ($21 is on in a machine with switches)."""
        if which != "none" and any(axis.is_moving for axis in self.axes.values()):
            for stage in self.axes.values():
                stage.halt()
            self._reset("Alarm")
            self.send_to_all("ALARM:1\r\n")
